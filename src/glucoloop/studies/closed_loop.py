"""A configured run: the model is identified or read, the controller designed, and the loop simulated."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from glucoloop.build.assemble import close_loop
from glucoloop.build.designs import controller_of, nominal_model, paced_situation
from glucoloop.control import Controller
from glucoloop.control.protocol import computed_settings, gives_boluses
from glucoloop.identification import Identification
from glucoloop.metrics import Metrics, clinical_summary, summarise
from glucoloop.models.settings import FileComponent
from glucoloop.refusal import Refusal
from glucoloop.reporting.labelled_traces import validity, validity_note
from glucoloop.simulation import Adaptive, Trace
from glucoloop.simulation.integrators import default_integrator
from glucoloop.simulation.plant import SteppingIntegrator
from glucoloop.situations.case import Case
from glucoloop.situations.run import INTRAVENOUS_BOLUS, Run, steady_without_rhythm
from glucoloop.situations.situation import Situation
from glucoloop.storage.model_file import ModelFile, model_file, read_model
from glucoloop.unit_guess import CONFIRM_OPTION
from glucoloop.units import u_h_from_mu_min


@dataclass(frozen=True)
class Outcome:
    """A run with its results."""

    run: Run
    case: Case
    model: ModelFile | None
    """Model of the controller; None for a controller that uses none."""
    trace: Trace
    metrics: Metrics
    notes: tuple[str, ...]
    """Notes on the model and the run, one sentence each."""
    computed_settings: Mapping[str, float] = field(default_factory=dict)
    """Settings that were settled when the controller was designed, see `control.protocol.computed_settings`."""

    def report(self) -> dict[str, Any]:
        """Plain values for JSON; the settings are those of the run by itself, without a comparison around it."""
        config = {key: value for key, value in self.run.tree(whole=True).items() if key in Run.settings()}
        return {
            "config": {**config, "controller": self.case.tree(whole=True)},
            "settled": dict(self.computed_settings),
            "model": None if self.model is None else self.model.plain(),
            "summary": clinical_summary(self.trace, self.metrics).as_dict(),
            "metrics": self.metrics.as_dict(),
            "validity": validity(self.trace),
        }


def close_the_loop(run: Run, case: Case) -> Outcome:
    """Identify or read the model of a case, design its controller, and simulate the loop of the run.

    Refusal for a configuration that is not possible, in one sentence.
    """
    model, changed = model_for(run, case), run.with_changes(run.changes) if run.changes else run
    controller = controller_of(changed, case, **model_arguments(model))
    trace = close_loop(
        changed, controller, changed.as_scenario(), integrator=integrator_of(run), forecasts=run.forecasts
    )
    return outcome_of(run, case, model, controller, trace)


def outcome_of(run: Run, case: Case, model: ModelFile | None, controller: Controller, trace: Trace) -> Outcome:
    """Metrics of a run, and notes on it."""
    metrics = summarise(trace, run.limits, metrics=run.further_metrics)
    return Outcome(
        run=run,
        case=case,
        model=model,
        trace=trace,
        metrics=metrics,
        computed_settings=computed_settings(controller),
        notes=(
            *notes_on(run, case, model),
            *_notes_on_patient(run, controller),
            *_notes_on_trace(trace, metrics),
        ),
    )


def model_for(situation: Situation, case: Case) -> ModelFile | None:
    """Model on which the controller is designed, without the dead time."""
    if not case.controller.uses_model:
        return None
    situation = paced_situation(situation, case)
    if isinstance(case.model, FileComponent):
        return _model_of_file(Path(case.model.path), situation, case)
    identification = nominal_model(situation, case)
    settings = case.identified.values()
    variance = settings["noise_variance"]
    return model_file(
        identification,
        operating_point=situation.place,
        source=f"{source_of(2 * settings['memory'], variance)}, {smoothing_of(identification)}",
        dead_time_min=0.0,
        settings={
            "model_noise_variance": variance,
            **{key: value for key, value in settings.items() if key != "noise_variance"},
            "seed": situation.seed,
            "noise_bound_mg_dl": situation.noise_bound_mg_dl,
        },
    )


def source_of(samples: int, noise_variance: float) -> str:
    """Source of a model of the simulated patient, in words."""
    noise = f"with noise of variance {noise_variance:g}" if noise_variance else "free of noise"
    return f"identified from a record of {samples} samples {noise}"


def smoothing_of(identification: Identification) -> str:
    """Smoothing of a model, in words."""
    functions = identification.laguerre_coefficients.size
    return (
        f"{functions} Laguerre functions with pole {identification.laguerre_pole:.4g}" if functions else "not smoothed"
    )


def _model_of_file(path: Path, situation: Situation, case: Case) -> ModelFile:
    model = read_model(path)
    if not math.isclose(model.sample_time_min, situation.sample_time_min, rel_tol=1e-9):
        of_model, of_run = f"{model.sample_time_min:g}", f"{situation.sample_time_min:g}"
        raise Refusal(
            f"the model was identified for {of_model}-min samples, the run uses {of_run} min",
            f"identify again with `glucoloop identify --sample-time {of_run}`",
            f"run with --sample-time {of_model}",
        )
    model_dead_time_min = model.provenance.dead_time_min
    if (
        case.known_dead_time
        and model_dead_time_min
        and not math.isclose(model_dead_time_min, situation.dead_time_min, rel_tol=1e-9)
    ):
        raise Refusal(
            f"the model holds a dead time of {model_dead_time_min:g} min, the run has {situation.dead_time_min:g} min",
            f"run with --dead-time {model_dead_time_min:g}",
            "run without known_dead_time",
            "identify again",
        )
    doubts = model.doubts()
    if doubts and not situation.allow_unusual:
        raise Refusal(
            f"no controller should be designed on the model {path}. {' '.join(doubts)}",
            "identify it again, in the way that `glucoloop identify` names",
            f"{CONFIRM_OPTION} to use it all the same",
        )
    return model


def model_arguments(model: ModelFile | None) -> dict[str, Any]:
    """Arguments of a design for its model, and for whether the model holds the dead time, as one from a record does."""
    if model is None:
        return {"model": None}
    return {"model": model.step_response_model(), "model_is_late": bool(model.provenance.dead_time_min)}


def integrator_of(run: Run) -> SteppingIntegrator:
    """Integrator of a run."""
    minute_inputs = bool(run.exercise or run.rhythm) or run.glucagon is not None
    return default_integrator(run.nominal, minute_inputs=minute_inputs) if run.integrator == "fast" else Adaptive()


def notes_on(situation: Situation, case: Case, model: ModelFile | None) -> Iterator[str]:
    """Notes on the model and the run, one sentence each."""
    path = case.model.path if isinstance(case.model, FileComponent) else None
    if model is not None:
        gain = f"gain {model.gain:.4g} mg/dl per mU/min"
        where = f"from {path}, which was {model.provenance.source}" if path else model.provenance.source
        yield f"Model: {where}; {gain}."
        yield from (f"Doubtful model: {doubt}" for doubt in model.doubts())
        yield from model.provenance.notes
        resting = model.operating_point
        if resting.name not in (None, situation.place):
            yield f"The model was identified at {resting.name}, but the run is at {situation.place}."
    elif path is not None:
        yield f"The controller {case.controller.display_name} uses no model; {path} was not read."
    if situation.dead_time_min and case.known_dead_time:
        yield f"The controller knows of the dead time of {situation.dead_time_min:g} min."
    elif situation.dead_time_min:
        yield (
            f"The controller does not know of the dead time of {situation.dead_time_min:g} min; "
            "known_dead_time=true among its settings tells it."
        )


def _notes_on_patient(situation: Situation, controller: Controller) -> Iterator[str]:
    """Note on rhythms, and the basal rate in the unit of pumps, where insulin is given subcutaneously."""
    yield from steady_without_rhythm(situation)
    if situation.patient.subcutaneous:
        basal = float(situation.nominal.basal_insulin_mU_min)
        yield (
            f"Insulin is given subcutaneously; the basal rate is {basal:.4g} mU/min ({u_h_from_mu_min(basal):.4g} U/h)."
        )
    elif gives_boluses(controller):
        yield INTRAVENOUS_BOLUS


def _notes_on_trace(trace: Trace, metrics: Metrics) -> Iterator[str]:
    """Notes on the course of a run that a reader needs for its numbers, one sentence each."""
    without_dose = int(metrics.samples_non_finite)
    if without_dose:
        yield (
            f"At {without_dose} of {trace.t_min.shape[0]} samples the controller computed no finite dose; the "
            "last one was kept, or the pump went to its minimum rate, as the status of the sample says. Check the "
            "controller."
        )
    not_valid = validity_note(trace)
    if not_valid is not None:
        yield not_valid
