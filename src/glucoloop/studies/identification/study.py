"""Computation of a configured identification: experiment or record, fit and validation."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import jax
import numpy as np

from glucoloop.build.random_keys import record_key
from glucoloop.build.surroundings import sensor_of
from glucoloop.identification import (
    Basis,
    Identification,
    Record,
    Validation,
    bases_given,
    best_pole,
    chosen_basis,
    design_csrs,
    fit_first_order,
    identify_record,
    meal_answer,
    random_binary_sequence,
    record_from_samples,
    validate,
)
from glucoloop.identification.record import FROM_ZERO
from glucoloop.records.reading import reader_that_knows
from glucoloop.refusal import Refusal
from glucoloop.reporting import plot_identification, plot_validation
from glucoloop.reporting.columns import MetricRow, lines_table
from glucoloop.reporting.figure_files import figure_files
from glucoloop.sensors import Sensor
from glucoloop.simulation import excite
from glucoloop.situations.toml import toml_text
from glucoloop.storage import results
from glucoloop.storage.files import read_text
from glucoloop.storage.model_file import ModelFile, model_file
from glucoloop.storage.results import RECORD_COLUMNS, Results, read_record_columns
from glucoloop.studies.closed_loop import smoothing_of, source_of
from glucoloop.studies.identification import ModelRequest
from glucoloop.text import printable
from glucoloop.unit_guess import CONFIRM_ARGUMENT, CONFIRM_OPTION

_VALIDATION_SAMPLES: Final = 100
_VALIDATION_SHARE: Final = 0.1
"""Amplitude of the validation input as a share of the basal rate."""


@dataclass(frozen=True)
class _Identified:
    """An identification with its results."""

    config: ModelRequest
    record: Record
    data: str | None
    """Text of the record's file, or None without one."""
    identification: Identification
    model: ModelFile
    truth: jax.Array | None
    """Impulse response from a record free of noise, for a simulated patient with noisy readings; otherwise None."""
    validation: Validation
    validation_insulin_mU_min: jax.Array
    validated_on: str
    notes: tuple[str, ...]


def _from_patient(config: ModelRequest) -> _Identified:
    person = config.nominal
    basal = float(person.basal_insulin_mU_min)
    amplitude_mU_min = config.amplitude_mU_min or 0.0
    if amplitude_mU_min > basal:
        raise Refusal(
            f"pulses of {amplitude_mU_min:g} mU/min would take away more insulin than the basal rate; "
            f"give an amplitude of at most {basal:.2f} mU/min"
        )
    memory = config.memory or 0
    pulses = basal + np.asarray(design_csrs(memory, amplitude_mU_min, config.samples))
    quiet_sensor = sensor_of(config.without_noise())

    def experiment(sensor: Sensor) -> Record:
        return excite(person, pulses, sensor, record_key(config.seed), sample_time_min=config.sample_time_min)

    record = experiment(sensor_of(config))
    basis = Basis(
        memory=memory,
        pole=config.laguerre_pole or 0.0,
        functions=config.laguerre_functions or None,
        subcutaneous=config.patient.subcutaneous,
    )
    identification = _fit(config, basis, record, "csrs", basal_insulin_mU_min=basal)
    truth = None
    if config.noise_variance:
        quiet = identify_record(
            experiment(quiet_sensor), memory=memory, laguerre_functions=None, basal_insulin_mU_min=basal
        )
        truth = quiet.impulse_response
    sequence = random_binary_sequence(_VALIDATION_SAMPLES, _VALIDATION_SHARE * basal, config.seed)
    answer = excite(person, basal + np.asarray(sequence), quiet_sensor, sample_time_min=config.sample_time_min)
    source = source_of(pulses.size, config.noise_variance)
    return _Identified(
        config=config,
        record=record,
        data=None,
        identification=identification,
        model=_model_file(config, identification, source, ()),
        truth=truth,
        validation=validate(identification.model, sequence, answer.glucose_mg_dl - person.setpoint_mg_dl),
        validation_insulin_mU_min=sequence,
        validated_on="random binary sequence",
        notes=(
            f"Model: {source} at {config.place}.",
            f"Checked on a random binary sequence of {_VALIDATION_SAMPLES} samples, free of noise.",
        ),
    )


def _columns(path: Path) -> tuple[dict[str, list[object]], list[int]]:
    """Columns of a record and numbers of its rows; the refusal of an export of a device says which commands take it."""
    try:
        return read_record_columns(path)
    except Refusal:
        reader = reader_that_knows(path)
        if reader is None or reader == "table":
            raise
        raise Refusal(
            f"{path} is a file of {reader}, of ordinary days; a model is identified here from pulses of insulin, in "
            f"the columns {', '.join(RECORD_COLUMNS)}. glucoloop report shows the glucose of such a file, and "
            "glucoloop twin finds a person's own model from it"
        ) from None


