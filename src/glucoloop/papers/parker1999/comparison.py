"""Comparison of reproduced numbers with the printed ones."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any, Final

import jax
import jax.numpy as jnp
import numpy as np
import numpy.typing as npt

from glucoloop.metrics import Metrics
from glucoloop.papers.parker1999.experiments import NOISE_VARIANCE, NoisyRun, PointResults, noisy_runs
from glucoloop.papers.parker1999.published import UNSETTLED, PrintedEntry, published
from glucoloop.printable import how_many
from glucoloop.pumps import PARKER_1999_LIMITS
from glucoloop.sensors import white_noise
from glucoloop.tuning.paper import printed_tuning

_CLOSE: Final = 0.1
"""Relative difference within which a number agrees with the printed one."""
_NOISE_DRAWS: Final = 200_000


@dataclass(frozen=True)
class Reproduced:
    """Result for one printed entry at one operating point."""

    median: float | str
    low: float | None = None
    """10th percentile over the seeds; None where there is one run."""
    high: float | None = None
    unsettled: bool = False
    """Whether more than half of the runs never settle."""

    @classmethod
    def of(cls, values: Any, settled: Any = None) -> Reproduced:
        """Median and percentiles over the seeds, `(seeds,)`."""
        array = np.asarray(values, float)
        unsettled = settled is not None and bool(np.mean(~np.asarray(settled)) > 0.5)
        if array.size == 1:
            return cls(median=float(array[0]), unsettled=unsettled)
        low, median, high = (float(part) for part in np.percentile(array, [10, 50, 90]))
        return cls(median=median, low=low, high=high, unsettled=unsettled)

    def spans(self, value: float) -> bool:
        """Whether a value lies between the 10th and the 90th percentile of the seeds."""
        return self.low is not None and self.high is not None and self.low <= value <= self.high

    @property
    def text(self) -> str:
        """Text of the result in a table."""
        if isinstance(self.median, str):
            return self.median
        middle = UNSETTLED if self.unsettled else _number(self.median)
        if self.low is None or self.high is None:
            return middle
        return f"{middle} ({_number(self.low)} to {_number(self.high)})"


@dataclass(frozen=True)
class ComparedEntry:
    """A printed entry with its reproductions."""

    entry: PrintedEntry
    reproduced: dict[str, Reproduced]
    """Result at each operating point."""

    def difference(self, operating_point: str) -> float | None:
        """Reproduced less printed, where both are numbers."""
        found = self.reproduced.get(operating_point)
        if found is None or isinstance(found.median, str) or isinstance(self.entry.printed, str):
            return None
        return found.median - self.entry.printed

    def agrees(self, operating_point: str) -> bool | None:
        """Whether the entry reproduces; None where it was not measured.

        A number does if it is within a tenth of the printed one or the printed one lies between the 10th and the 90th
        percentile of the seeds; a bound if it is kept; a word if it is the same.
        """
        found = self.reproduced.get(operating_point)
        if found is None:
            return None
        printed = self.entry.printed
        if printed == UNSETTLED:
            return found.unsettled
        if isinstance(printed, str) or isinstance(found.median, str):
            return printed == found.median
        if self.entry.kind == "at-most":
            return found.median <= printed
        return _close(found.median, printed) or found.spans(printed)

    def agrees_by_spread(self, operating_point: str) -> bool:
        """Whether the entry reproduces only because the seeds spread over the printed number.

        Its median is more than a tenth away: another realisation of the noise could well have been printed.
        """
        found, printed = self.reproduced.get(operating_point), self.entry.printed
        if not self.agrees(operating_point) or found is None or self.entry.kind == "at-most":
            return False
        if isinstance(printed, str) or isinstance(found.median, str):
            return False
        return not _close(found.median, printed)


def _close(found: float, printed: float) -> bool:
    return abs(found - printed) <= _CLOSE * abs(printed)


def count(rows: Iterable[ComparedEntry], operating_point: str) -> str:
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


def left_out(rows: Iterable[ComparedEntry]) -> str:
    """Sentence on the entries that no experiment was run for; empty if there are none."""
    number = sum(not row.reproduced for row in rows)
    return f"{how_many(number, 'printed entry', 'printed entries')} not run and left out." if number else ""


def _number(value: float) -> str:
    """Text of a number with three significant digits."""
    return f"{value:.0f}" if abs(value) >= 100.0 else f"{value:.3g}"


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


def _claims(study: PointResults) -> dict[str, Reproduced]:
    noisy = {key: loops.metrics for key, loops in study.with_noise.items()}
    return {**_claims_with_noise(noisy), **_claims_without_noise(study)}


def _claims_with_noise(noisy: Mapping[NoisyRun, Metrics]) -> dict[str, Reproduced]:
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


def compare(studies: Mapping[str, PointResults], prefixes: tuple[str, ...] = ("",)) -> list[ComparedEntry]:
    """Compare the printed entries with the results of each study; entries that a study leaves out are absent.

    Parameters
    ----------
    studies : mapping of str to Study
        Study at each operating point.
    prefixes : tuple of str
        Prefixes of the names of the entries to compare; all entries by default.
    """
    found = {name: _tables(study) | _claims(study) | _model(study) | _tuning(study) for name, study in studies.items()}
    return [
        ComparedEntry(
            entry=entry, reproduced={name: ours[entry.id] for name, ours in found.items() if entry.id in ours}
        )
        for entry in published()
        if entry.id.startswith(prefixes)
    ]
