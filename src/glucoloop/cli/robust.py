"""``glucoloop robust``: a tuning that holds for people and in noise, and its check on others."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from glucoloop.cli.mistakes import interrupted
from glucoloop.cli.options import CASE, MEALS, NO_FAULT, Given, Option, names, with_options
from glucoloop.cli.request import Output, file_keys, split_off_output, with_lists
from glucoloop.cli.screen import note, show, stage
from glucoloop.cli.trial_options import TRIAL
from glucoloop.registry.controllers import controller_entry

if TYPE_CHECKING:
    from glucoloop.studies.robust import Bound, SearchEngine
    from glucoloop.studies.robust.folder import RobustFolder
    from glucoloop.studies.robust.keys import Robust
    from glucoloop.studies.robust.results import Found

HELP: Final = (
    "Search for a tuning of meal-mpc that holds for people and in noise: a trade-off, and the chosen tuning.\n\n"
    "Each candidate closes the loop of people of a population and of the nominal patient under one noise after "
    "another; many candidates go through one compiled program. Two objectives make a front, and the others can be "
    "bounded. The chosen tuning is checked on people and noise that the search never saw, and written so that "
    "`glucoloop run --config` takes it. A number that is tuned is given as a range, .1:2, or as one number, which is "
    "kept. The folder grows candidate by candidate; after Ctrl-C the same command goes on, and with more --rounds it "
    "goes further.\n\n"
    "Objectives are undershoot-median, undershoot-p95, peak-median, peak-p95 and total-variation of the nominal "
    "patient in noise, and people-undershoot-p95, people-peak-p95 and people-below-60.\n\n"
    "  glucoloop robust --out robust\n\n"
    "  glucoloop robust --at-most total-variation=mpc-se --at-most people-below-60=0 --rounds 8 --out robust\n\n"
    "  glucoloop robust --sampler random --move-weight .1:1 --caution-weight 7.5 --out chance\n\n"
    "  glucoloop run --noise 1.45 --config robust/best.toml"
)
_TUNED: Final = "meal-mpc"
_RANGED: Final = {
    "move_weight": ".02:2",
    "caution_weight": ".5:50",
    "caution_mg_dl": "0:15",
    "meals_per_h": ".02:5",
    "mean_carbs_g": "10:150",
    "disturbance_variance": ".1:1000",
    "output_weight": None,
    "glucose_floor_mg_dl": None,
    "floor_weight": None,
    "measurement_variance": None,
}
"""What can be tuned, with the range that is searched; None: kept unless a range is given."""
_SHARED: Final = (
    "population",
    "patient",
    "operating_point",
    MEALS,
    "meal_model",
    "no_meal",
    "duration_min",
    "announce_meals",
    "noise_variance",
    "noise_bound_mg_dl",
    "dead_time_min",
    "max_change_mU_min",
    "min_insulin_mU_min",
    "max_insulin_mU_min",
    "site",
    "pump_resolution_mU_min",
    "faults",
    NO_FAULT,
    "sample_time_min",
    "allow_unusual",
    "known_dead_time",
    "config",
    "out",
    "overwrite",
    "json",
)
_DEFAULTS: Final = {MEALS: "50g@50min", "duration_min": "600", "noise_variance": "1.45"}
_WORDS: Final = {
    "duration_min": "Length of the run.",
    "out": "Folder of the search; one that was begun there goes on.",
    "overwrite": "Begin again, whatever search the folder holds.",
    "json": "Print the summary as one JSON object.",
    MEALS: "Carbohydrate and time, like 50g@50min; repeat it for more meals.",
}
_SUBJECTS: Final = "People and noise"
_SEARCH: Final = "Search"
_TUNING: Final = "Tuning"
_CHECK: Final = "Check on others"
_OWN: Final = (
    Option("people", "--people", int, "People of the population.", _SUBJECTS, metavar="N", default="40"),
    Option("people_seed", "--people-seed", int, "Of them.", _SUBJECTS, metavar="N", default="424242"),
    Option("seeds", "--seeds", int, "Noises of the nominal patient.", _SUBJECTS, metavar="N", default="40"),
    Option("first_seed", "--first-seed", int, "The first of them.", _SUBJECTS, metavar="N", default="900000"),
    Option("check_people", "--check-people", int, "People of the check.", _CHECK, metavar="N", default="200"),
    Option("check_people_seed", "--check-people-seed", int, "Of them.", _CHECK, metavar="N", default="424243"),
    Option("check_seeds", "--check-seeds", int, "Noises of the check.", _CHECK, metavar="N", default="200"),
    Option("check_first_seed", "--check-first-seed", int, "The first of them.", _CHECK, metavar="N", default="950000"),
    Option(
        "objectives",
        "--objective",
        list[str],
        "One of the two objectives of the front; give it twice.",
        _SEARCH,
        metavar="NAME",
        default="undershoot-p95, peak-median",
    ),
    Option(
        "at_most",
        "--at-most",
        list[str],
        "A bound, like total-variation=500, or total-variation=mpc-se: what a controller beside comes to; repeat it.",
        _SEARCH,
        metavar="NAME=X",
    ),
    Option(
        "beside",
        "--beside",
        list[str],
        "A controller with its usual tuning that is shown beside; repeat it for more.",
        _SEARCH,
        metavar="NAME",
        default="mpc-se",
    ),
    Option(
        "sampler",
        "--sampler",
        str,
        "How candidates are proposed: tpe, Parzen estimators; nsga2, evolution; random, chance, which needs no Optuna.",
        _SEARCH,
        metavar="tpe|nsga2|random",
        default="tpe",
    ),
    Option("sampler_seed", "--sampler-seed", int, "Of its chance.", _SEARCH, metavar="N", default="0"),
    Option("batch", "--batch", int, "Candidates that are proposed at a time.", _SEARCH, metavar="N", default="64"),
    Option("rounds", "--rounds", int, "How often, in all.", _SEARCH, metavar="N", default="4"),
    Option(
        "prefer",
        "--prefer",
        str,
        "Which tuning of the front is chosen: the least of one of its objectives, or both, the nearest to the least of "
        "either.",
        _SEARCH,
        metavar="NAME|both",
        default="both",
    ),
)
_TOP: Final = Option("top", "--top", int, "Tunings of the front in the table.", _SEARCH, metavar="N", default="10")


def _options() -> Iterator[Option]:
    settings = {setting.name: setting for setting in controller_entry(_TUNED).settings}
    for option in CASE:
        if option.key in _RANGED:
            default = _RANGED[option.key] or f"kept at {settings[option.key].default.text}"
            yield dataclasses.replace(
                option, kind=str, help=settings[option.key].summary, panel=_TUNING, metavar="RANGE", default=default
            )
        elif option.key in settings:
            setting = settings[option.key]
            choices = f" One of {', '.join(setting.choices)}." if setting.choices else ""
            told = f"{setting.summary}{choices}"
            yield dataclasses.replace(option, help=told, panel=_TUNING, default=setting.default.text)
    yield from (*_OWN, _TOP)
    for option in TRIAL:
        if option.key in _SHARED:
            yield dataclasses.replace(
                option,
                help=_WORDS.get(option.key, option.help),
                panel=_SUBJECTS if option.key == "population" else option.panel,
                default=_DEFAULTS.get(option.key, option.default),
            )


_OPTIONS: Final = tuple(_options())


@with_options(_OPTIONS)
def command(given: Given) -> None:
    """Check what was asked for, search or go on with it, check what was chosen, and tell it."""
    keys, output, file = split_off_output(given)
    top = keys.pop(_TOP.key, 10)
    if top < 1:
        raise ValueError(f"--top is {top}; give 1 or more")
    texts = with_lists(keys), file_keys(file)
    if output.out is None:
        raise ValueError("--out is missing; a search is kept in a folder, name one like --out robust")
    with stage("Importing the simulator"):
        from glucoloop.cli.compiled import keep_compiled

        asked = _read(*texts)
    keep_compiled()
    _carry_out(asked, output, output.out, top)


def _read(keys: Given, of_file: Given) -> Robust:
    from glucoloop.studies.robust.keys import read_robust

    called = names(_OPTIONS, keys)
    together: dict[str, Any] = {**of_file, **{key: value for key, value in keys.items() if value != ()}}
    return read_robust(together, called)


def _carry_out(asked: Robust, output: Output, out: Path, top: int) -> None:
    from glucoloop.studies.robust.folder import robust_folder

    folder, wanted = None, asked.far.rounds * asked.search.batch
    try:
        with robust_folder(out, asked, overwrite=output.overwrite) as folder:
            note(folder.notes)
            if folder.candidates and not folder.finished:
                note([f"{len(folder.candidates)} of {wanted} candidates of {out} are there already; going on."])
            found = _finish(asked, folder, wanted)
    except KeyboardInterrupt:
        if folder is None:
            raise
        interrupted(f"interrupted; {len(folder.candidates)} of {wanted} candidates are kept, the same command goes on")
    _tell(asked, found, output, out, top)


def _finish(asked: Robust, folder: RobustFolder, wanted: int) -> Found:
    """Try what is missing, choose, and check; of a search that was finished before, tell what is there."""
    from glucoloop.studies.robust import SearchEngine, bounds_of
    from glucoloop.studies.robust.results import files_of, found_before, found_of

    if folder.finished:
        note([f"{folder.path} was finished before; nothing is computed again."])
        return found_before(asked, folder)
    with stage("Drawing people, and trying what stands beside"):
        engine = SearchEngine(asked.search)
        references = engine.references()
    if engine.subjects.unable:
        note([f"{engine.subjects.unable} of {asked.own.people} people have no basal rate and are left out."])
    bounds = bounds_of(asked.search, references)
    _search(asked, folder, engine, bounds, wanted)
    with stage("Checking on others"):
        found = found_of(asked, folder.candidates, references, bounds, engine)
    with stage("Drawing"):
        folder.finish(files_of(asked, found))
    return found


def _search(asked: Robust, folder: RobustFolder, engine: SearchEngine, bounds: Sequence[Bound], wanted: int) -> None:
    from glucoloop.cli.search_progress import counted_out

    before = folder.candidates[:]
    with counted_out(len(before), wanted, "candidates") as told:
        for candidate in engine.candidates(asked.far.rounds, bounds, before):
            folder.add(candidate)
            told(len(folder.candidates))


def _tell(asked: Robust, found: Found, output: Output, out: Path, top: int) -> None:
    from glucoloop.cli.telling import print_json
    from glucoloop.studies.robust.folder import CANDIDATES, CONFIGURATION, FINAL
    from glucoloop.studies.robust.results import summary_of
    from glucoloop.studies.robust.table import check_table, robust_table

    files = (*FINAL, CANDIDATES, CONFIGURATION)
    if output.json:
        print_json(summary_of(asked, found), {name: str(out / name) for name in files}, tuple(_notes(asked, found)))
        return
    show(robust_table(asked.search, found.candidates, found.verdict, found.references, top=top))
    show(check_table(found.checked))
    for line in _notes(asked, found):
        print(line)
    print(f"Wrote {', '.join(files)} to {out}.")


def _notes(asked: Robust, found: Found) -> Iterator[str]:
    verdict, objectives = found.verdict, asked.search.objectives
    for bound in found.bounds:
        whose = "" if bound.of is None else f", what {bound.of} comes to"
        yield f"Bound: {bound.objective} at most {bound.most:.4g}{whose}."
    tried, kept = len(found.candidates), int(verdict.keeps.sum())
    told = f"Of {tried} tunings {kept} {'keeps' if kept == 1 else 'keep'} the bounds"
    if not verdict.bounded:
        yield f"{told}; chosen is the one that exceeds them least, candidate {found.chosen.number}."
        return
    preferred = f"the least of {asked.far.prefer}" if asked.far.prefer in objectives else "nearest to the least of both"
    front = f"{int(verdict.front.sum())} make the front of {' and '.join(objectives)}"
    yield (
        f"{f'{told}, and {front}' if found.bounds else f'Of {tried} tunings {front}'}; "
        f"chosen is candidate {found.chosen.number}, {preferred}."
    )
