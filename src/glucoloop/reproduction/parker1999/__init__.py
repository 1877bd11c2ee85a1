"""Parker, Doyle and Peppas (1999): what is asked for of its reproduction."""

from __future__ import annotations

import functools
from typing import Annotated, ClassVar, Final, Literal

from glucoloop.component.base import Component
from glucoloop.component.effects import EVERYTHING, Need
from glucoloop.component.request import Request
from glucoloop.component.setting import Option
from glucoloop.situations.case import Case
from glucoloop.studies.study import PlainStudy
from glucoloop.units import LARGEST_SEED

POINTS: Final = ("setpoint-81", "nominal-22", "fasting-81")
PAPER_CONTROLLERS: Final = {
    "mpc": "linear MPC",
    "mpc-se": "MPC/SE",
    "nlqdmc-se": "NLQDMC/SE",
    "imc": "IMC with filter",
}
"""Controllers of the paper's tables, with its names."""
_SEEDS: Final = 60
_QUICK_SEEDS: Final = 3
_MAX_SEEDS: Final = 1000
_part = functools.partial(Option, panel="Parts of the paper")
_extent = functools.partial(Option, panel="How much")


class Reproduction(Component):
    """Parts of the paper that are reproduced, and the number of runs."""

    kind: ClassVar = "reproduction"

    paper: Annotated[Literal["parker1999"], Option("The study: parker1999.", flag="PAPER", metavar="PAPER")] = (
        "parker1999"
    )
    operating_point: Annotated[
        tuple[str, ...],
        _part("One of its operating points; repeat it for more.", default="all"),
    ] = POINTS
    table: Annotated[
        tuple[str, ...], _part("Only this table, I or II; repeat it for both.", metavar="N", default="all")
    ] = ()
    figure: Annotated[
        tuple[str, ...], _part("Only this figure, 2 to 6; repeat it for more.", metavar="N", default="all")
    ] = ()
    controller: Annotated[
        tuple[Request[Case], ...],
        _part(
            "A controller of your own, like my_module:MyController, in the situations of Tables I and II beside the "
            "paper's; repeat it for more."
        ),
    ] = ()
    seeds: Annotated[
        int | None,
        _extent(
            "Runs of each noisy experiment.", default=f"{_SEEDS}; quick: {_QUICK_SEEDS}", at_least=1, at_most=_MAX_SEEDS
        ),
    ] = None
    seed: Annotated[
        int, _extent("The same seed gives the same numbers.", at_least=0, at_most=LARGEST_SEED - _MAX_SEEDS)
    ] = 1
    quick: Annotated[bool, _extent("A quick look: few seeds, dead times up to 5 min, no tuning searches.")] = False

    def uses(self) -> frozenset[Need]:
        """Everything, since controllers of one's own meet all situations of the paper."""
        return EVERYTHING

    @property
    def points(self) -> tuple[str, ...]:
        """Operating points, each once."""
        return tuple(dict.fromkeys(self.operating_point))

    @property
    def runs(self) -> int:
        """Number of runs of each noisy experiment."""
        return self.seeds or (_QUICK_SEEDS if self.quick else _SEEDS)


REPRODUCE: Final = PlainStudy(
    name="reproduce",
    what="a reproduction",
    help=(
        "Reproduce a published study and compare each number with the printed one.\n\n"
        "parker1999: Parker, Doyle and Peppas, IEEE Trans. Biomed. Eng. 46(2), 1999. Every table, figure and claim is "
        "reproduced at each of three operating points that the paper can be read to mean; numbers that do not "
        "reproduce are listed with the reason where one is known.\n\n"
        "  glucoloop reproduce parker1999 --out parker1999\n\n"
        "  glucoloop reproduce parker1999 --quick --out glimpse\n\n"
        "  glucoloop reproduce parker1999 --table II --figure 4 --out part\n\n"
        "  glucoloop reproduce parker1999 --table I --controller my_module:MyController --out own"
    ),
    module="glucoloop.reproduction.parker1999.study",
    request=Reproduction,
    option_texts={"required": {"paper": False}},
    summary="report.json",
)
