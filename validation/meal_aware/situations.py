"""Situations in which the controllers are compared, and the extent of a comparison.

In the first ones the controllers' model is that of the nominal patient. In the others the model, or what a controller
is told, differs from what happens: in the person, the meal, the stomach, the sensor, the pump, the setpoint and the
guard. All of these but the guard are numbers, so that the loops of all situations are people of one compiled program.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Final, Literal

OURS: Final = "meal-mpc"
CONTROLLERS: Final = ("imc", "mpc", "mpc-se", "nlqdmc-se", OURS)
NOISE_VARIANCE: Final = 1.45
"""Variance for which controllers are designed wherever there is noise, (mg/dl)^2: nobody tells of other noise."""
HORIZON_MIN: Final = 600.0
OPERATING_POINT: Final = "setpoint-81"
PATIENT: Final = f"operating_point={OPERATING_POINT}"

TUNING_SEEDS: Final = range(900_000, 900_200)
"""Seeds of the sensor on which the tuning of the meal-aware controller was chosen."""
TUNING_PEOPLE_SEED: Final = 424_242
"""Seed of the people on whom the tuning was chosen."""
MISMATCH_TUNING_SEED: Final = 1000
"""Seed of the people and of the noise on which the settings for a wrong model were chosen."""


@dataclass(frozen=True, kw_only=True)
class Extent:
    """Number of runs, and the first seed."""

    seed: int = 2000
    """The first seed of the sensor, and that of the people."""
    seeds: int = 200
    """Runs of each noisy situation."""
    people: int = 1000

    @property
    def sensor_seeds(self) -> range:
        """Seeds of the sensor, as those of ``glucoloop run --seed``."""
        return range(self.seed, self.seed + self.seeds)

    @property
    def tuned_on(self) -> tuple[str, ...]:
        """Seeds and people of this comparison on which the tuning was chosen, in words; empty if there are none."""
        both = range(max(TUNING_SEEDS.start, self.seed), min(TUNING_SEEDS.stop, self.seed + self.seeds))
        of_people = {TUNING_PEOPLE_SEED: "the people", MISMATCH_TUNING_SEED: "the people and the noise"}
        found = [f"seeds {both.start} to {both.stop - 1} of the sensor"] if len(both) else []
        return (*found, *(f"{what} of seed {seed}" for seed, what in of_people.items() if seed == self.seed))


@dataclass(frozen=True)
class NamedSituation:
    """Patient, meal and sensor, the same for all controllers."""

    name: str
    title: str
    runs: Literal["one", "seeds", "people"]
    """One run, one for each seed of the sensor, or one for each of many people."""
    keys: Mapping[str, Any] = field(default_factory=dict)
    """Settings of a run beyond those that all situations share."""
    known_dead_time: bool = False
    """Whether controllers know the dead time."""
    oscillation: bool = False
    """Whether the controllers are also tried without noise, to see whether they oscillate."""
    bounded: bool = False
    """Whether the distance to the bound is reported."""

    def run_of(self, controller: str, seed: int) -> dict[str, Any]:
        """The run of one person, as a file has it."""
        shared = {"patient": PATIENT, "meals": ["50g@50min"], "duration_min": HORIZON_MIN}
        case = {"name": controller, "label": controller, "known_dead_time": self.known_dead_time}
        return {**shared, **self.keys, "controller": case, "seed": seed}

    def trial_of(self, controller: str, seed: int, people: int) -> dict[str, Any]:
        """The trial of many people, as a file has it."""
        return {**self.run_of(controller, seed), "population": "parker2000", "people": people}

    def runs_in_words(self, extent: Extent) -> str:
        """The runs of a comparison, in words."""
        first, last = extent.sensor_seeds[0], extent.sensor_seeds[-1]
        if self.runs == "people":
            return f"people 0 to {extent.people - 1} of seed {extent.seed}"
        if self.runs == "seeds":
            return f"seeds {first} to {last}" if last > first else f"seed {first}"
        return "one run"


_NOISE: Final = {"sensor": [f"white-noise, variance={NOISE_VARIANCE}"]}


def _late(minutes: int) -> dict[str, Any]:
    return {"sensor": [*_NOISE["sensor"], f"dead-time, minutes={minutes}"]}


SITUATIONS: Final = (
    NamedSituation("noise-free", "Without noise", "one", bounded=True),
    NamedSituation("noise", "With noise", "seeds", _NOISE, bounded=True),
    NamedSituation(
        "dead-time-10",
        "With noise and a known dead time of 10 min",
        "seeds",
        _late(10),
        known_dead_time=True,
        oscillation=True,
        bounded=True,
    ),
    NamedSituation(
        "dead-time-15",
        "With noise and a known dead time of 15 min",
        "seeds",
        _late(15),
        known_dead_time=True,
        bounded=True,
    ),
    NamedSituation("announced", "Announced, without noise", "one", {"announce_meals": True}, bounded=True),
    NamedSituation("people", "People, with noise", "people", _NOISE),
)

GROUPS: Final[Mapping[str, str]] = {
    "meal": "50 g of carbohydrate",
    "fasting": "Nobody eats",
    "correlated": "Noise that is correlated in time, of which the controller is not told",
    "juice": "15 g of juice through a fast stomach and gut",
    "gaps": "An hour without readings",
    "pump-faults": "People whose pump fails unnoticed, without a guard",
    "late": "Readings that are late by 10 min, of which the controller is not told, with correlated noise",
    "setpoints": "Setpoints from 80 to 140 mg/dl",
    "stomachs": "Ten other stomachs and ways to eat",
    "guarded": "People with a guard",
}
"""Title of each group of situations, by its name."""

Meals = tuple[tuple[float, float, float], ...]
"""Carbohydrate in g, time in min, and time over which it is eaten in min, of each meal."""


@dataclass(frozen=True)
class Mismatch:
    """One situation, the same for all controllers; samples of 5 min over 600 min."""

    name: str
    group: str
    """Name in `GROUPS`."""
    runs: int = 30
    claimed_runs: int | None = None
    """Number of runs on which a claim rests, where it differs from `runs`."""
    people: Literal["nominal", "parker2000", "corners"] = "nominal"
    """The nominal person, people of ``parker2000``, or people with each varied parameter 40 % lower or higher."""
    setpoint_mg_dl: float = 81.0
    meals: Meals = ((50.0, 50.0, 0.0),)
    stomach: Mapping[str, float] = field(default_factory=dict)
    """Arguments of `meals.LehmannDeutsch` that differ from its defaults, which controllers assume."""
    variance: float = 0.0
    correlation: float = 0.0
    late: bool = False
    """Whether each reading is 10 min old."""
    gap_min: tuple[float, float] | None = None
    """Beginning and length of a time without readings; a negative beginning stands for an individual random one."""
    blocked: bool = False
    """Whether the line is blocked for 2 h from an individual random time on."""
    flat_battery: bool = False
    """Whether the pump stops for 1 h from an individual random time on."""
    guarded: bool = False

    @property
    def designed_for(self) -> tuple[float, float]:
        """Setpoint and noise variance for which the controller is designed."""
        return self.setpoint_mg_dl, 0.0 if self.variance == 0.0 else NOISE_VARIANCE

    def runs_of(self, extent: Extent) -> int:
        """Number of runs in a comparison."""
        return min(self.claimed_runs or self.runs, extent.seeds if self.people == "nominal" else extent.people)

    def runs_in_words(self, extent: Extent) -> str:
        """The runs of a comparison, in words."""
        runs = self.runs_of(extent)
        if self.people != "nominal":
            return f"{runs} people{'' if self.people == 'parker2000' else ' at corners'} of seed {extent.seed}"
        return "one run" if runs == 1 else f"{runs} runs of seed {extent.seed}"


_NOTHING: Final[Meals] = ()
_FIFTY: Final[Meals] = ((50.0, 50.0, 0.0),)
_WHITE: Final[Mapping[str, Any]] = {"variance": 1.45}
_COLOURED: Final[Mapping[str, Any]] = {"variance": 9.0, "correlation": 0.7}
_PEOPLE: Final[Mapping[str, Any]] = {"runs": 100, "people": "parker2000", **_WHITE}
_LATE: Final[Mapping[str, Any]] = {"group": "late", "claimed_runs": 1000, "late": True, **_COLOURED}
_SETPOINTS: Final = (80.0, 95.0, 110.0, 125.0, 140.0)
_STOMACHS: Final = (
    ("slow", 180.0, 30.0, 60.0, _FIFTY),
    ("fast", 500.0, 10.0, 30.0, _FIFTY),
    ("slow gut", 360.0, 30.0, 120.0, _FIFTY),
    ("long ramp", 300.0, 60.0, 60.0, ((75.0, 50.0, 0.0),)),
    ("fast gut", 360.0, 30.0, 30.0, ((75.0, 50.0, 0.0),)),
    ("small", 250.0, 20.0, 40.0, ((5.0, 50.0, 0.0),)),
    ("large", 450.0, 45.0, 90.0, ((120.0, 50.0, 0.0),)),
    ("eaten slowly", 360.0, 30.0, 60.0, ((60.0, 50.0, 60.0),)),
    ("interrupted", 360.0, 30.0, 60.0, ((25.0, 50.0, 0.0), (35.0, 150.0, 0.0))),
    ("three courses", 500.0, 15.0, 45.0, ((15.0, 50.0, 0.0), (40.0, 80.0, 0.0), (20.0, 125.0, 0.0))),
)
"""Name; rate of emptying in mg/min, ramp in min and time constant of the gut in min; meals."""


def _stomach(plateau_mg_min: float, ramp_min: float, gut_min: float) -> dict[str, float]:
    return {"plateau_mg_min": plateau_mg_min, "ramp_min": ramp_min, "gut_time_constant_min": gut_min}


MISMATCHES: Final = (
    Mismatch("50 g, no noise", "meal", 1),
    Mismatch("fasting, no noise", "fasting", 1, meals=_NOTHING),
    Mismatch("50 g, white", "meal", **_WHITE),
    Mismatch("fasting, white", "fasting", meals=_NOTHING, **_WHITE),
    Mismatch("50 g, correlated", "correlated", **_COLOURED),
    Mismatch("fasting, correlated", "correlated", meals=_NOTHING, **_COLOURED),
    Mismatch(
        "15 g of juice, white", "juice", meals=((15.0, 50.0, 0.0),), stomach=_stomach(360.0, 15.0, 30.0), **_WHITE
    ),
    Mismatch("hour without readings as a meal begins", "gaps", gap_min=(60.0, 60.0), **_WHITE),
    Mismatch("hour without readings within a meal", "gaps", gap_min=(100.0, 60.0), **_WHITE),
    Mismatch("hour without readings as a meal ends", "gaps", gap_min=(190.0, 60.0), **_WHITE),
    Mismatch("people, no fault", "pump-faults", **_PEOPLE),
    Mismatch("people, blocked line", "pump-faults", blocked=True, **_PEOPLE),
    Mismatch("people, battery gap", "pump-faults", flat_battery=True, **_PEOPLE),
    Mismatch("people, hour without readings", "gaps", gap_min=(-1.0, 60.0), **_PEOPLE),
    Mismatch("people, late 10 min, correlated", people="parker2000", **_LATE),
    Mismatch("corners, late 10 min, correlated", people="corners", **_LATE),
    *(
        Mismatch(f"setpoint {r:g}, fasting, no noise", "setpoints", 1, meals=_NOTHING, setpoint_mg_dl=r)
        for r in _SETPOINTS
    ),
    *(Mismatch(f"setpoint {r:g}, 50 g, no noise", "setpoints", 1, setpoint_mg_dl=r) for r in _SETPOINTS),
    *(
        Mismatch(
            f"setpoint {r:g}, people fasting, no noise",
            "setpoints",
            10,
            people="parker2000",
            meals=_NOTHING,
            setpoint_mg_dl=r,
        )
        for r in (110.0, 140.0)
    ),
    *(
        Mismatch(f"setpoint {r:g}, 50 g, white", "setpoints", 10, setpoint_mg_dl=r, **_WHITE)
        for r in (110.0, 140.0)
    ),
    *(
        Mismatch(
            f"stomach: {name}", "stomachs", 10, meals=meals, stomach=_stomach(plateau, ramp, gut), **_WHITE
        )
        for name, plateau, ramp, gut, meals in _STOMACHS
    ),
    Mismatch("guarded, no fault", "guarded", guarded=True, **_PEOPLE),
    Mismatch("guarded, blocked line", "guarded", blocked=True, guarded=True, **_PEOPLE),
    Mismatch("guarded, battery gap", "guarded", flat_battery=True, guarded=True, **_PEOPLE),
    Mismatch("guarded, hour without readings", "guarded", gap_min=(-1.0, 60.0), guarded=True, **_PEOPLE),
)  # fmt: skip

ALL_SITUATIONS: Final[tuple[NamedSituation | Mismatch, ...]] = (*SITUATIONS, *MISMATCHES)
