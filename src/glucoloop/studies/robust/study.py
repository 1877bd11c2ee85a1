"""A search for a robust tuning as a study: its configuration, tables, sentences and files."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np

from glucoloop.control.catalogue import SEARCHED
from glucoloop.parts.setting import known_names
from glucoloop.printable import NOT_AVAILABLE, how_many
from glucoloop.refusal import Refusal
from glucoloop.report.columns import Column, FittingTable, Line, terminal_table
from glucoloop.report.print_figure import figure_files
from glucoloop.situations.case import Case
from glucoloop.situations.run import Run
from glucoloop.situations.toml import toml_text
from glucoloop.storage.findings import Findings
from glucoloop.studies.robust import Search
from glucoloop.studies.robust.figure import plot_robust
from glucoloop.studies.robust.search import AS_IT_WAS, CHOSEN, OBJECTIVES, SearchEngine, objective, rows_of


def notes(asked: Search) -> tuple[str, ...]:
    """Refuse what is missing before anything is drawn; who is left out is known when people are."""
    for name in asked.objectives:
        objective(name)
    for text, (name, _) in zip(asked.at_most, asked.bounds, strict=True):
        if name not in OBJECTIVES:
            raise Refusal(f"--at-most is {text!r}: unknown objective {name!r}; {known_names(name, OBJECTIVES)}")
    asked.sampler.made(space=asked.space, batch=asked.batch)  # refuses a library that is missing
    return ()


rows = rows_of
search = SearchEngine


def tables(asked: Search, found: Findings) -> Iterator[FittingTable]:
    """The front in order of its first objective, the initial tuning and the references; and all on others."""
    plain = found.plain
    columns = [
        Column(name="candidate", short="Candidate", text=str, only=lambda row: "candidate" in row),
        *(
            Column(name=name, short=name.replace("_", "\n"), text="{:.4g}".format, only=lambda row: "candidate" in row)
            for name in (tuned.name for tuned in asked.space)
        ),
        *OBJECTIVES.values(),
    ]
    chosen, start = plain["chosen"]["candidate"], plain["as_it_was"]
    front = _thinned(plain["front"], asked.top, chosen) or [plain["chosen"]]
    sections: list[list[Line]] = [
        [_line(CHOSEN if one["candidate"] == chosen else "", one) for one in front],
        [] if start is None or start["candidate"] == chosen else [_line(AS_IT_WAS, start)],
        [(label, [scores]) for label, scores in plain["beside"].items()],
    ]
    yield terminal_table("", [("", lines) for lines in sections if lines], columns)
    check = [(label, [scores]) for label, scores in plain["check"].items()]
    yield terminal_table("Never seen before", [("", check)], columns)


def _line(name: str, candidate: Mapping[str, Any]) -> Line:
    return name, [{"candidate": candidate["candidate"], **candidate["tuning"], **candidate["scores"]}]


def _thinned(front: Sequence[Mapping[str, Any]], top: int, chosen: int) -> list[Mapping[str, Any]]:
    """Some tunings of the front, evenly spread, with its ends and the chosen one."""
    number = len(front) if len(front) <= top else max(top - 1, 1)
    places = np.linspace(0, len(front) - 1, number).round().astype(int).tolist()
    return [candidate for place, candidate in enumerate(front) if place in places or candidate["candidate"] == chosen]


def sentences(asked: Search, found: Findings) -> Iterator[str]:
    """Conclusions on the bounds, the front and the choice."""
    plain, objectives, prefer = found.plain, asked.objectives, asked.prefer
    for bound in plain["bounds"]:
        whose = "" if bound["of"] is None else f", what {bound['of']} comes to"
        most = NOT_AVAILABLE if bound["at_most"] is None else f"{bound['at_most']:.4g}"
        yield f"Bound: {bound['objective']} at most {most}{whose}."
    chosen, number = plain["chosen"]["candidate"], how_many(plain["candidates"], "tuning")
    keeping = f"Of {number} {how_many(plain['keeping_the_bounds'], 'keeps', 'keep')} the bounds"
    if not plain["chosen"]["keeps_the_bounds"]:
        yield f"{keeping}; chosen is the one that exceeds them least, candidate {chosen}."
        return
    preferred = f"the least of {prefer}" if prefer in objectives else "nearest to the least of both"
    front = f"{how_many(len(plain['front']), 'makes', 'make')} the front of {' and '.join(objectives)}"
    yield (
        f"{f'{keeping}, and {front}' if plain['bounds'] else f'Of {number} {front}'}; "
        f"chosen is candidate {chosen}, {preferred}."
    )


def drawn(asked: Search, found: Findings) -> dict[str, bytes]:
    """The chosen tuning as the configuration of a run, and the figure."""
    trial, case = asked.trial, asked.tuned
    people = how_many(asked.people, "person", "people")
    title = (
        f"{case.label}: {how_many(found.plain['candidates'], 'tuning')}, {people} of {trial.population.name} and "
        f"{how_many(asked.seeds, 'seed')} of noise {trial.noise_variance:g} (mg/dl)²"
    )
    best = _best(asked, found.plain["chosen"]["tuning"])
    return {
        "best.toml": toml_text(best.tree(whole=True), "run --config best.toml", best.tree()).encode(),
        **figure_files("front", plot_robust(asked, found, title=title)),
    }


def _best(asked: Search, tuning: Mapping[str, float]) -> Run:
    """The run of the nominal patient, in the same situation, with a tuning."""
    controller = SEARCHED.partial({**asked.tuned.controller.given, **tuning})
    case = Case.partial({**asked.case.given, "controller": controller})
    names = [name for name in asked.given if name in Run.settings()]
    shared = {name: getattr(asked, name) for name in dict.fromkeys([*names, "sensor", "meals", "duration_min"])}
    return Run.partial({**shared, "controller": (case,)}).completed()
