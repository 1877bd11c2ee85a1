"""Run and compare: one controller, or several side by side, in one situation."""

from __future__ import annotations

from typing import Annotated, ClassVar, Final, NamedTuple

from glucoloop.component.setting import CONTROLLER_PANEL, PATIENT_PANEL, Option
from glucoloop.refusal import Refusal
from glucoloop.situations.case import Case
from glucoloop.situations.run import Run
from glucoloop.situations.therapy_text import changes_option
from glucoloop.studies.study import COMPONENTS_HELP, PlainStudy

_FEWEST: Final = 2


class _ChangedCase(NamedTuple):
    """A case under a change of the therapy."""

    case: Case
    change: str
    label: str


class Comparison(Run):
    """Several controllers in one situation."""

    kind: ClassVar = "comparison"

    bound: Annotated[
        bool,
        Option(
            "Compute the best that any controller could do that knows each meal when it begins, and the distance of "
            "each case from it.",
            panel=CONTROLLER_PANEL,
        ),
    ] = False

    changes: Annotated[
        tuple[str, ...], changes_option("Add a case beside the therapy as it is, with a change of it", PATIENT_PANEL)
    ] = ()
    changes_together: ClassVar = False

    def __post_init__(self) -> None:
        super().__post_init__()
        number = len(self.cases) + len(self.changed_cases)
        if number < _FEWEST:
            raise Refusal(
                f"a comparison of {number} case is not possible; give --controller for each of {_FEWEST} or more, like "
                "--controller mpc --controller 'mpc, move_weight=1, label=careful', or --change for a change of the "
                "therapy"
            )
        labels = {case.label for case in self.cases}
        taken = next((of.label for of in self.changed_cases if of.label in labels), None)
        if taken is not None:
            raise Refusal(f"a controller and a change are called {taken!r}; give the controller another label")
        for text in self.changes:
            self.with_changes((text,))  # refuses what is not possible

    @property
    def changed_cases(self) -> tuple[_ChangedCase, ...]:
        """Each case under each change that has an effect on it."""
        alone = len(self.cases) == 1
        return tuple(
            _ChangedCase(case, text, text if alone else f"{case.label}: {text}")
            for text in self.changes
            for case in self.cases
            if not self.without_effect(text, case)
        )


RUN: Final = PlainStudy(
    name="run",
    what="a run",
    help=(
        "Simulate a controller in closed loop with a virtual patient and a meal.\n\n"
        "Without options it is the noise-free loop of Parker, Doyle and Peppas (1999): 50 g of carbohydrate at 50 min, "
        "linear MPC on a model identified from the patient. With --noise the model comes from an equally noisy record, "
        "and the tuning is the paper's for noise.\n\n"
        f"{COMPONENTS_HELP}\n\n"
        "  glucoloop run --noise 1.45 --seed 3 --out first\n\n"
        "  glucoloop run --controller 'mpc-se, move_weight=2' --guard --meal 60g@1h --meal 40g@6h --duration 720\n\n"
        "  glucoloop run --config first/run.toml"
    ),
    module="glucoloop.studies.run.study",
    request=Run,
    summary="metrics.json",
)
COMPARE: Final = PlainStudy(
    name="compare",
    what="a comparison",
    help=(
        "Simulate several controllers, or tunings of one, in the same situation and compare them.\n\n"
        "Give --controller for each; all have the same meals, the same noise and the same pump. What differs between "
        "them stands among the settings of each: its label, guard and model, and whether it knows the dead time.\n\n"
        f"{COMPONENTS_HELP}\n\n"
        "  glucoloop compare --controller pid --controller imc --controller mpc --out comparison\n\n"
        "  glucoloop compare --controller mpc --controller 'mpc, move_weight=1, label=careful' --noise 1.45\n\n"
        "  glucoloop compare --controller 'mpc, label=bare' --controller 'mpc, label=safe, guard=usual' --bound\n\n"
        "  glucoloop compare --patient hovorka-2004 --controller basal-bolus --announce-meals --change 'carb_ratio, "
        "-10%'"
    ),
    module="glucoloop.studies.run.study",
    request=Comparison,
    summary="metrics.json",
)
