"""``glucoloop bound``: the best that any controller could do in a situation."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING, Final

from glucoloop.cli.options import OUTPUT, SEED, SITUATION, Given, Option, names, with_options
from glucoloop.cli.request import file_keys, split_off_output, with_lists
from glucoloop.cli.screen import show, stages
from glucoloop.cli.telling import print_json, where_written
from glucoloop.storage.strict_json import with_version

if TYPE_CHECKING:
    from glucoloop.cli.request import Output
    from glucoloop.config.bound import BoundConfig
    from glucoloop.storage.folder import OutputFolder
    from glucoloop.studies.bounded import Bounded

HELP: Final = (
    "Compute how closely any controller could hold glucose: the doses within the pump's limits with the least maximum "
    "deviation from the setpoint, for a patient and meals that are known exactly from a given time on.\n\n"
    "With --noise also for a controller that can learn only from the readings that a meal begins, and when it ends, "
    "and "
    "prepares for both cases until it can know.\n\n"
    "  glucoloop bound\n\n"
    "  glucoloop bound --known-after 0 --known-after 20 --in-advance --out bound\n\n"
    "  glucoloop bound --noise 1.45\n\n"
    "  glucoloop bound --config bound/bound.toml"
)
_BOUND: Final = "Bound"
_NOT_HERE: Final = (
    "announce_meals",
    "carb_error_pct",
    "carb_bias_pct",
    "start",
    "pump_resolution_mU_min",
    "faults",
    "no_fault",
    "integrator",
    "noise_bound_mg_dl",
    SEED.key,
)
_OWN: Final = (
    Option(
        "known_after_min",
        "--known-after",
        list[str],
        "Time from the start of a meal until it is known; a dead time is added; a negative time is in advance. "
        "Repeat it "
        "for more.",
        _BOUND,
        metavar="MIN",
        default="0 and 10",
    ),
    Option("in_advance", "--in-advance", bool, "Also for all meals known from the start of the run.", _BOUND),
    Option(
        "objective",
        "--objective",
        str,
        "Quantity that is minimised: the largest deviation to either side; the undershoot, then the peak; the peak, "
        "then the "
        "undershoot; the sum of squared deviations.",
        _BOUND,
        metavar="deviation|undershoot|peak|sse",
        default="deviation",
    ),
    Option(
        "undershoot_weight",
        "--undershoot-weight",
        float,
        "Weight of squares below the setpoint, for sse.",
        _BOUND,
        metavar="X",
        default="1",
    ),
)


def _options() -> Iterator[Option]:
    yield from (option for option in SITUATION if option.key not in _NOT_HERE)
    yield from _OWN
    yield from OUTPUT


_OPTIONS: Final = tuple(_options())


@with_options(_OPTIONS)
def command(given: Given) -> None:
    """Check the request, compute the bound, write it and print it."""
    keys, output, file = split_off_output(given)
    asked = _read(with_lists(keys), file_keys(file))
    files: dict[str, str] = {}
    with output.folder() as folder:
        with stages("Importing the simulator") as done:
            from glucoloop.cli.compiled import keep_compiled
            from glucoloop.studies.bounded import work_out

            keep_compiled()
            bounded = work_out(asked, done)
        if folder is not None:
            with stages("Drawing"):
                _write(folder, bounded)
            files = folder.paths()
    _tell(bounded, output, files)


def _read(keys: Given, of_file: Given) -> BoundConfig:
    from glucoloop.config.bound import read_bound

    called = names(_OPTIONS, keys)
    known = keys.pop("known_after_min", None)
    if known:
        keys["known_after_min"] = [_minutes(text) for text in known]
    return read_bound({**of_file, **keys}, called)


def _minutes(text: str) -> float:
    try:
        return float(text)
    except ValueError:
        raise ValueError(f"--known-after is {text!r}; give a number") from None


def _write(folder: OutputFolder, bounded: Bounded) -> None:
    from glucoloop.cli.pictures import write_figure
    from glucoloop.config import toml_text
    from glucoloop.config.bound import bound_keys
    from glucoloop.report.bound_figure import plot_bound
    from glucoloop.storage import tables
    from glucoloop.storage.strict_json import json_text

    folder.write("doses.csv", tables.csv(bounded.samples()))
    folder.write("glucose_1min.csv", tables.csv(bounded.minutes()))
    folder.write("bound.json", json_text(with_version(bounded.report())) + "\n")
    folder.write("bound.toml", toml_text(bound_keys(bounded.config), "bound --config bound.toml"))
    figure = plot_bound(
        bounded.plans,
        bounded.hedged,
        meals=bounded.config.eaten(),
        title=f"The best that could be done at {bounded.config.place}",
        limits=bounded.limits,
    )
    write_figure(folder, "figure", figure)


def _tell(bounded: Bounded, output: Output, files: dict[str, str]) -> None:
    notes = tuple(bounded.notes())
    if output.json:
        print_json(bounded.report(), files, notes)
        return
    from glucoloop.report.bound_table import bound_table

    show(bound_table(bounded.plans, bounded.hedged))
    for line in notes:
        print(line)
    print(where_written(output.out, files))