def _from_data(config: ModelRequest, path: Path) -> _Identified:
    columns, rows = _columns(path)
    try:
        record, notes = record_from_samples(
            *columns.values(),
            sample_time_min=config.sample_time_min,
            max_gap_min=config.max_gap_min,
            allow_unusual=config.allow_unusual,
        )
        basis = _basis(config, record)
        method, why = _method(config, basis, record)
        identification = _fit(
            config,
            basis,
            record,
            method,
            basal_insulin_mU_min=config.basal_insulin_mU_min,
            starts_at_rest=not config.not_from_rest,
        )
    except Refusal as error:
        raise Refusal(_with_path(str(error), path, rows)) from error
    insulin = record.insulin_mU_min - identification.basal_insulin_mU_min
    of_meals = meal_answer(record, identification.meal_impulse_response)
    samples = f"{record.insulin_mU_min.size} samples of {record.sample_time_min:g} min"
    source = f"identified from {printable(path.name)}, {samples}"
    if not config.all_given:
        functions = "no Laguerre functions" if basis.functions is None else f"{basis.functions} Laguerre functions"
        notes = (
            f"Chosen by readings left out of the fit: a memory of {basis.memory} samples and {functions}"
            f"{', as for subcutaneous insulin' if basis.subcutaneous else ''}.",
            *notes,
        )
    notes = (why, *notes, *_about_meals(record, identification))
    if config.not_from_rest:
        notes += ("The check shows the first readings worse than they are: insulin before the record is unknown.",)
    return _Identified(
        config=config,
        record=record,
        data=read_text(path, "a record"),
        identification=identification,
        model=_model_file(config, identification, source, notes),
        truth=None,
        validation=validate(
            identification.model, insulin, record.glucose_mg_dl - identification.baseline_glucose_mg_dl - of_meals
        ),
        validation_insulin_mU_min=insulin,
        validated_on="the record itself, less the answer to meals" if of_meals.any() else "the record itself",
        notes=(f"Model: {source}.", *notes, "Checked on the record itself, since there is no other."),
    )


def _about_gain(identified: _Identified) -> Iterator[str]:
    """Sentence on a gain of the model that lies outside the interval of the person's."""
    identification = identified.identification
    gain, reliability = float(identification.model.gain), identification.reliability
    if not gain < 0.0 or not reliability.gain_to < 0.0 or reliability.gain_from <= gain <= reliability.gain_to:
        return
    more_pct = 100.0 * (0.5 * (reliability.gain_from + reliability.gain_to) / gain - 1.0)
    functions, memory = identification.laguerre_coefficients.size, identification.model.memory
    model = f"is a sum of {functions} Laguerre functions" if functions else f"ends after {memory} samples"
    yield (
        f"The model's gain lies outside the interval: the model {model}, and the interval is that of all responses "
        "which the record leaves open, slower ones too. By the middle of it, a lasting change of insulin moves glucose "
        f"{abs(more_pct):.1f} % {'more' if more_pct > 0.0 else 'less'} in the end than by the model."
    )


def _about_meals(record: Record, identification: Identification) -> Iterator[str]:
    """Sentence on the treatment of the meals."""
    if record.carbs_g is None:
        yield (
            "Meals: none are known. If something was eaten, name it in a column carbs_g; otherwise the rise of glucose "
            "is put down to insulin."
        )
        return
    eaten = np.asarray(record.carbs_g)
    if not eaten.any():
        yield "Meals: none, as the column carbs_g says."
        return
    answer = np.asarray(identification.meal_impulse_response)
    when = f"at most, {record.sample_time_min * (answer.argmax() + 1):g} min later"
    rise = f"raises glucose by {answer.max():.2g} mg/dl {when}" if answer.max() > 0.0 else "never raises glucose"
    yield (
        f"Meals: {np.count_nonzero(eaten)} with {eaten.sum():g} g in all, whose response is fitted beside that to "
        f"insulin; a gram {rise}."
    )


def _basis(config: ModelRequest, record: Record) -> Basis:
    """Basis for a record: what is given, and else what predicts readings left out of the fit best."""
    functions = "usual" if config.laguerre_functions is None else config.laguerre_functions or None
    bases = bases_given(record, "least-squares", config.memory, config.laguerre_pole, functions, None)
    return chosen_basis(
        record, bases, basal_insulin_mU_min=config.basal_insulin_mU_min, starts_at_rest=not config.not_from_rest
    )


