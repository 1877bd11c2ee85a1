"""Stress test: controllers, with and without a guard, on the same people under one fault after another.

It is a trial whose cases are all controllers under all faults. Each person has the same meals, noise and onset of a
fault under each controller.
"""

from __future__ import annotations

from typing import Annotated, ClassVar, Final

from glucoloop.component.request import Request, by_default
from glucoloop.component.setting import SENSOR_PANEL, Option
from glucoloop.faults import FAULTS, FaultComponent
from glucoloop.refusal import Refusal
from glucoloop.sensors import SensorComponent, WhiteNoise
from glucoloop.situations.case import Case, cases_of
from glucoloop.studies.guarded import PAPER_CONTROLLERS, PAPER_MEAL, GuardedTrial
from glucoloop.studies.study import TrialStudy

STANDARD_FAULTS: Final = (
    "missing, start_min=60, latest_min=300, duration_min=60",
    "missing, start_min=60, latest_min=180, duration_min=240",
    "late, start_min=60, latest_min=300, duration_min=120, delay_min=15",
    "repeated, start_min=60, latest_min=300, duration_min=120, times=3",
    "out-of-order, start_min=60, latest_min=300, duration_min=120, among=4",
    "spikes, per_day=12, size_mg_dl=60",
    "spikes, per_day=12, size_mg_dl=-40",
    "stuck, start_min=60, latest_min=300, duration_min=120",
    "drift, start_min=60, latest_min=300, mg_dl_h=3",
    "drift, start_min=60, latest_min=300, mg_dl_h=-3",
    "calibration, gain=1.15, offset_mg_dl=0",
    "calibration, gain=0.85, offset_mg_dl=0",
    "calibration, gain=1, offset_mg_dl=15",
    "compression, start_min=60, latest_min=300, duration_min=45, depth=0.3, tau_min=10",
    "saturation, low_mg_dl=75, high_mg_dl=400",
    "nonsense, start_min=60, latest_min=300, duration_min=60, value=nan",
    "nonsense, start_min=60, latest_min=300, duration_min=60, value=0",
    "nonsense, start_min=60, latest_min=300, duration_min=60, value=2000",
    "occlusion, start_min=60, latest_min=300, duration_min=120, open_fraction=0, noticed=false",
    "occlusion, start_min=60, latest_min=300, duration_min=120, open_fraction=0, noticed=true",
    "missed-pulses, share=0.2, noticed=false",
    "resolution, step_mU_min=4, least_mU_min=8",
    "battery, start_min=60, latest_min=300, duration_min=60",
)
"""Faults that are tried by default. Sensors that are wrong by 15 % or 15 mg/dl are as wrong as those of integrated
continuous monitors may be (U.S. Food and Drug Administration, 21 CFR 862.1355).
"""
_SHARD_PEOPLE: Final = 128


class StressTest(GuardedTrial):
    """A stress test: a trial of which every controller is tried under one fault after another."""

    kind: ClassVar = "stress test"

    people: int = 100
    duration_min: float | None = 600.0
    meals: tuple[str, ...] = PAPER_MEAL
    sensor: tuple[SensorComponent, ...] = (by_default(WhiteNoise, variance=1.45),)
    controller: tuple[Request[Case], ...] = cases_of(*PAPER_CONTROLLERS)
    faults: Annotated[
        tuple[FaultComponent, ...],
        Option(
            "A fault that is tried alone, in place of the default ones; repeat it for more.",
            panel=SENSOR_PANEL,
            flag="--fault",
        ),
    ] = tuple(map(FAULTS.by_default, STANDARD_FAULTS))

    def __post_init__(self) -> None:
        super().__post_init__()
        if not self.faults:
            raise Refusal("there is no fault to try; give one or more, like --fault 'missing, start_min=60'")
        texts = self.fault_texts
        for text in texts:
            if texts.count(text) > 1:
                raise Refusal(f"the fault {text!r} is given twice; leave one out")

    @property
    def people_a_shard(self) -> int:
        """Number of people that are computed and written together; few, so that not much is lost by an interrupt."""
        size = super().people_a_shard
        return size if self.shard_people is not None else min(self.people, size, _SHARD_PEOPLE)


STRESS: Final = TrialStudy(
    name="stress",
    what="a stress test",
    help=(
        "Test controllers under faults of sensor and pump, one fault at a time, with and without a guard; the results "
        "are a table and a page.\n\n"
        "The same people, with the same meals and noise, are simulated with each fault and without it. By default "
        "these are 100 people whose metabolism varies as in Parker et al. (2000), with 50 g at 50 min, noise of "
        "variance 1.45, 23 faults and the paper's four controllers. The folder is written in parts; after Ctrl-C, the "
        "same command continues where it stopped.\n\n"
        "  glucoloop stress --out stress\n\n"
        "  glucoloop stress --controller mpc --people 1000 --fault 'stuck, start_min=60, duration_min=90' --out stuck"
        "\n\n"
        "  glucoloop stress --config stress/stress.toml --out again"
    ),
    module="glucoloop.studies.stress.study",
    request=StressTest,
    option_texts={
        "default": {"faults": "23 faults", "days": ""},
        "help": {
            "seed": "The same seed gives the same people, meals and noise.",
            "workers": "Threads that compute.",
        },
        "rare": dict.fromkeys(("design",), True),
    },
    files=("stress.csv", "stress.parquet", "stress.html", "figure.pdf", "figure.png", "figure.svg"),
)
