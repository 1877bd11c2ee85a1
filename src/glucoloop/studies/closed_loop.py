"""A configured run: the model is identified or read, the controller designed, and the loop simulated."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from glucoloop.config.doubts import BOLUS_INTO_A_VEIN
from glucoloop.config.options.case import IDENTIFICATION_KEYS, CaseKeys
from glucoloop.config.options.situation import SituationKeys
from glucoloop.config.run import Run
from glucoloop.control import Controller
from glucoloop.control.catalogue import controller_entry
from glucoloop.control.protocol import gives_boluses, settled
from glucoloop.experiments.assemble import close_loop
from glucoloop.experiments.designs import controller_of, nominal_model
from glucoloop.experiments.situation import Situation
from glucoloop.metrics import ClinicalSummary, Metrics, clinical_summary, summarise
from glucoloop.plausible import CONFIRM_OPTION
from glucoloop.pumps import DoseLimits
from glucoloop.refusal import Refusal
from glucoloop.report.validity import validity, validity_note
from glucoloop.simulation import Adaptive, Exponential, Trace
from glucoloop.simulation.plant import SteppingIntegrator
from glucoloop.storage.model_file import ModelFile, model_file, read_model
from glucoloop.units import u_h_from_mu_min


@dataclass(frozen=True)
class Outcome:
    """A run with its results."""

    run: Run
    model: ModelFile | None
    """Model of the controller; None for a controller that uses none."""
    trace: Trace
    metrics: Metrics
    limits: DoseLimits
    notes: tuple[str, ...]
    """Notes on the model and the run, one sentence each."""
    settled: Mapping[str, float] = field(default_factory=dict)
    """Settings that were settled when the controller was designed, see `control.protocol.settled`."""

    def repeat(self) -> Run:
        """The run with its model from a file beside its configuration, so that the folder repeats it by itself."""
        return self.run if self.model is None or self.run.case.model is None else self.run.with_model("model.json")

    @property
    def summary(self) -> ClinicalSummary:
        """Times in ranges, extremes and insulin, as a clinician reads them first."""
        return clinical_summary(self.trace, self.metrics)

    def report(self) -> dict[str, Any]:
        """Plain values for JSON."""
        return {
            "config": self.run.keys(),
            "settled": dict(self.settled),
            "model": None if self.model is None else self.model.model_dump(mode="json"),
            "summary": self.summary.as_dict(),
            "metrics": self.metrics.as_dict(),
            "validity": validity(self.trace),
        }


def close_the_loop(run: Run) -> Outcome:
    """Identify or read the model, design the controller, and simulate the loop.

    Raises
    ------
    ValueError
        For a configuration that is not possible, in one sentence.
    """
    asked = run.situation
    situation = asked.situation()
    model = model_for(run, situation)
    controller = controller_for(run, situation, model)
    trace = close_loop(
        situation,
        controller,
        asked.scenario(),
        integrator=integrator_of(asked),
    )
    return outcome_of(run, situation, model, controller, trace)


def outcome_of(
    run: Run, situation: Situation, model: ModelFile | None, controller: Controller, trace: Trace
) -> Outcome:
    """Metrics of a run, and notes on it."""
    metrics = summarise(trace, situation.limits, metrics=situation.metrics)
    return Outcome(
        run=run,
        model=model,
        trace=trace,
        metrics=metrics,
        limits=situation.limits,
        settled=settled(controller),
        notes=(
            *notes_on(run, model),
            *notes_on_patient(situation, controller),
            *notes_on_trace(trace, metrics),
        ),
    )


def model_for(run: Run, situation: Situation) -> ModelFile | None:
    """Model on which the controller is designed, without the dead time."""
    case = run.case
    if not controller_entry(case.controller).uses_model:
        return None
    if case.model is not None:
        return _given_model(Path(case.model), run.situation, case)
    identification = nominal_model(situation, case.case())
    settings = {key: getattr(case, key) for key in IDENTIFICATION_KEYS}
    variance = settings["model_noise_variance"]
    noise = f"with noise of variance {variance:g}" if variance else "free of noise"
    smooth = f"{settings['laguerre_functions']} Laguerre functions with pole {settings['laguerre_pole']:.4g}"
    return model_file(
        identification,
        operating_point=run.situation.place,
        source=(
            f"identified from a record of {2 * settings['memory']} samples {noise}, "
            f"{smooth if settings['laguerre_functions'] else 'not smoothed'}"
        ),
        dead_time_min=0.0,
        settings={**settings, "seed": situation.seed, "noise_bound_mg_dl": situation.noise_bound_mg_dl},
    )


def _given_model(path: Path, situation: SituationKeys, case: CaseKeys) -> ModelFile:
    model = read_model(path)
    if not math.isclose(model.sample_time_min, situation.sample_time_min, rel_tol=1e-9):
        own, runs = f"{model.sample_time_min:g}", f"{situation.sample_time_min:g}"
        raise Refusal(
            f"the model was identified for {own}-min samples, the run uses {runs} min; "
            f"identify again with --sample-time {runs} or run with --sample-time {own}"
        )
    held = model.provenance.dead_time_min
    if case.known_dead_time and held and not math.isclose(held, situation.dead_time_min, rel_tol=1e-9):
        raise Refusal(
            f"the model holds a dead time of {held:g} min, the run has {situation.dead_time_min:g} min; "
            f"run with --dead-time {held:g} or --unknown-dead-time, or identify again"
        )
    doubts = model.doubts()
    if doubts and not situation.allow_unusual:
        raise Refusal(
            f"no controller should be designed on the model {path}. {' '.join(doubts)} Identify it again from a record "
            f"in which insulin moves glucose more, or {CONFIRM_OPTION} to use it all the same"
        )
    return model


def controller_for(run: Run, situation: Situation, model: ModelFile | None) -> Controller:
    """Controller of a case. A model from a record with dead time contains the dead time already."""
    return controller_of(situation, run.case.case(), **model_arguments(model))


def model_arguments(model: ModelFile | None) -> dict[str, Any]:
    """Arguments of a design for its model, and for whether the model holds the dead time."""
    if model is None:
        return {"model": None}
    return {"model": model.step_response_model(), "model_is_late": bool(model.provenance.dead_time_min)}


def integrator_of(situation: SituationKeys) -> SteppingIntegrator:
    """Integrator of a run."""
    return Exponential() if situation.integrator == "fast" else Adaptive()


def notes_on(run: Run, model: ModelFile | None) -> Iterator[str]:
    """Notes on the model and the run, one sentence each."""
    situation, case = run.situation, run.case
    if model is not None:
        gain = f"gain {model.gain:.4g} mg/dl per mU/min"
        where = f"from {case.model}, which was {model.provenance.source}" if case.model else model.provenance.source
        yield f"Model: {where}; {gain}."
        yield from (f"Doubtful model: {doubt}" for doubt in model.doubts())
        yield from model.provenance.notes
        resting = model.operating_point
        if resting.name not in (None, situation.place):
            yield f"The model was identified at {resting.name}, but the run is at {situation.place}."
    elif case.model is not None:
        yield f"The controller {case.controller} uses no model; {case.model} was not read."
    if situation.dead_time_min and case.known_dead_time:
        yield f"The controller knows of the dead time of {situation.dead_time_min:g} min."
    elif situation.dead_time_min:
        yield (
            f"The controller does not know of the dead time of {situation.dead_time_min:g} min; "
            "--known-dead-time tells it."
        )
    elif case.known_dead_time:
        yield "There is no dead time that the controller could know; --dead-time adds one."


def notes_on_patient(situation: Situation, controller: Controller) -> Iterator[str]:
    """The basal rate in the unit of pumps, where insulin is given under the skin."""
    entry, _ = situation.whom
    if entry.under_the_skin:
        basal = float(situation.nominal.basal_insulin_mU_min)
        yield (
            f"Insulin is given under the skin; the basal rate is {u_h_from_mu_min(basal):.4g} U/h, "
            f"which is {basal:.4g} mU/min."
        )
    elif gives_boluses(controller):
        yield BOLUS_INTO_A_VEIN


def notes_on_trace(trace: Trace, metrics: Metrics) -> Iterator[str]:
    """Notes on the course of a run that a reader needs for its numbers, one sentence each."""
    without_dose = int(metrics.samples_non_finite)
    if without_dose:
        yield (
            f"At {without_dose} of {trace.t_min.shape[0]} samples the controller computed no finite dose; the last "
            "one was kept, or the pump went to its least rate, as the status of the sample says. Check the controller."
        )
    not_valid = validity_note(trace)
    if not_valid is not None:
        yield not_valid
