"""``glucoloop claims``: claims about the meal-aware controller, each with its number."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, Final

from glucoloop.cli.options import OUTPUT, Given, Option, names, options_of, with_options
from glucoloop.cli.progress import counted
from glucoloop.cli.request import Output, file_keys, split_off_output
from glucoloop.cli.screen import stage
from glucoloop.cli.study import tell_results
from glucoloop.papers.meal_aware.options import EXTENT_PANEL, QUICK, ClaimsKeys
from glucoloop.papers.meal_aware.situations import CHOICES

if TYPE_CHECKING:
    from glucoloop.papers.meal_aware.comparison import Verdict
    from glucoloop.papers.meal_aware.experiments import ComparisonRuns

HELP: Final = (
    "Say of each claim about the meal-aware controller whether it holds, with the number, its bound and the seeds.\n\n"
    "It and the paper's four controllers meet the same situations with the same noise: without and with noise, dead "
    "times of 10 and 15 min, an announced meal, people whose metabolism varies, and situations in which the model, or "
    "what a controller is told, is wrong. --out keeps a page, figures, and all numbers.\n\n"
    f"Situations, for --only: {', '.join(CHOICES)}.\n\n"
    "  glucoloop claims --out claims\n\n"
    "  glucoloop claims --only stomachs --only fasting\n\n"
    "  glucoloop claims --quick --out glimpse\n\n"
    "  glucoloop claims --config claims/claims.toml --out again"
)
_OPTIONS: Final = (
    *options_of(ClaimsKeys),
    Option("quick", "--quick", bool, "A glimpse: few seeds and few people.", EXTENT_PANEL),
    *OUTPUT,
)


@with_options(_OPTIONS)
def command(given: Given) -> None:
    """Check the request, simulate the loops, judge the claims, write and print them."""
    keys, output, file = split_off_output(given)
    asked = _read(keys, file_keys(file))
    files: dict[str, str] = {}
    with output.folder() as folder:
        with stage("Importing the simulator"):
            from glucoloop.cli.compiled import keep_compiled
            from glucoloop.papers.meal_aware.reproduce import carry_out, loops_of, write

            keep_compiled()
        with counted(loops_of(asked), 0, "loops") as progress:
            done, judged = carry_out(asked, progress=progress)
        if folder is not None:
            with stage("Drawing"):
                write(folder.write, done, judged)
            files = folder.paths()
    _tell(done, judged, output, files)


def _read(keys: Given, of_file: dict[str, Any]) -> ClaimsKeys:
    from glucoloop.papers.meal_aware.situations import read_asked

    called = names(_OPTIONS, keys)
    quick = QUICK if keys.pop("quick", False) else {}
    return read_asked({**of_file, **quick, **keys}, called)


def _tell(done: ComparisonRuns, judged: Sequence[Verdict], output: Output, files: dict[str, str]) -> None:
    from glucoloop.papers.meal_aware.pages import HOLDS, bound_told, number, report, seeds_told, summary_told

    notes = tuple(seeds_told(done))
    from rich.table import Table

    table = Table(box=None, pad_edge=False)
    others = list(judged[0].found) if judged else []
    for column in ("situation", "claim"):
        table.add_column(column)
    table.add_column("")
    for column in ("bound", *others):
        table.add_column(column, justify="right")
    last = ""
    for verdict in judged:
        claim = verdict.claim
        of_each = (number(verdict.found[name], claim.digits) for name in others)
        what = f"{claim.what}, {claim.unit}" if claim.unit else claim.what
        name = claim.situation if claim.situation != last else ""
        table.add_row(name, what, HOLDS[verdict.holds], bound_told(verdict), *of_each)
        last = claim.situation
    lines = [summary_told(judged), *notes]
    if done.step_ms:
        told = ", ".join(f"{name} {number(ms, 2)}" for name, ms in done.step_ms.items())
        lines.append(f"One sample of one patient on this machine, in ms: {told}.")
    whole = {**report(done, judged), "step_ms": dict(done.step_ms)}
    tell_results(output, whole, files, [table], lines, notes=notes)
