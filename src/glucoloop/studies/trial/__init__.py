"""Trial: controllers on a population of virtual people, in a folder that can be resumed."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Annotated, Final

from glucoloop.component.effects import OTHERS_TO_COMPARE, Need
from glucoloop.component.setting import RUN_PANEL, Option
from glucoloop.refusal import Refusal
from glucoloop.studies.study import COMPONENTS_HELP, TrialStudy
from glucoloop.trials.trial import Trial


def _margin(text: str) -> tuple[str, float]:
    """Metric and margin of a text."""
    name, _, number = text.partition("=")
    try:
        width = float(number)
    except ValueError:
        width = math.nan
    if not name.strip() or not 0.0 < width < math.inf:
        raise Refusal(f"--margin {text!r} is not possible; write it like time_70_180_pct=2, with a number above 0")
    return name.strip(), width


class TrialRequest(Trial):
    """A trial, and what of its results is asked for."""

    margin: Annotated[
        tuple[str, ...],
        Option(
            "Largest difference of a metric between controllers that does not matter, like time_70_180_pct=2; the "
            "results then say which controllers are equivalent, and how many people such a precision takes. Repeat it "
            "for more metrics.",
            panel=RUN_PANEL,
            metavar="METRIC=VALUE",
            needs=(OTHERS_TO_COMPARE,),
            rare=True,
        ),
    ] = ()

    def __post_init__(self) -> None:
        super().__post_init__()
        _ = self.margins  # which refuses what is no metric

    def uses(self) -> frozenset[Need]:
        """Needs that the situation and its controllers meet."""
        return super().uses() | ({OTHERS_TO_COMPARE} if len(self.cases) > 1 else set())

    @property
    def margins(self) -> Mapping[str, float]:
        """Margins by the names of the metrics."""
        from glucoloop.metrics.metric import result_named

        pairs = map(_margin, self.margin)
        return {result_named(name, self.further_metrics).name: value for name, value in pairs}

    @property
    def trial(self) -> Trial:
        """The trial alone, on which everything in its folder depends."""
        return Trial.narrowed(self)


TRIAL: Final = TrialStudy(
    name="trial",
    what="a trial",
    help=(
        "Simulate controllers on a population of virtual people; the results are tables, percentiles over time and a "
        "page.\n\n"
        "The folder holds one row for each person and controller, and is written in parts (shards). After Ctrl-C, a "
        "kill or a full disk, the same command continues where it stopped, and the results are the same to the bit. By "
        "default linear MPC is simulated on 1000 people whose metabolism varies as in Parker et al. (2000), for a day "
        "with three meals.\n\n"
        f"{COMPONENTS_HELP}\n\n"
        "  glucoloop trial --people 10000 --controller mpc --controller mpc-se --seed 1 --out trial\n\n"
        "  glucoloop trial --scenario 'week, days=14' --noise 1.45 --out fortnight\n\n"
        "  glucoloop trial --people 1000000 --precision float32 --dask tcp://10.0.0.1:8786 --out million"
    ),
    module="glucoloop.studies.trial.study",
    request=TrialRequest,
    option_texts={
        "help": {
            "patient": "Patient, around whom people vary and for whom controllers are designed.",
            "setpoint_mg_dl": "Glucose at which all people rest at the start, and the target; that of the operating "
            "point by default.",
            "seed": "The same seed gives the same people, meals and noise.",
        },
        "rare": dict.fromkeys(
            ("sample_time_min", "design", "traces", "allow_unusual", "meal_size_spread_pct", "meal_time_spread_min"),
            True,
        ),
    },
    on_clusters=True,
    extent=("margin",),
    files=("bands.parquet", "figure.pdf", "figure.png", "figure.svg", "report.html"),
)
