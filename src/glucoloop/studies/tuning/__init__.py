"""Search of a grid: every tuning of a controller in one situation, and their order."""

from __future__ import annotations

import functools
from collections.abc import Mapping
from typing import Annotated, Any, ClassVar, Final

from glucoloop.component.grammar import Tree
from glucoloop.component.setting import About, Option
from glucoloop.refusal import Refusal
from glucoloop.situations.case import RANGES, ranges_parted, with_ranges
from glucoloop.situations.run import Run
from glucoloop.studies.study import PlainStudy

_MAX_SEEDS: Final = 1000
_TUNED: Final = ("move_horizon", "prediction_horizon", "reference_filter", "output_weight", "move_weight")
"""Settings of a controller that a grid tries."""
_DEFAULT_RANGES: Final = {"move_horizon": "1:4", "prediction_horizon": "1:14"}
"""Ranges that are tried unless others are given; of the other settings the default values."""
_DEFAULT_SEEDS: Final = 5
_grid = functools.partial(Option, panel="Grid")


class GridSearch(Run):
    """A search of a grid: every tuning of a controller in one situation."""

    kind: ClassVar = "search of a grid"
    # a search is for the controller in a sound loop, so without faults and without a guard, and with nobody's help
    refused: ClassVar = (
        *("faults", "metrics", "guard", "rescue", "glucagon", "events", "actions", "changes", "forecasts"),
    )

    ranges: Annotated[Any, About("Ranges of the tuned settings, which stand among the settings of the controller.")] = (
        None
    )
    seeds: Annotated[
        int | None,
        _grid(
            "Number of runs of each tuning with noise, another sensor or a fault, from --seed on.",
            default=f"{_DEFAULT_SEEDS}",
            at_least=1,
            at_most=_MAX_SEEDS,
        ),
    ] = None
    top: Annotated[int, _grid("Number of tunings in the table.", at_least=1, at_most=100_000)] = 10

    @classmethod
    def prepared(cls, tree: Mapping[str, Any]) -> Tree:
        """A tree whose ranges stand apart from the controller."""
        return ranges_parted(tree, _TUNED, always=True)

    def tree(self, *, whole: bool = False) -> Tree:
        """Given settings, or all that are used, with the ranges among the settings of the controller."""
        results = super().tree(whole=whole)
        return with_ranges(results, self.all_ranges if whole else self.explicit.get(RANGES) or {})

    def __post_init__(self) -> None:
        super().__post_init__()
        controller = self.case.controller
        if self.case.guard is not None:
            raise Refusal("a guard is no part of a search of a grid; leave it out")
        for name in self.ranges or {}:
            controller.setting(name)
        if self.seeds not in (None, 1) and not (self.noisy or self.drawn_otherwise):
            raise Refusal(
                f"--seeds is {self.seeds}, but without noise, another sensor or a fault all are alike; leave it out"
            )

    @property
    def number_of_seeds(self) -> int:
        """Number of runs of each tuning."""
        return self.seeds or (_DEFAULT_SEEDS if self.noisy else 1)

    @property
    def all_ranges(self) -> dict[str, str]:
        """Range of each tuned setting, as text: the given ones and the default ones."""
        tuning, controller = self.case.tuning, self.case.controller
        defaults = {**_DEFAULT_RANGES, **{key: f"{tuning[key]:g}" for key in ("output_weight", "move_weight")}}
        if "reference_filter" in tuning:
            defaults["reference_filter"] = controller.reference_filters or f"{tuning['reference_filter']:g}"
        return {**defaults, **(self.ranges or {})}


TUNE: Final = PlainStudy(
    name="tune",
    what="a search of a grid",
    help=(
        "Simulate every tuning of a grid with the same patient, meals, sensor and pump; the results are a table and a "
        "picture.\n\n"
        "A tuning is acceptable if it keeps the constraints (change of the rate, rate, glucose above 60 mg/dl) and "
        "does not oscillate. Acceptable tunings are ranked by the sum of squared errors, and the paper's own tuning is "
        "shown with its rank. A range is written 1:4, with both ends included, 2:16:2 or .3:.8:.05, with a step, or "
        "0|1|3. With --noise, results are medians over seeds, and oscillation is judged without noise.\n\n"
        "  glucoloop tune --controller 'mpc, move_horizon=1:4, prediction_horizon=2:16' --out surface\n\n"
        "  glucoloop tune --controller 'mpc-se, reference_filter=.3:.8:.1' --top 5\n\n"
        "  glucoloop tune --noise 1.45 --seeds 20 --controller 'mpc, move_horizon=2, prediction_horizon=10, "
        "move_weight=0|1|3'"
    ),
    module="glucoloop.studies.tuning.study",
    request=GridSearch,
    option_texts={
        "help": {
            "controller": "Controller with ranges of its horizons, its weights and its reference filter, like 'mpc, "
            "move_horizon=1:4, move_weight=0|1|3'; other settings are kept."
        }
    },
    summary="tune.json",
)
