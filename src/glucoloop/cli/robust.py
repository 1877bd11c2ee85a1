"""``glucoloop robust``: a tuning that holds for people and in noise, and its check on others."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator
from typing import TYPE_CHECKING, Final

from glucoloop.cli.options import CASE, OUTPUT, Given, Option, among, names, options_of, reworded, with_options
from glucoloop.cli.progress import counted
from glucoloop.cli.request import split_off_output
from glucoloop.cli.screen import note, stage
from glucoloop.cli.study import carried_out, needed_folder, paths_of, read_request, tell_results
from glucoloop.cli.trial_options import TRIAL, usual_texts
from glucoloop.control.catalogue import SEARCHED
from glucoloop.refusal import Refusal
from glucoloop.studies.robust.options import RANGES, SEARCH_PANEL, SUBJECTS_PANEL, TAKEN, USUAL, HowFar, RobustKeys

if TYPE_CHECKING:
    from glucoloop.storage.rows import RowsFolder
    from glucoloop.studies.robust.keys import Robust
    from glucoloop.studies.robust.results import Found
    from glucoloop.studies.robust.search import Candidate

HELP: Final = (
    f"Search for a tuning of {SEARCHED.name} that is good for many people and for noise, and show the trade-off "
    "between two objectives.\n\n"
    "Each candidate tuning is simulated on people of a population, and on the nominal patient with many realisations "
    "of the noise. Two objectives make a Pareto front, and the others can be bounded. The chosen tuning is checked on "
    "people and noise that the search never used, and written as a configuration for `glucoloop run --config`. A "
    "parameter that is tuned is given as a range, .1:2; one number keeps it fixed. The folder is written after each "
    "candidate; after Ctrl-C, the same command continues where it stopped, and with more --rounds the search "
    "continues.\n\n"
    "Objectives are undershoot-median, undershoot-p95, peak-median, peak-p95 and total-variation of the nominal "
    "patient in noise, and people-undershoot-p95, people-peak-p95 and people-below-60.\n\n"
    "  glucoloop robust --out robust\n\n"
    "  glucoloop robust --at-most total-variation=mpc-se --at-most people-below-60=0 --rounds 8 --out robust\n\n"
    "  glucoloop robust --sampler random --move-weight .1:1 --caution-weight 7.5 --out random\n\n"
    "  glucoloop run --noise 1.45 --config robust/best.toml"
)
_TUNING: Final = "Tuning"
_TOP: Final = Option(
    "top", "--top", int, "Number of tunings of the front in the table.", SEARCH_PANEL, metavar="N", default="10"
)


def _tuning_options() -> Iterator[Option]:
    """Settings of the controller: ranges of the numbers that can be searched, and the other settings."""
    settings = SEARCHED.settings()
    for option in CASE:
        if option.key in RANGES:
            usual, kept = RANGES[option.key], settings[option.key].default.text
            default = usual.text if usual.unasked else f"kept at {kept}"
            yield dataclasses.replace(
                option, kind=str, help=settings[option.key].summary, panel=_TUNING, metavar="RANGE", default=default
            )
        elif option.key in settings:
            setting = settings[option.key]
            choices = f" One of {', '.join(setting.choices)}." if setting.choices else ""
            told = f"{setting.summary}{choices}"
            yield dataclasses.replace(option, help=told, panel=_TUNING, default=setting.default.text)


_OPTIONS: Final = (
    *_tuning_options(),
    *options_of(RobustKeys),
    *options_of(HowFar),
    _TOP,
    *reworded(
        among(TRIAL, (*TAKEN, "known_dead_time", *(option.key for option in OUTPUT))),
        help={
            "duration_min": "Length of the run.",
            "out": "Folder of the search; an unfinished search in it is resumed.",
            "overwrite": "Begin again and replace the search in the folder.",
            "meals": "Carbohydrate and time, like 50g@50min; repeat it for more meals.",
        },
        default=usual_texts(USUAL),
        panel={"population": SUBJECTS_PANEL},
    ),
)


@with_options(_OPTIONS)
def command(given: Given) -> None:
    """Check the request, run or resume the search, check the chosen tuning, and print the results."""
    keys, output, file = split_off_output(given)
    top = keys.pop(_TOP.key, 10)
    if top < 1:
        raise Refusal(f"--top is {top}; give 1 or more")
    out = needed_folder(output, "a search", "robust")
    asked = read_request(keys, file, _read)
    from glucoloop.storage.rows import rows_folder
    from glucoloop.studies.robust.results import sentences, summary_of
    from glucoloop.studies.robust.table import check_table, robust_table
    from glucoloop.studies.robust.work import rows_of, work_of

    work, kept = work_of(asked), rows_of(asked.search, asked.far.rounds)
    opened = rows_folder(out, work, kept, overwrite=output.overwrite)
    found = carried_out(opened, lambda folder: _finish(asked, folder))
    told = tuple(sentences(asked, found))
    tables = (
        robust_table(asked.search, found.candidates, found.verdict, found.references, top=top),
        check_table(found.checked),
    )
    tell_results(output, summary_of(asked, found), paths_of(work, out, kept.file), tables, told, notes=told)


def _read(keys: Given, of_file: Given) -> Robust:
    from glucoloop.studies.robust.keys import read_robust

    return read_robust({**of_file, **{key: value for key, value in keys.items() if value != ()}}, names(_OPTIONS, keys))


def _finish(asked: Robust, folder: RowsFolder[Candidate]) -> Found:
    """Try the missing candidates, choose, and check; for a search that was finished before, read the results."""
    from glucoloop.studies.robust.results import files_of, found_before, found_of
    from glucoloop.studies.robust.search import SearchEngine, bounds_of

    if folder.finished:
        return found_before(asked, folder.rows, folder.summary())
    with stage("Drawing people, and trying the reference controllers"):
        engine = SearchEngine(asked.search)
        references = engine.references()
    if engine.subjects.infeasible:
        note([f"{engine.subjects.infeasible} of {asked.own.people} people have no basal rate and are left out."])
    bounds = bounds_of(asked.search, references)
    with counted(folder.kind.wanted, len(folder.rows), "candidates") as more:
        for candidate in engine.candidates(asked.far.rounds, bounds, folder.rows[:]):
            folder.add(candidate)
            more(1)
    with stage("Checking on others"):
        found = found_of(asked, folder.rows, references, bounds, engine)
    with stage("Drawing"):
        folder.finish(files_of(asked, found))
    return found
