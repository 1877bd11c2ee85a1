"""A comparison: several cases in one situation."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Final

from glucoloop.config.cases import CASES_KEY, given_with, label_of, refuse_foreign, refuse_idle, under_shared
from glucoloop.config.key import declared, plain
from glucoloop.config.options.case import CaseKeys, case_keys
from glucoloop.config.options.situation import SituationKeys
from glucoloop.config.run import (
    Run,
    case_key_names,
    controllers_of,
    read_case,
    read_run,
    refuse_unknown,
)
from glucoloop.refusal import Refusal

MOST_CASES: Final = 20


@dataclass(frozen=True)
class Comparison:
    """Cases by label, in one situation."""

    situation: SituationKeys
    cases: Mapping[str, CaseKeys]
    given: Mapping[str, Any] | None = field(default=None, compare=False)
    """Keys from which it was read, if it was."""

    def runs(self) -> dict[str, Run]:
        """The run of each case."""
        return {label: Run(situation=self.situation, case=case) for label, case in self.cases.items()}

    def keys(self) -> dict[str, Any]:
        """The keys from which the same comparison is read."""
        cases = [{"label": label, **case_keys(case)} for label, case in self.cases.items()]
        return {
            **plain(self.situation),
            CASES_KEY: [{key: value for key, value in case.items() if value is not None} for case in cases],
        }


def read_comparison(
    keys: Mapping[str, object], cases: Sequence[Mapping[str, object]], names: Mapping[str, str] | None = None
) -> Comparison:
    """Comparison from the keys that hold for all cases, and those of each.

    Raises
    ------
    ValueError
        For fewer than two cases or too many, a label that is missing or used twice, or a key that is unknown, wrong,
        or belongs to the situation, which all cases share.
    """
    if not 2 <= len(cases) <= MOST_CASES:
        raise Refusal(
            f"a comparison of {len(cases)} {'case' if len(cases) == 1 else 'cases'} is not possible; "
            f"give from 2 to {MOST_CASES}, like --case mpc --case 'careful: mpc, move_weight=1'"
        )
    refuse_unknown(keys, cases)
    shared_situation = read_run({key: value for key, value in keys.items() if key in declared(SituationKeys)}, names)
    situation = shared_situation.situation
    shared = {key: value for key, value in keys.items() if key not in declared(SituationKeys)}
    read: dict[str, CaseKeys] = {}
    for case in cases:
        label = label_of(case)
        if label in read:
            raise Refusal(f"two cases are called {label!r}; give each a label of its own")
        own = {key: value for key, value in case.items() if key != "label"}
        try:
            refuse_foreign(own, declared(SituationKeys), "situation", case_key_names(*controllers_of(own)))
            read[label] = read_case(under_shared(shared, own), situation)
        except Refusal as error:
            raise Refusal(f"case {label!r}: {error}") from None
    guarded = any(case.guard for case in read.values())
    refuse_idle(shared, [case.controller for case in read.values()], guarded=guarded, names=names)
    return Comparison(situation=situation, cases=read, given=given_with(keys, cases))
