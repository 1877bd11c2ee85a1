"""``glucoloop adversary``: a search for the sensor errors that make a controller do the most harm."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator
from typing import TYPE_CHECKING, Any, Final

from glucoloop.cli.mistakes import interrupted
from glucoloop.cli.options import Given, Option, names, with_options
from glucoloop.cli.request import Output, file_keys, split_off_output, with_lists
from glucoloop.cli.screen import note, show, stage
from glucoloop.cli.trial_options import DASK, GUARDS, TRIAL, WORKERS

if TYPE_CHECKING:
    from glucoloop.studies.adversary.folder import AdversaryFolder
    from glucoloop.studies.adversary.keys import Adversary

HELP: Final = (
    "Search for the worst plausible sensor errors: those that bring a controller's glucose lowest.\n\n"
    "Each reading may be wrong by a part of the true glucose, and a few times the reading is stuck. An evolution "
    "strategy (CMA-ES) tries some ten thousand sequences of errors on one person and keeps those with the most time "
    "below 54 mg/dl. Beside it stand errors of the same size by chance, on a population. Without options it is IMC, "
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
        "Largest error of a reading, of the true glucose; repeat it for more, each is searched for by itself.",
        _ERRORS,
        metavar="PCT",
        default="10, 20, 30",
    ),
    Option("hold_min", "--hold", float, "An error stays the same for so long.", _ERRORS, metavar="MIN", default="15"),
    Option("stuck_times", "--stuck-times", int, "Stretches of a stuck reading.", _ERRORS, metavar="N", default="3"),
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
        "How long each search goes on.",
        _SEARCH,
        metavar="N",
        default="300; nlqdmc-se, meal-mpc: 30",
    ),
    Option("starts", "--starts", int, "Searches side by side.", _SEARCH, metavar="N", default="8"),
    Option("sequences", "--sequences", int, "Sequences in a generation, of each.", _SEARCH, metavar="N", default="32"),
    Option("search_seed", "--search-seed", int, "The same seed tries the same.", _SEARCH, metavar="N", default="1"),
    dataclasses.replace(GUARDS, default="with"),
)
_WORDS: Final = {
    "people": "How many meet errors by chance.",
    "out": "Folder for the worst loops, drawn, and tables; a search that was begun there goes on.",
    "overwrite": "Begin again, whatever search the folder holds.",
}
_DEFAULTS: Final = {
    "duration_min": "600",
    "meals": "50g@50min",
    "controllers": "imc, mpc, mpc-se",
}


def _options() -> Iterator[Option]:
    yield from _OWN
    for option in TRIAL:
        if option.key not in _NOT_HERE:
            told, default = _WORDS.get(option.key, option.help), _DEFAULTS.get(option.key, option.default)
            yield dataclasses.replace(option, help=told, default=default)


_OPTIONS: Final = tuple(_options())


@with_options(_OPTIONS)
def command(given: Given) -> None:
    """Check what was asked for, search, and tell it."""
    keys, output, file = split_off_output(given)
    texts = with_lists(keys), file_keys(file)
    with stage("Importing the simulator"):
        from glucoloop.cli.compiled import keep_compiled

        asked = _read(*texts)
    keep_compiled()
    _carry_out(asked, output)


def _read(keys: Given, of_file: Given) -> Adversary:
    from glucoloop.config.cases import take_cases
    from glucoloop.config.trial import overlay_trial
    from glucoloop.studies.adversary.keys import read_adversary

    cases = take_cases(keys, of_file)
    called = names(_OPTIONS, keys)
    return read_adversary(overlay_trial(of_file, keys, called), cases, called)


def _carry_out(asked: Adversary, output: Output) -> None:
    from glucoloop.studies.adversary.folder import CONFIGURATION, FINAL, SCORES, adversary_folder

    if output.out is None:
        if output.overwrite:
            raise ValueError("--overwrite is about an output folder; name one with --out")
        _tell(asked, _search(asked, None), output, {})
        return
    folder: AdversaryFolder | None = None
    wanted = asked.generations
    try:
        with adversary_folder(output.out, asked, overwrite=output.overwrite) as folder:
            note(folder.notes)
            if folder.finished:
                note([f"{folder.path} was finished before; nothing is computed again."])
                rows = folder.summary()["searches"]
            else:
                if folder.done:
                    note([f"{folder.done} of {wanted} generations of {folder.path} are there already; going on."])
                rows = _search(asked, folder)
    except KeyboardInterrupt:
        if folder is None:
            raise
        interrupted(f"interrupted; {folder.done} of {wanted} generations are kept, the same command goes on")
    _tell(asked, rows, output, {name: str(output.out / name) for name in (*FINAL, SCORES, CONFIGURATION)})


def _search(asked: Adversary, folder: AdversaryFolder | None) -> list[dict[str, Any]]:
    """Carry out what is missing, and sum up."""
    from glucoloop.cli.search_progress import counted_out
    from glucoloop.studies.adversary import Cell, Generation, search_all
    from glucoloop.studies.adversary.results import files_of, row_of

    before = {} if folder is None else {name: list(scores) for name, scores in folder.scores.items()}
    known = sum(map(len, before.values()))
    with counted_out(known, asked.generations, "generations") as count:
        done = known

        def told(cell: Cell, generation: Generation) -> None:
            nonlocal done
            if generation.number < len(before.get(cell.name, ())):
                return
            if folder is not None:
                folder.add(cell.name, generation.score)
            done += 1
            count(done)

        try:
            outcomes = list(search_all(asked.groups(), asked.own.person, before=before, told=told))
        finally:
            if folder is not None and folder.done:
                folder.keep()
    rows = [row_of(asked, of) for of in outcomes]
    if folder is not None:
        with stage("Drawing"):
            folder.finish(files_of(asked, outcomes, rows))
    return rows


def _tell(asked: Adversary, rows: list[dict[str, Any]], output: Output, files: dict[str, str]) -> None:
    from glucoloop.cli.telling import print_json, where_written
    from glucoloop.studies.adversary.results import sentences, summary_of
    from glucoloop.studies.adversary.table import adversary_table

    if output.json:
        print_json(summary_of(asked, rows), files, ())
        return
    show(adversary_table(rows))
    for line in sentences(asked, rows):
        print(line)
    print(where_written(output.out, files))
