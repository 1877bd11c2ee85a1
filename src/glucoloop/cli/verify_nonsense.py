"""``glucoloop verify --nonsense``: guarded controllers that are told anything at all."""

from __future__ import annotations

import dataclasses
import sys
import time
from typing import TYPE_CHECKING, Any

from glucoloop.cli.mistakes import interrupted
from glucoloop.cli.progress import counted
from glucoloop.cli.screen import show

if TYPE_CHECKING:
    from glucoloop.studies.verification.nonsense import Nonsense, NonsenseResult


def carry_out(nonsense: Nonsense, *, as_json: bool) -> None:
    """Run it, tell what was found, and leave with 0 if every promise was kept."""
    from glucoloop.studies.verification.nonsense import run_nonsense

    began, loops = time.monotonic(), nonsense.loops * len(nonsense.controllers)
    with counted(loops, 0, "loops") as progress:
        result = run_nonsense(nonsense, progress)
    seconds = time.monotonic() - began
    if as_json:
        from glucoloop.storage.strict_json import json_text, with_version

        print(json_text(with_version(_report(result, seconds))))
    else:
        _tell(result, seconds)
    if result.interrupted:
        interrupted(f"interrupted; of {loops} loops {sum(arm.loops for arm in result.arms)} were checked to the end")
    sys.exit(0 if result.holds else 1)


def _report(result: NonsenseResult, seconds: float) -> dict[str, Any]:
    return {
        "seed": result.seed,
        "samples": result.samples,
        "seconds": seconds,
        "interrupted": result.interrupted,
        "violations": result.violations,
        "arms": [dataclasses.asdict(arm) for arm in result.arms],
    }


def _tell(result: NonsenseResult, seconds: float) -> None:
    from rich import box
    from rich.table import Table

    table = Table(box=box.SIMPLE_HEAD)
    table.add_column("Promise", no_wrap=False)
    for arm in result.arms:
        table.add_column(arm.controller, justify="right", no_wrap=True)
    for promise in result.violations:
        table.add_row(promise, *(str(arm.broken[promise]) for arm in result.arms))
    show(table)
    for arm in result.arms:
        for promise, loops in arm.told.items():
            for loop in loops:
                print(
                    f"{arm.controller}, guarded, loop {loop}: {promise}; "
                    f"glucoloop verify --nonsense 1 --seed {result.seed} --controller {arm.controller} --person {loop}"
                )
    print(f"{result.samples} samples of guarded controllers that were told nonsense, {seconds:.1f} s.")
    broken = [promise for promise, count in result.violations.items() if count]
    print(f"Broken: {'; '.join(broken)}." if broken else "Every promise was kept.")