def _method(config: ModelRequest, basis: Basis, record: Record) -> tuple[str, str]:
    """Method for a record, and the reason in a sentence."""
    if config.method != "auto":
        return config.method, f"Method: {config.method}, as asked."
    if record.carbs_g is not None and record.carbs_g.any():
        return "least-squares", "Method: least squares, since cross-correlation takes the patient to fast."
    try:
        if not config.not_from_rest:
            identify_record(
                record,
                memory=basis.memory,
                laguerre_functions=None,
                basal_insulin_mU_min=config.basal_insulin_mU_min,
            )
            return "csrs", "Method: cross-correlation, since the record is one of balanced pulses."
    except Refusal:
        why = "the record is not one of the balanced pulses that cross-correlation needs"
        return "least-squares", f"Method: least squares, since {why}."
    return "least-squares", "Method: least squares, since the record does not start at steady state."


def _fit(
    config: ModelRequest,
    basis: Basis,
    record: Record,
    method: str,
    *,
    basal_insulin_mU_min: float | None,
    starts_at_rest: bool = True,
) -> Identification:
    def fit(basis: Basis) -> Identification:
        return identify_record(
            record,
            method,
            memory=basis.memory,
            laguerre_pole=basis.pole,
            laguerre_functions=basis.functions,
            subcutaneous=basis.subcutaneous,
            basal_insulin_mU_min=basal_insulin_mU_min,
            starts_at_rest=starts_at_rest,
        )

    if config.best_pole and basis.functions is not None:
        raw = fit(basis.given(functions=None)).impulse_response
        basis = basis.given(pole=float(best_pole(raw, basis.functions).pole))
    return fit(basis)


def _model_file(config: ModelRequest, identification: Identification, source: str, notes: tuple[str, ...]) -> ModelFile:
    plain = {key: value for key, value in config.tree(whole=True).items() if isinstance(value, int | float | str)}
    return model_file(
        identification,
        operating_point=None if config.data is not None else config.place,
        source=f"{source}, {smoothing_of(identification)}",
        dead_time_min=config.dead_time_min,
        settings={**plain, "noise_variance": config.noise_variance, "dead_time_min": config.dead_time_min},
        notes=notes,
    )


def _time_constant(identification: Identification) -> str:
    model = identification.model
    t_min = model.sample_time_min * np.arange(1, model.memory + 1)
    try:
        return f"{float(fit_first_order(t_min, model.step_response, 1.0).tau_min):.1f}"
    except Refusal:
        return "n/a"  # the response is not one that a time constant describes


_OPTIONS_OF: Final = {
    "basal_insulin_mU_min": "--basal-insulin",
    "starts_at_rest=False": "--not-from-rest",
    "method='least-squares'": "--method least-squares",
    "max_gap_min": "--max-gap",
    CONFIRM_ARGUMENT: CONFIRM_OPTION,
    "shorten the memory": "shorten the memory with --memory",
    " (design_csrs, random_binary_sequence)": ", like pulses of a few samples up and down",
    ", as design_csrs does": "",
}


def _with_path(message: str, path: Path, rows: Sequence[int]) -> str:
    """Sentence of the library with options in place of arguments, and the row as its file has it."""
    for word, option in _OPTIONS_OF.items():
        message = message.replace(word, option)
    row = rf"in row (\d+){re.escape(FROM_ZERO)}"
    return re.sub(row, lambda results: f"in row {rows[int(results[1])] + 1} of {path}, below its first line,", message)


# ---------------------------------------------------------------------------------------------- how it is shown


def results_of(config: ModelRequest, progress: Callable[[str], None]) -> Results:
    """Identify a model, and check it."""
    identified = _from_patient(config) if config.data is None else _from_data(config, Path(config.data))
    progress("the model")
    plain = {**_plain(identified), "notes": [*identified.notes, *_about_gain(identified), *_warning(identified)]}
    return Results(plain, {"record.csv": results.record_table(identified.record)}, identified)


def _plain(identified: _Identified) -> dict[str, Any]:
    identification, validation = identified.identification, identified.validation
    return {
        "config": identified.config.tree(whole=True),
        "model": identified.model.plain(),
        "fit": {
            "gain_mg_dl_per_mU_min": float(identification.model.gain),
            "gain_from_mg_dl_per_mU_min": identification.reliability.gain_from,
            "gain_to_mg_dl_per_mU_min": identification.reliability.gain_to,
            "explained_percent": identification.reliability.explained_percent,
            "moved_percent": identification.reliability.moved_percent,
            "record_rms_mg_dl": identification.model_rms_mg_dl,
            "laguerre_pole": identification.laguerre_pole,
            "laguerre_coefficients": np.asarray(identification.laguerre_coefficients).tolist(),
        },
        "validation": {
            "on": identified.validated_on,
            **{name: float(value) for name, value in vars(validation).items() if np.ndim(value) == 0},
        },
        "doubts": identified.model.doubts(),
    }


