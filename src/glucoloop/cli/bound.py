"""``glucoloop bound``: the best that any controller could do in a situation."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from glucoloop.cli.options import OUTPUT, Given, names, options_of, with_options, without
from glucoloop.cli.request import file_keys, read_again, split_off_output, with_lists
from glucoloop.cli.screen import stages
from glucoloop.cli.study import tell_results
from glucoloop.config.options.bound import NOT_OF_A_BOUND, BoundKeys
from glucoloop.storage.strict_json import with_version

if TYPE_CHECKING:
    from glucoloop.storage.folder import OutputFolder
    from glucoloop.studies.bounded import Bounded

HELP: Final = (
    "Compute how closely any controller could hold glucose: the doses within the pump's limits with the least maximum "
    "deviation from the setpoint, for a patient and meals that are known exactly from a given time on.\n\n"
    "With --noise, also compute this for a controller that can learn only from the readings that a meal begins or "
    "ends, and prepares for both cases until it can know.\n\n"
    "  glucoloop bound\n\n"
    "  glucoloop bound --known-after 0 --known-after 20 --in-advance --out bound\n\n"
    "  glucoloop bound --noise 1.45\n\n"
    "  glucoloop bound --config bound/bound.toml"
)
_OPTIONS: Final = (*without(options_of(BoundKeys), *NOT_OF_A_BOUND), *OUTPUT)


@with_options(_OPTIONS)
def command(given: Given) -> None:
    """Check the request, compute the bound, write it and print it."""
    keys, output, file = split_off_output(given)
    keys, of_file = with_lists(keys), file_keys(file)
    asked, given = read_again(_read, _used, keys, of_file), _merged(keys, of_file)
    files: dict[str, str] = {}
    with output.folder() as folder:
        with stages("Importing the simulator") as done:
            from glucoloop.cli.compiled import keep_compiled
            from glucoloop.studies.bounded import work_out

            keep_compiled()
            bounded = work_out(asked, done)
        if folder is not None:
            with stages("Drawing"):
                _write(folder, bounded, given)
            files = folder.paths()
    from glucoloop.report.bound_table import bound_table

    notes = tuple(bounded.notes())
    table = bound_table(bounded.plans, bounded.hedged)
    tell_results(output, bounded.report(), files, [table], notes, notes=notes)


def _read(keys: Given, of_file: Given) -> BoundKeys:
    from glucoloop.config.bound import read_bound

    return read_bound(_merged(keys, of_file), names(_OPTIONS, keys))


def _merged(keys: Given, of_file: Given) -> Given:
    return {**of_file, **{key: value for key, value in keys.items() if key != "known_after_min" or value}}


def _used(asked: BoundKeys) -> Given:
    from glucoloop.config.bound import bound_keys

    return bound_keys(asked)


def _write(folder: OutputFolder, bounded: Bounded, given: Given) -> None:
    from glucoloop.cli.pictures import write_figure
    from glucoloop.report.bound_figure import plot_bound
    from glucoloop.situations.toml import toml_text
    from glucoloop.storage import tables
    from glucoloop.storage.strict_json import json_text

    folder.write("doses.csv", tables.csv(bounded.samples()))
    folder.write("glucose_1min.csv", tables.csv(bounded.minutes()))
    folder.write("bound.json", json_text(with_version(bounded.report())) + "\n")
    folder.write("bound.toml", toml_text(_used(bounded.config), "bound --config bound.toml", given))
    figure = plot_bound(
        bounded.plans,
        bounded.hedged,
        meals=bounded.config.eaten(),
        title=f"The best that could be done at {bounded.config.place}",
        limits=bounded.limits,
    )
    write_figure(folder, "figure", figure)
