"""Comparison of reproduced numbers with the printed ones."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any, Final

import jax
import jax.numpy as jnp
import numpy as np
import numpy.typing as npt

from glucoloop.papers.entries import Reproduced, compared
from glucoloop.papers.parker1999.experiments import NOISE_VARIANCE, PointResults, noisy_runs
from glucoloop.papers.parker1999.published import PrintedRow, published
from glucoloop.printable import how_many
from glucoloop.pumps import PARKER_1999_LIMITS
from glucoloop.sensors import white_noise
from glucoloop.tuning.paper import printed_tuning

_NOISE_DRAWS: Final = 200_000


def count(rows: Iterable[PrintedRow], operating_point: str) -> str:
    """Number of entries that reproduce at an operating point, as a sentence without its full stop."""
    measured = [row for row in rows if row.agrees(operating_point) is not None]
    agree = sum(bool(row.agrees(operating_point)) for row in measured)
    spread = sum(row.agrees_by_spread(operating_point) for row in measured)
    only = f", {spread} of them only within the spread of the seeds" if spread else ""
    told = f"{agree} of {len(measured)} printed entries reproduce{only}"
    results = [row for row in measured if operating_point not in row.entry.input_at]
    if len(results) == len(measured):
        return told
    inputs = how_many(len(measured) - len(results), "entry that is an input", "entries that are inputs")
    return f"{told}; without {inputs}, {sum(bool(row.agrees(operating_point)) for row in results)} of {len(results)}"


def left_out(rows: Iterable[PrintedRow]) -> str:
    """Sentence on the entries that no experiment was run for; empty if there are none."""
    number = sum(not row.reproduced for row in rows)
    return f"{how_many(number, 'printed entry', 'printed entries')} not run and left out." if number else ""


def _percent_less(ours: Any, theirs: Any) -> npt.NDArray[np.float64]:
    return np.asarray(100.0 * (1.0 - np.asarray(ours, float) / np.asarray(theirs, float)), np.float64)


def _tables(study: PointResults) -> dict[str, Reproduced]:
    found: dict[str, Reproduced] = {}
    for name, loops in study.without_noise.items():
        metrics = loops.metrics
        found[f"table-1.{name}.undershoot"] = Reproduced.of(metrics.undershoot_mg_dl)
        found[f"table-1.{name}.settling"] = Reproduced.of(metrics.settling_2pct_min, metrics.settled_2pct)
    for (name, dead_time), loops in study.with_noise.items():
        metrics = loops.metrics
        wide = name == "mpc"  # the band that fits the paper's rows of each controller
        settling = metrics.settling_5pct_min if wide else metrics.settling_2pct_min
        settled = metrics.settled_5pct if wide else metrics.settled_2pct
        broken = float(np.mean(~np.asarray(metrics.constraints_satisfied)))
        found[f"table-2.{name}.{dead_time}.undershoot"] = Reproduced.of(metrics.undershoot_mg_dl)
        found[f"table-2.{name}.{dead_time}.settling"] = Reproduced.of(settling, settled)
        found[f"table-2.{name}.{dead_time}.constraints"] = Reproduced("violated" if broken > 0.5 else "satisfied")
    return found


def _claims_with_noise(study: PointResults) -> dict[str, Reproduced]:
    noisy = {key: loops.metrics for key, loops in study.with_noise.items()}
    found: dict[str, Reproduced] = {}
    if ("mpc", "0") in noisy and ("mpc-se", "0") in noisy:
        mpc, mpc_se = noisy["mpc", "0"], noisy["mpc-se", "0"]
        found = {
            "figure-4.mpc.minimum": Reproduced.of(mpc.minimum_mg_dl),
            "figure-4.mpc.peak": Reproduced.of(mpc.peak_mg_dl),
            "figure-4.mpc-se.minimum": Reproduced.of(mpc_se.minimum_mg_dl),
            "claim.mpc-se-within": Reproduced.of(jnp.maximum(mpc_se.undershoot_mg_dl, mpc_se.overshoot_mg_dl)),
            "claim.mpc-se-against-mpc": Reproduced.of(_percent_less(mpc_se.undershoot_mg_dl, mpc.undershoot_mg_dl)),
        }
    if noisy_runs((0, 5)) <= noisy.keys():
        # The printed largest increase is over both controllers, dead time known or not; so is this one, of the medians.
        increases = [
            -_percent_less(noisy[name, dead_time].undershoot_mg_dl, noisy[name, "0"].undershoot_mg_dl)
            for name in ("mpc", "mpc-se")
            for dead_time in ("5", "5M")
        ]
        found["claim.dead-time-5"] = Reproduced(median=max(float(np.median(increase)) for increase in increases))
    return found


def _claims_without_noise(study: PointResults) -> dict[str, Reproduced]:
    quiet = {name: loops.metrics for name, loops in study.without_noise.items()}
    if not quiet:
        return {}
    found = {}
    for ours, theirs, longer in (
        ("mpc-se", "imc", False),
        ("imc", "mpc", True),
        ("nlqdmc-se", "mpc-se", True),
    ):
        less = _percent_less(quiet[ours].undershoot_mg_dl, quiet[theirs].undershoot_mg_dl)
        shorter = _percent_less(quiet[ours].settling_2pct_min, quiet[theirs].settling_2pct_min)
        found[f"claim.{ours}-against-{theirs}.undershoot"] = Reproduced.of(less)
        found[f"claim.{ours}-against-{theirs}.settling"] = Reproduced.of(-shorter if longer else shorter)
    return found


def _model(study: PointResults) -> dict[str, Reproduced]:
    if study.model is None:
        return {}
    model, person = study.model, study.patient
    reading = white_noise(NOISE_VARIANCE)
    keys = jax.random.split(jax.random.key(0), _NOISE_DRAWS)
    noise = jax.vmap(lambda key: reading.read((), jnp.zeros(()), key)[1].glucose_mg_dl)(keys)
    most = person.driven_derivative(jnp.zeros(7), jnp.asarray(PARKER_1999_LIMITS.max_mU_min))
    transport = jax.jacfwd(lambda z: person.driven_derivative(z, jnp.zeros(())))(jnp.zeros(7))
    arterial_insulin = float(-jnp.linalg.solve(transport, most)[1])
    return {
        "model.nominal-insulin": Reproduced(float(person.basal_insulin_mU_min)),
        "model.setpoint": Reproduced(float(person.setpoint_mg_dl)),
        "model.time-constant": Reproduced(model.time_constant_min),
        "model.left-after-memory": Reproduced(model.left_after_memory_pct),
        "model.laguerre-pole": Reproduced(model.best_pole),
        "model.validation.laguerre": Reproduced.of(model.laguerre_residuals),
        "model.validation.least-squares": Reproduced.of(model.least_squares_residuals),
        "model.noise-variance": Reproduced(float(jnp.var(noise))),
        "model.plasma-insulin": Reproduced(arterial_insulin),
    }


def _tuning(study: PointResults) -> dict[str, Reproduced]:
    found = {}
    for name, surface in study.tuning.items():
        rank = surface.rank_of(printed_tuning(study.operating_point, name))
        if rank.rank is None:
            told = f"no, it breaks a bound or oscillates; {rank.points} others do not"
        else:
            told = "yes" if rank.rank == 1 else f"no, number {rank.rank} of {rank.points}"
        found[f"tuning.{name}"] = Reproduced(told)
    return found


def compare(studies: Mapping[str, PointResults], prefixes: tuple[str, ...] = ("",)) -> list[PrintedRow]:
    """Compare the printed entries with the results of each study; entries that a study leaves out are absent.

    Parameters
    ----------
    studies : mapping of str to Study
        Study at each operating point.
    prefixes : tuple of str
        Prefixes of the names of the entries to compare; all entries by default.
    """
    parts = (_tables, _claims_with_noise, _claims_without_noise, _model, _tuning)
    found = {name: {id: of for part in parts for id, of in part(study).items()} for name, study in studies.items()}
    return compared([entry for entry in published() if entry.id.startswith(prefixes)], found)
