"""``glucoloop tune``: every tuning of a grid in one situation, and which of them are any good."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator
from typing import TYPE_CHECKING, Final

from glucoloop.cli.options import (
    CASE,
    OUTPUT,
    SITUATION,
    Given,
    Option,
    names,
    options_of,
    reworded,
    with_options,
    without,
)
from glucoloop.cli.request import split_off_output
from glucoloop.cli.screen import stage, stages
from glucoloop.cli.study import read_request, tell_results
from glucoloop.config.key import declared
from glucoloop.config.options.case import OF_OTHERS
from glucoloop.control.catalogue import CONTROLLERS, TUNABLE, setting_names
from glucoloop.studies.tuning.options import NOT_TUNED, GridKeys, RangeKeys

if TYPE_CHECKING:
    from rich.table import Table

    from glucoloop.studies.tuning.keys import GridSearch
    from glucoloop.studies.tuning.results import Searched

HELP: Final = (
    "Simulate every tuning of a grid with the same patient, meals, sensor and pump; the results are a table and a "
    "picture.\n\n"
    "A tuning is acceptable if it keeps the constraints (change of the rate, rate, glucose above 60 mg/dl) and does "
    "not oscillate. Acceptable tunings are ranked by the sum of squared errors, and the paper's own tuning is shown "
    "with its rank. A range is written 1:4, with both ends included, 2:16:2 or .3:.8:.05, with a step, or 0,1,3. With "
    "--noise, results are medians over seeds, and oscillation is judged without noise.\n\n"
    "  glucoloop tune --move-horizon 1:4 --prediction-horizon 2:16 --out surface\n\n"
    "  glucoloop tune --controller mpc-se --reference-filter .3:.8:.1 --top 5\n\n"
    "  glucoloop tune --noise 1.45 --seeds 20 --move-horizon 2 --prediction-horizon 10 --move-weight 0,1,3"
)


def _fixed() -> Iterator[Option]:
    """Options of a case that are not tuned: settings of controllers that are not tuned here are left out."""
    own = {setting for name in TUNABLE for setting in CONTROLLERS[name].settings()}
    told = "; ".join(f"{name}: {CONTROLLERS[name].summary}" for name in TUNABLE)
    others = without(CASE, *declared(RangeKeys), *(setting_names() - own), *NOT_TUNED)
    return reworded(others, help={"controller": f"{told}; {OF_OTHERS}."})


_OPTIONS: Final = (
    *options_of(RangeKeys),
    *options_of(GridKeys),
    *without(SITUATION, "faults", "metrics"),
    *_fixed(),
    *OUTPUT,
)


@with_options(_OPTIONS)
def command(given: Given) -> None:
    """Check the request, search, write and print the results."""
    keys, output, file = split_off_output(given)
    files: dict[str, str] = {}
    with output.folder() as folder:
        asked = read_request(keys, file, _read)
        from glucoloop.studies.tuning.results import files_of, search_grid

        with stages("Identifying") as progress:
            found = search_grid(asked, progress)
        if folder is not None:
            with stage("Drawing"):
                made, lacking = files_of(found)
                for name, data in made.items():
                    folder.write(name, data)
            if lacking is not None:
                found = dataclasses.replace(found, notes=(*found.notes, lacking))
            files = folder.paths()
    told = () if output.json else (found.verdict(), *found.notes)
    tell_results(output, found.report(), files, [_table(found)], told, notes=found.notes)


def _read(keys: Given, of_file: Given) -> GridSearch:
    from glucoloop.config.run import overlay
    from glucoloop.studies.tuning.keys import read_grid_search

    called = names(_OPTIONS, keys)
    return read_grid_search(overlay(of_file, keys, called), called)


def _table(found: Searched) -> Table:
    """The first tunings of the order, and the printed one at its place."""
    from rich import box
    from rich.table import Table

    from glucoloop.report.tuning_rows import heads, tuning_rows

    table = Table(box=box.SIMPLE_HEAD, pad_edge=False)
    for name, unit in heads(found.surface):
        table.add_column(f"{name}\n{unit}" if unit else name, justify="right" if name else "left")
    for row in tuning_rows(found.surface, found.printed, found.asked.top):
        if row.apart:
            table.add_section()
        table.add_row(*row.cells)
    return table
