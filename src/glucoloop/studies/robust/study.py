"""A search for a robust tuning as a study: its configuration, tables, sentences and files."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np

from glucoloop.config.cases import CASES_KEY
from glucoloop.config.checked import checked
from glucoloop.config.key import declared, own_keys
from glucoloop.config.run import read_run, refuse_unknown_beside
from glucoloop.config.toml import toml_text
from glucoloop.config.trial import read_trial, with_people
from glucoloop.control.catalogue import SEARCHED, controller_entry
from glucoloop.parts.number_text import number_of
from glucoloop.parts.ranges import Tuned, parse_range
from glucoloop.parts.setting import known_names
from glucoloop.printable import NOT_AVAILABLE, how_many
from glucoloop.refusal import Refusal
from glucoloop.report.columns import Column, FittingTable, Line, Row, terminal_table
from glucoloop.report.print_figure import figure_files
from glucoloop.storage.findings import Findings
from glucoloop.storage.rows import Rows
from glucoloop.studies.robust import BOTH, RANGES, ROBUST, TAKEN, HowFar, RobustSettings, Shown
from glucoloop.studies.robust.figure import plot_robust
from glucoloop.studies.robust.objectives import OBJECTIVES, objective
from glucoloop.studies.robust.search import AS_IT_WAS, CHOSEN, Candidate, Search, SearchEngine
from glucoloop.tuning.samplers import library


def read(
    keys: Mapping[str, Any], cases: Sequence[Mapping[str, Any]] = (), names: Mapping[str, str] | None = None
) -> Search:
    """Read a search, in which a number that can be tuned is a range or one number that is kept; Refusal if wrong."""
    settings = SEARCHED.settings()
    known = [*declared(RobustSettings), *declared(HowFar), *declared(Shown), *TAKEN, *settings]
    refuse_unknown_beside({**keys, **({CASES_KEY: cases} if cases else {})}, known, " of a search")
    called = {key: (names or {}).get(key, key) for key in known}
    own = checked(RobustSettings, own_keys(keys, RobustSettings), names)
    far = checked(HowFar, own_keys(keys, HowFar), names)
    shown = checked(Shown, own_keys(keys, Shown), names)
    _refuse_shared_subjects(own)
    if len(set(own.objectives)) != 2 or len(own.objectives) != 2:
        told = ", ".join(own.objectives)
        raise Refusal(
            f"{called['objectives']} is {told}; give two objectives that differ, and others as bounds by --at-most"
        )
    for name in own.objectives:
        objective(name)
    if far.prefer not in (*own.objectives, BOTH):
        raise Refusal(f"{called['prefer']} is {far.prefer!r}; give {', '.join(own.objectives)} or {BOTH}")
    for name in own.beside:
        controller_entry(name)
    if len(set(own.beside)) < len(own.beside) or SEARCHED.name in own.beside:
        raise Refusal(
            f"{called['beside']} is {', '.join(own.beside)}; name each controller once, and {SEARCHED.name} not at "
            "all, since it is tuned"
        )
    space, fixed = _space({key: keys[key] for key in RANGES if key in keys}, called)
    others = {name: keys[name] for name in settings if name in keys and name not in RANGES}
    shared = {**ROBUST.usual, **{key: keys[key] for key in TAKEN if keys.get(key) is not None}}
    tuned = {"label": SEARCHED.name, "controller": SEARCHED.name, **others, **fixed}
    trial = read_trial(
        {**shared, "people": own.people, "seed": own.people_seed},
        [tuned, *({"label": name, "controller": name} for name in own.beside)],
        names,
    )
    if own.sampler != "random":
        library()
    return Search(
        trial=trial,
        space=space,
        at_most=tuple(_bound(text, own.beside, called["at_most"]) for text in own.at_most),
        own=own,
        far=far,
        top=shown.top,
        given=with_people({key: value for key, value in keys.items() if key not in declared(Shown)}, trial.population),
    )


def _refuse_shared_subjects(own: RobustSettings) -> None:
    if own.people_seed == own.check_people_seed:
        raise Refusal(
            f"people are drawn with the seed {own.people_seed} for the search and for the check; "
            "give another seed for one of them"
        )
    searched, of_check = (own.first_seed, own.seeds), (own.check_first_seed, own.check_seeds)
    (first, seeds), (second, _) = sorted((searched, of_check))
    if first + seeds > second:
        raise Refusal(
            f"the noise of seed {second} is met in the search and in the check; move the first seed of one of them"
        )


def _space(told: Mapping[str, object], called: Mapping[str, str]) -> tuple[tuple[Tuned, ...], dict[str, float]]:
    """Ranges of the tuned numbers, and values of the fixed ones."""
    space, fixed = {of.name: of for of in RANGES.values() if of.unasked}, {}
    for key, value in told.items():
        if isinstance(value, bool) or not isinstance(value, str | int | float):
            raise Refusal(f"{called[key]} is {value!r}; write it like '.1:2', or one number that is kept")
        read = parse_range(value, RANGES[key], called[key]) if isinstance(value, str) else float(value)
        if isinstance(read, Tuned):
            space[key] = read
        else:
            space.pop(key, None)
            fixed[key] = read
    if not space:
        raise Refusal("nothing is tuned; give at least one range, like .1:2, in place of a number")
    return tuple(space[name] for name in RANGES if name in space), fixed


def _bound(text: str, beside: Sequence[str], called: str) -> tuple[str, float | str]:
    name, _, most = (part.strip() for part in text.partition("="))
    if not most:
        raise Refusal(f"{called} is {text!r}; write it like total-variation=500, or total-variation=mpc-se")
    if name not in OBJECTIVES:
        raise Refusal(f"{called} is {text!r}: unknown objective {name!r}; {known_names(name, OBJECTIVES)}")
    if most in beside:
        return name, most
    try:
        number = number_of(most, float)
    except ValueError:
        number = float("nan")
    if number != number:
        raise Refusal(
            f"{called} is {text!r}, where {most!r} is neither a number nor a controller that stands beside: "
            f"{', '.join(beside) or 'there are none'}"
        )
    return name, number


def notes(asked: Search) -> tuple[str, ...]:
    """Return no sentence; who is left out is known when people are drawn."""
    return ()


def rows(asked: Search) -> Rows[Candidate]:
    """The rows that are kept: each candidate with its round, its tuning and its objectives."""
    return asked.rows()


def search(asked: Search) -> SearchEngine:
    """Draw the people, and try the reference controllers."""
    return SearchEngine(asked)


def tables(asked: Search, found: Findings) -> Iterator[FittingTable]:
    """The front in order of its first objective, the initial tuning and the references; and all on others."""
    of = found.plain
    columns = [
        Column(name="candidate", short="Candidate", text=str, only=_is_candidate),
        *(
            Column(name=of.name, short=of.name.replace("_", "\n"), text="{:.4g}".format, only=_is_candidate)
            for of in asked.space
        ),
        *OBJECTIVES.values(),
    ]
    chosen, start = of["chosen"]["candidate"], of["as_it_was"]
    front = _thinned(of["front"], asked.top, chosen) or [of["chosen"]]
    sections: list[list[Line]] = [
        [_line(CHOSEN if one["candidate"] == chosen else "", one) for one in front],
        [] if start is None or start["candidate"] == chosen else [_line(AS_IT_WAS, start)],
        [(label, [scores]) for label, scores in of["beside"].items()],
    ]
    yield terminal_table("", [("", lines) for lines in sections if lines], columns)
    check = [(label, [scores]) for label, scores in of["check"].items()]
    yield terminal_table("Never seen before", [("", check)], columns)


def _is_candidate(row: Row) -> bool:
    return "candidate" in row


def _line(name: str, of: Mapping[str, Any]) -> Line:
    return name, [{"candidate": of["candidate"], **of["tuning"], **of["scores"]}]


def _thinned(front: Sequence[Mapping[str, Any]], top: int, chosen: int) -> list[Mapping[str, Any]]:
    """Some tunings of the front, evenly spread, with its ends and the chosen one."""
    number = len(front) if len(front) <= top else max(top - 1, 1)
    kept = np.linspace(0, len(front) - 1, number).round().astype(int).tolist()
    return [of for at, of in enumerate(front) if at in kept or of["candidate"] == chosen]


def sentences(asked: Search, found: Findings) -> Iterator[str]:
    """Conclusions on the bounds, the front and the choice."""
    of, objectives, prefer = found.plain, asked.own.objectives, asked.far.prefer
    for bound in of["bounds"]:
        whose = "" if bound["of"] is None else f", what {bound['of']} comes to"
        most = NOT_AVAILABLE if bound["at_most"] is None else f"{bound['at_most']:.4g}"
        yield f"Bound: {bound['objective']} at most {most}{whose}."
    chosen, tried = of["chosen"]["candidate"], how_many(of["candidates"], "tuning")
    told = f"Of {tried} {how_many(of['keeping_the_bounds'], 'keeps', 'keep')} the bounds"
    if not of["chosen"]["keeps_the_bounds"]:
        yield f"{told}; chosen is the one that exceeds them least, candidate {chosen}."
        return
    preferred = f"the least of {prefer}" if prefer in objectives else "nearest to the least of both"
    front = f"{how_many(len(of['front']), 'makes', 'make')} the front of {' and '.join(objectives)}"
    yield (
        f"{f'{told}, and {front}' if of['bounds'] else f'Of {tried} {front}'}; "
        f"chosen is candidate {chosen}, {preferred}."
    )


def drawn(asked: Search, found: Findings) -> dict[str, bytes]:
    """The chosen tuning as the configuration of a run, and the figure."""
    own, trial, case = asked.own, asked.trial, asked.case
    title = (
        f"{case.label}: {how_many(found.plain['candidates'], 'tuning')}, {how_many(own.people, 'person', 'people')} of "
        f"{trial.population.name} and {how_many(own.seeds, 'seed')} of noise {trial.noise_variance:g} (mg/dl)²"
    )
    shared = {key: value for key, value in asked.shared().items() if key != "population" and value is not None}
    tuning = {**case.tuning, **found.plain["chosen"]["tuning"]}
    best = read_run({**shared, "controller": case.controller, **tuning})
    return {
        "best.toml": toml_text(best.keys(), "run --config best.toml").encode(),
        **figure_files("front", plot_robust(asked, found, title=title)),
    }