def tables(config: ModelRequest, results: Results) -> Iterator[object]:
    """Properties of the model with their units."""
    rows = [MetricRow("", name, unit, [value]) for name, value, unit in _properties(results.extra)]
    yield lines_table("Model", ["Value"], rows)


def _properties(identified: _Identified) -> Iterator[tuple[str, str, str]]:
    """Name, value and unit of each property of the model."""
    identification, model, check = identified.identification, identified.model, identified.validation
    yield "Gain", f"{float(identification.model.gain):.4f}", "mg/dl per mU/min"
    reliability = identification.reliability
    yield "Gain, from, 95 % confidence", f"{reliability.gain_from:.4f}", "mg/dl per mU/min"
    yield "Gain, to, 95 % confidence", f"{reliability.gain_to:.4f}", "mg/dl per mU/min"
    yield "Time constant, first-order fit", _time_constant(identification), "min"
    yield "Memory", f"{identification.model.memory}", f"samples of {identified.record.sample_time_min:g} min"
    if model.realisation is not None:
        late_pct = 100.0 * (1.0 - model.step_response[-1] / model.gain)
        yield "Gain after the memory, by the Laguerre functions", f"{late_pct:.1f}", "% of the gain"
    yield "Basal insulin", f"{identification.basal_insulin_mU_min:.3f}", "mU/min"
    yield "Glucose at that rate", f"{identification.baseline_glucose_mg_dl:.2f}", "mg/dl"
    yield "Laguerre pole", f"{identification.laguerre_pole:.4g}", ""
    yield "Laguerre functions", f"{identification.laguerre_coefficients.size}", ""
    yield "Misfit of the record, rms", f"{identification.model_rms_mg_dl:.3f}", "mg/dl"
    yield "Variance explained, cross-validated", f"{identification.reliability.explained_percent:.1f}", "%"
    if reliability.moved_percent is not None:
        yield "Glucose moved by insulin, at most", f"{reliability.moved_percent:.1f}", "% of that glucose"
    yield "Check: sum of |residual|", f"{float(check.sum_absolute_residual_mg_dl):.2f}", "mg/dl"
    yield "Check: worst residual", f"{float(check.worst_residual_mg_dl):.2f}", "mg/dl"
    yield "Check: fit", f"{float(check.fit_percent):.1f}", "%"


def next_steps(results: Results, files: Mapping[str, str]) -> Iterator[str]:
    """Command that uses the model, unless no controller should be designed on it."""
    config: ModelRequest = results.extra.config
    if "model.json" not in files or results.plain["doubts"]:
        return
    options = {"--sample-time": (config.sample_time_min, 5.0), "--dead-time": (config.dead_time_min, 0.0)}
    hint = "".join(f" {option} {value:g}" for option, (value, default) in options.items() if value != default)
    late = " --controller known_dead_time=true" if config.dead_time_min else ""
    yield f"Use it: glucoloop run --model {files['model.json']}{hint}{late}"


def files_of(config: ModelRequest, results: Results) -> dict[str, bytes]:
    """The model, the record as it was given, the pictures, and the configuration, which names the record."""
    identified: _Identified = results.extra
    response = plot_identification(identified.identification, truth=identified.truth)
    validation = plot_validation(
        identified.validation,
        sample_time_min=identified.record.sample_time_min,
        insulin_deviation_mU_min=identified.validation_insulin_mU_min,
        title=identified.validated_on.capitalize(),
    )
    files = {
        "model.json": identified.model.text().encode(),
        **figure_files("response", response),
        **figure_files("validation", validation),
    }
    if identified.data is not None:
        copied = {"data": "data.csv"}
        used, given = {**config.tree(whole=True), **copied}, {**config.tree(), **copied}
        files["data.csv"] = identified.data.encode()
        files["identify.toml"] = toml_text(used, "identify --config identify.toml", given).encode()
    return files


def _warning(identified: _Identified) -> tuple[str, ...]:
    """Lines of warning about a model on which no controller should be designed."""
    doubts = identified.model.doubts()
    if not doubts:
        return ()
    mend = "record for longer, or change insulin more, and more often, than meals and noise change glucose"
    if identified.identification.reliability.moved_far:
        mend = "give a lower --amplitude" if identified.config.data is None else "record with insulin that changes less"
    elif identified.config.data is None:
        mend = "lengthen the experiment with --samples, or give a lower --noise"
    elif any((identified.config.memory, identified.config.laguerre_pole, identified.config.laguerre_functions)):
        mend = (
            f"leave out --memory, --laguerre-pole and --laguerre-functions, so that the record chooses them; or {mend}"
        )
    return ("DO NOT USE THIS MODEL for a controller; `glucoloop run` refuses it.", *doubts, f"To mend it, {mend}.")
