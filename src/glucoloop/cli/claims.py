"""``glucoloop claims``: claims about the meal-aware controller, each with its number."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, Final

from glucoloop.cli.options import OUTPUT, Given, Option, names, options_of, with_options
from glucoloop.cli.progress import counted
from glucoloop.cli.request import Output, file_keys, split_off_output
from glucoloop.cli.screen import stage
from glucoloop.cli.study import carried_out, paths_of, tell_results
from glucoloop.papers.meal_aware.options import EXTENT_PANEL, QUICK, ClaimsKeys
from glucoloop.papers.meal_aware.situations import CHOICES

if TYPE_CHECKING:
    from glucoloop.papers.meal_aware.comparison import Verdict
    from glucoloop.papers.meal_aware.kept import KeptRuns
    from glucoloop.storage.rows import RowsFolder

HELP: Final = (
    "Check each claim about the meal-aware controller, and show the number, its bound and the seeds.\n\n"
    "This controller and the paper's four are simulated in the same situations with the same noise: without and with "
    "noise, dead times of 10 and 15 min, an announced meal, people whose metabolism varies, and situations in which "
    "the model, or what a controller is told, is wrong. --out keeps a page, figures and all numbers; after Ctrl-C, the "
    "same command continues where it stopped.\n\n"
    f"Situations, for --only: {', '.join(CHOICES)}.\n\n"
    "  glucoloop claims --out claims\n\n"
    "  glucoloop claims --only stomachs --only fasting\n\n"
    "  glucoloop claims --quick --out glimpse\n\n"
    "  glucoloop claims --config claims/claims.toml --out again"
)
_OPTIONS: Final = (
    *options_of(ClaimsKeys),
    Option("quick", "--quick", bool, "A quick look: few seeds and few people.", EXTENT_PANEL),
    *OUTPUT,
)


@with_options(_OPTIONS)
def command(given: Given) -> None:
    """Check the request, simulate the loops or resume them, judge the claims, and print them."""
    keys, output, file = split_off_output(given)
    asked = _read(keys, file_keys(file))
    place = output.place
    with stage("Importing the simulator"):
        from glucoloop.cli.compiled import keep_compiled
        from glucoloop.papers.meal_aware.kept import work_of
        from glucoloop.papers.meal_aware.reproduce import kept_rows
        from glucoloop.storage.rows import rows_folder

        keep_compiled()
    if place is None:
        judged, told = _finish(asked, None)
        files: dict[str, str] = {}
    else:
        work, kept = work_of(asked), kept_rows(asked)
        opened = rows_folder(place, work, kept, overwrite=output.overwrite)
        judged, told = carried_out(opened, lambda folder: _finish(asked, folder))
        files = paths_of(work, place, kept.file)
    _tell(asked, judged, told, output, files)


def _read(keys: Given, of_file: dict[str, Any]) -> ClaimsKeys:
    from glucoloop.papers.meal_aware.situations import read_asked

    called = names(_OPTIONS, keys)
    quick = QUICK if keys.pop("quick", False) else {}
    return read_asked({**of_file, **quick, **keys}, called)


def _finish(asked: ClaimsKeys, folder: RowsFolder[KeptRuns] | None) -> tuple[list[Verdict], dict[str, Any]]:
    """Verdicts and the whole report; of a comparison that was finished before, the report that was written."""
    from glucoloop.papers.meal_aware.kept import TIMING, loops_in
    from glucoloop.papers.meal_aware.pages import report
    from glucoloop.papers.meal_aware.reproduce import carry_out, files_of, judged_before, loops_of

    if folder is not None and folder.finished:
        timing = folder.read_json(TIMING) if TIMING in folder.work.final else {"step_ms": {}}
        return judged_before(asked, folder.rows), {**folder.summary(), **timing}
    before = 0 if folder is None else loops_in(folder.rows)
    with counted(loops_of(asked), before, "loops") as progress:
        done, judged = carry_out(asked, progress=progress, folder=folder)
    if folder is not None:
        with stage("Drawing"):
            folder.finish(files_of(done, judged))
    return judged, {**report(done, judged), "step_ms": dict(done.step_ms)}


def _tell(
    asked: ClaimsKeys, judged: Sequence[Verdict], told: dict[str, Any], output: Output, files: dict[str, str]
) -> None:
    from glucoloop.papers.meal_aware.pages import HOLDS, bound_told, number, seeds_told, summary_told

    notes = tuple(seeds_told(asked))
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
    if told["step_ms"]:
        times = ", ".join(f"{name} {number(ms, 2)}" for name, ms in told["step_ms"].items())
        lines.append(f"One sample of one patient on this machine, in ms: {times}.")
    tell_results(output, told, files, [table], lines, notes=notes)
