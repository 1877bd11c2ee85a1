"""``glucoloop adversary``: a search for the sensor errors that make a controller do the most harm."""

from __future__ import annotations

import dataclasses
from typing import TYPE_CHECKING, Any, Final

from glucoloop.cli.options import Given, Option, reworded, with_options
from glucoloop.cli.progress import counted
from glucoloop.cli.request import split_off_output
from glucoloop.cli.screen import stage
from glucoloop.cli.study import carried_out, paths_of, read_request, read_with_cases, tell_results
from glucoloop.cli.trial_options import DASK, GUARDS, TRIAL, WORKERS

if TYPE_CHECKING:
    from glucoloop.storage.rows import RowsFolder
    from glucoloop.studies.adversary.keys import Adversary
    from glucoloop.studies.adversary.work import Scores

HELP: Final = (
    "Search for the worst plausible sensor errors: those that bring a controller's glucose lowest.\n\n"
    "Each reading may be wrong by a part of the true glucose, and a few times the reading is stuck. An evolution "
    "strategy (CMA-ES) tries some ten thousand sequences of errors on one person and keeps those with the most time "
    "below 54 mg/dl. Beside it stand random errors of the same size, on a population. Without options it is IMC, "
    "MPC and MPC/SE, guarded, and 50 g at 50 min; nlqdmc-se and meal-mpc take hours and are searched when named. A "
    "folder given by --out grows generation by generation; after Ctrl-C the same command goes on.\n\n"
    "  glucoloop adversary --out worst\n\n"
    "  glucoloop adversary --controller mpc --error 10 --guards both\n\n"
    "  glucoloop adversary --controller mpc --person 17 --error 20 --generations 1000 --out person-17\n\n"
    "  glucoloop adversary --config worst/adversary.toml --out again"
)
_ERRORS: Final = "Errors"
_SEARCH: Final = "Search"
_NOT_HERE: Final = (
    *("traces", "guard", DASK.key, WORKERS.key, "mmol", "days", "design", "shard_people"),
    *("meal_size_spread_pct", "meal_time_spread_min"),
)
_OWN: Final = (
    Option(
        "errors_pct",
        "--error",
        list[float],
        "Largest error of a reading, in percent of the true glucose; repeat it for more, each has a search of its own.",
        _ERRORS,
        metavar="PCT",
        default="10, 20, 30",
    ),
    Option(
        "hold_min", "--hold", float, "Time for which an error stays the same.", _ERRORS, metavar="MIN", default="15"
    ),
    Option(
        "stuck_times",
        "--stuck-times",
        int,
        "Number of stretches with a stuck reading.",
        _ERRORS,
        metavar="N",
        default="3",
    ),
    Option("stuck_min", "--stuck-for", float, "Length of each.", _ERRORS, metavar="MIN", default="30"),
    Option(
        "person",
        "--person",
        int,
        "Search on this person of the population; the nominal patient by default.",
        _SEARCH,
        metavar="N",
    ),
    Option(
        "generations",
        "--generations",
        int,
        "Number of generations of each search.",
        _SEARCH,
        metavar="N",
        default="300; nlqdmc-se, meal-mpc: 30",
    ),
    Option("starts", "--starts", int, "Searches side by side.", _SEARCH, metavar="N", default="8"),
    Option(
        "sequences",
        "--sequences",
        int,
        "Number of sequences in a generation, for each start.",
        _SEARCH,
        metavar="N",
        default="32",
    ),
    Option(
        "search_seed",
        "--search-seed",
        int,
        "The same seed tries the same sequences.",
        _SEARCH,
        metavar="N",
        default="1",
    ),
    dataclasses.replace(GUARDS, default="with"),
)
_WORDS: Final = {
    "people": "Number of people with random errors, for comparison.",
    "out": "Folder for figures of the worst loops and tables; an unfinished search in it is resumed.",
    "overwrite": "Begin again and replace the search in the folder.",
}
_DEFAULTS: Final = {
    "duration_min": "600",
    "meals": "50g@50min",
    "controllers": "imc, mpc, mpc-se",
}


_OPTIONS: Final = (
    *_OWN,
    *reworded((option for option in TRIAL if option.key not in _NOT_HERE), help=_WORDS, default=_DEFAULTS),
)


@with_options(_OPTIONS)
def command(given: Given) -> None:
    """Check the request, search, and print the results."""
    keys, output, file = split_off_output(given)
    asked = read_request(keys, file, _read)
    from glucoloop.storage.rows import rows_folder
    from glucoloop.studies.adversary.results import sentences, summary_of
    from glucoloop.studies.adversary.table import adversary_table
    from glucoloop.studies.adversary.work import rows_of, work_of

    files: dict[str, str] = {}
    if output.out is None:
        if output.overwrite:
            raise ValueError("--overwrite is about an output folder; name one with --out")
        rows = _finish(asked, None)
    else:
        work, kept = work_of(asked), rows_of(asked)
        opened = rows_folder(output.out, work, kept, overwrite=output.overwrite)
        rows = carried_out(opened, lambda folder: _finish(asked, folder))
        files = paths_of(work, output.out, kept.file)
    tell_results(output, summary_of(asked, rows), files, [adversary_table(rows)], sentences(asked, rows))


def _read(keys: Given, of_file: Given) -> Adversary:
    from glucoloop.studies.adversary.keys import read_adversary

    return read_with_cases(keys, of_file, _OPTIONS, read_adversary)


def _finish(asked: Adversary, folder: RowsFolder[Scores] | None) -> list[dict[str, Any]]:
    """Complete the search and summarise it; for searches that were finished before, read the results."""
    from glucoloop.studies.adversary.results import files_of, row_of
    from glucoloop.studies.adversary.work import search_on

    if folder is not None and folder.finished:
        found: list[dict[str, Any]] = folder.summary()["searches"]
        return found
    with counted(asked.generations, 0 if folder is None else len(folder.rows), "generations") as more:
        outcomes = search_on(asked, folder, lambda: more(1))
    rows = [row_of(asked, of) for of in outcomes]
    if folder is not None:
        with stage("Drawing"):
            folder.finish(files_of(asked, outcomes, rows))
    return rows
