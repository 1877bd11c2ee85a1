"""``glucoloop adversary``: a search for the sensor errors that make a controller do the most harm."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator
from typing import TYPE_CHECKING, Final

from glucoloop.cli.options import Given, Option, names, with_options
from glucoloop.cli.request import Output, file_keys, split_off_output, with_lists
from glucoloop.cli.screen import show, stage
from glucoloop.cli.trial_options import DASK, GUARDS, TRIAL, WORKERS

if TYPE_CHECKING:
    from glucoloop.config.adversary import Adversary

HELP: Final = (
    "Search for the worst plausible sensor errors: those that bring a controller's glucose lowest.\n\n"
    "Each reading may be wrong by a part of the true glucose, and a few times the reading is stuck. An evolution "
    "strategy (CMA-ES) tries some ten thousand sequences of errors on one person and keeps those with the most time "
    "below 54 mg/dl. Beside it stand errors of the same size by chance, on a population. Without options it is the "
    "paper's four controllers and the meal-aware one, guarded, and 50 g at 50 min.\n\n"
    "  glucoloop adversary --out worst\n\n"
    "  glucoloop adversary --controller mpc --error 10 --guards both\n\n"
    "  glucoloop adversary --controller mpc --person 17 --error 20 --generations 1000 --out person-17\n\n"
    "  glucoloop adversary --config worst/adversary.toml --out again"
)
CONFIGURATION: Final = "adversary.toml"
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
    Option("generations", "--generations", int, "How long each search goes on.", _SEARCH, metavar="N", default="300"),
    Option("starts", "--starts", int, "Searches side by side.", _SEARCH, metavar="N", default="8"),
    Option("sequences", "--sequences", int, "Sequences in a generation, of each.", _SEARCH, metavar="N", default="32"),
    Option("search_seed", "--search-seed", int, "The same seed tries the same.", _SEARCH, metavar="N", default="1"),
    dataclasses.replace(GUARDS, default="with"),
)
_WORDS: Final = {
    "people": "How many meet errors by chance.",
    "out": "Folder for the worst loops, drawn, tables and the configuration.",
}
_DEFAULTS: Final = {
    "duration_min": "600",
    "meals": "50g@50min",
    "controllers": "imc, mpc, mpc-se, nlqdmc-se, meal-mpc",
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
    from glucoloop.config.adversary import read_adversary
    from glucoloop.config.cases import take_cases
    from glucoloop.config.trial import overlay_trial

    cases = take_cases(keys, of_file)
    called = names(_OPTIONS, keys)
    return read_adversary(overlay_trial(of_file, keys, called), cases, called)


def _carry_out(asked: Adversary, output: Output) -> None:
    from glucoloop.cli.adversary_results import files_of, row_of
    from glucoloop.cli.search_progress import counted_out
    from glucoloop.config import toml_text
    from glucoloop.trials.adversary import search_all

    groups = list(asked.groups())
    cells = sum(len(of_group) for _, of_group in groups)
    files: dict[str, str] = {}
    with output.folder() as folder:
        with counted_out(0, cells * asked.effort.generations, "generations") as count:
            done = 0

            def told(*_: object) -> None:
                nonlocal done
                done += 1
                count(done)

            outcomes = list(search_all(groups, asked.effort, asked.own.person, told=told))
        rows = [row_of(asked, of) for of in outcomes]
        if folder is not None:
            with stage("Drawing"):
                for name, data in files_of(asked, outcomes, rows).items():
                    folder.write(name, data)
                folder.write(CONFIGURATION, toml_text(asked.keys(), f"adversary --config {CONFIGURATION}"))
                files = folder.paths()
    _tell(asked, rows, output, files)


def _tell(asked: Adversary, rows: list[dict[str, object]], output: Output, files: dict[str, str]) -> None:
    from glucoloop.cli.adversary_results import sentences, summary_of
    from glucoloop.cli.telling import print_json, where_written
    from glucoloop.report.adversary_table import adversary_table

    if output.json:
        print_json(summary_of(asked, rows), files, ())
        return
    show(adversary_table(rows))
    for line in sentences(asked, rows):
        print(line)
    print(where_written(output.out, files))
