"""``glucoloop adversary``: a search for the sensor errors that make a controller do the most harm."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Final

from glucoloop.cli.options import MMOL, Given, options_of, reworded, with_options, without
from glucoloop.cli.progress import counted
from glucoloop.cli.request import split_off_output
from glucoloop.cli.screen import stage
from glucoloop.cli.study import carried_out, paths_of, read_request, read_with_cases, tell_results
from glucoloop.cli.telling import note_on_boluses
from glucoloop.cli.trial_options import DASK, TRIAL, WORKERS, usual_texts
from glucoloop.studies.adversary.options import REFUSED, USUAL, AdversaryKeys

if TYPE_CHECKING:
    from glucoloop.storage.rows import RowsFolder
    from glucoloop.studies.adversary.keys import Adversary
    from glucoloop.studies.adversary.work import Scores

HELP: Final = (
    "Search for the worst plausible sensor errors: those with which a controller lets glucose fall lowest.\n\n"
    "Each reading may be wrong by a part of the true glucose, and a few times the reading is stuck. An evolution "
    "strategy (CMA-ES) tries about ten thousand sequences of errors on one person and keeps those with the most time "
    "below 54 mg/dl. For comparison, random errors of the same size are simulated on a population. By default IMC, "
    "MPC and MPC/SE are searched, with the guard and 50 g at 50 min; nlqdmc-se and meal-mpc take hours and are "
    "searched only if they are named. The folder of --out is written after each generation; after Ctrl-C, the same "
    "command continues where it stopped.\n\n"
    "  glucoloop adversary --out worst\n\n"
    "  glucoloop adversary --controller mpc --error 10 --guards both\n\n"
    "  glucoloop adversary --controller mpc --person 17 --error 20 --generations 1000 --out person-17\n\n"
    "  glucoloop adversary --config worst/adversary.toml --out again"
)
_NOT_HERE: Final = (*REFUSED, DASK.key, WORKERS.key, MMOL.key, "days")
_OPTIONS: Final = (
    *options_of(AdversaryKeys),
    *reworded(
        without(TRIAL, *_NOT_HERE),
        help={
            "people": "Number of people with random errors, for comparison.",
            "out": "Folder for figures of the worst loops and tables; an unfinished search in it is resumed.",
            "overwrite": "Begin again and replace the search in the folder.",
        },
        default=usual_texts(USUAL),
    ),
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

    note_on_boluses(asked.base.patient, (case.controller for case in asked.base.cases))
    files: dict[str, str] = {}
    if output.place is None:
        rows = _finish(asked, None)
    else:
        work, kept = work_of(asked), rows_of(asked)
        opened = rows_folder(output.place, work, kept, overwrite=output.overwrite)
        rows = carried_out(opened, lambda folder: _finish(asked, folder))
        files = paths_of(work, output.place, kept.file)
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
