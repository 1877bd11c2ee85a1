"""A stress test carried out: its numbers and reasons, in tables, sentences, maps and a page."""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import polars as pl

from glucoloop.faults import FAULTS
from glucoloop.metrics.metric import METRICS
from glucoloop.reporting import Repeat
from glucoloop.reporting.columns import (
    Column,
    FittingTable,
    Row,
    decimals,
    headings,
    measured,
    terminal_table,
    terse_percent,
    whole,
    whole_glucose,
)
from glucoloop.reporting.descriptions import controllers_facts, engine_facts, short_names, trial_facts
from glucoloop.reporting.figure_files import figure_files
from glucoloop.reporting.heat import HeatCell, HeatMap, legend_shades, plot_heat_maps, shade_of
from glucoloop.reporting.template import render
from glucoloop.situations.case import Case
from glucoloop.situations.run import intravenous_boluses, steady_without_rhythm
from glucoloop.storage.results import Results
from glucoloop.studies.guarded import WITH_GUARD
from glucoloop.studies.stress import StressTest
from glucoloop.studies.stress.reasons import reason_of
from glucoloop.text import NOT_AVAILABLE, NOT_VALID, how_many, percent, the_first
from glucoloop.trials.engine import prepare
from glucoloop.trials.folder import TrialFolder
from glucoloop.trials.shard import people_table
from glucoloop.trials.trial import Trial
from glucoloop.units import MIN_PER_DAY

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from glucoloop.reporting._style import Width


NO_FAULT: Final = ""
_MAX_MORE_PCT: Final = 1.0
"""Largest increase of the time below 60 mg/dl, in percent of the run, that a fault may cause for a cell to pass."""


@dataclass(frozen=True)
class _StressCell:
    """A controller, with or without a guard, under a fault or none."""

    controller: str
    """Label of the case."""
    guarded: bool
    fault: str
    """Full text of the fault; empty for none."""

    @property
    def label(self) -> str:
        """Label of the case of the trial."""
        return " | ".join(filter(None, (self.controller, "guarded" if self.guarded else "", self.fault)))


def _cells_of(config: StressTest) -> dict[_StressCell, Case]:
    """The case of a trial for each cell."""
    faults = {NO_FAULT: (), **{text: (fault,) for text, fault in zip(config.fault_texts, config.faults, strict=True)}}
    cells = {}
    for case in config.cases:
        for guarded in WITH_GUARD[config.guards]:
            in_cell = config.with_guard(case, guarded)
            for text, fault in faults.items():
                cell = _StressCell(case.label, guarded, text)
                cells[cell] = dataclasses.replace(in_cell, label=cell.label, faults=fault)
    return cells


def trial_of(config: StressTest) -> Trial:
    """Trial with a case for each cell, of which carbohydrate against low glucose is counted where people eat it."""
    counted = () if config.rescue is None else (METRICS.choose("rescues"),)
    return config.with_cases(tuple(_cells_of(config).values()), faults=(), metrics=counted)


def _cell_table(
    cells: Iterable[_StressCell], people: pl.DataFrame, samples: int, days: float, columns: Sequence[Column]
) -> pl.DataFrame:
    """The numbers of each cell, over the people whose glucose stayed finite there and without the fault.

    `people` are those of each cell, from `people_table`; a run has so many samples, and lasts so many days.
    """
    labels = pl.DataFrame([{"label": cell.label, **dataclasses.asdict(cell)} for cell in cells])
    known = people.join(labels, on="label", maintain_order="left")
    known = known.filter("feasible", pl.col("mean_mg_dl").is_finite())
    same = ["controller", "guarded", "person"]
    without = known.filter(fault=NO_FAULT).select(*same, without_pct="time_below_60_pct")
    known = known.join(without, on=same, how="inner", maintain_order="left")
    known = known.with_columns(more_pct=pl.col("time_below_60_pct") - pl.col("without_pct"), samples=samples)
    return measured(known.with_columns(days=days), labels.drop("label"), columns)


def _guarded(row: Row) -> bool:
    return bool(row["guarded"])


def _share(kind: str, short: str | None = None, **others: Any) -> Column:
    """Percentage of the samples that are of a kind."""
    value = 100.0 * pl.col(f"samples_{kind}").mean() / pl.col("samples").first()
    head = kind.removeprefix("dose_")
    return Column(
        name=f"{kind}_pct", value=value, group="Samples (%)", head=head, short=short, short_text=terse_percent, **others
    )


_60, _54, _LOWEST = pl.col("time_below_60_pct"), pl.col("time_below_54_pct"), pl.col("minimum_mg_dl")
_MORE, _PERSON = pl.col("more_pct"), pl.col("person")
_WORSE: Final = _MORE > _MAX_MORE_PCT
_worse_off = functools.partial(Column, group="Worse off", strong=lambda row: bool(row["worse"]))
_below_60 = functools.partial(Column, group="Time below 60 mg/dl (%)", short_text=terse_percent)
_below_54 = functools.partial(Column, group="Time below 54 mg/dl (%)", short_text=terse_percent)
_ever_below = functools.partial(Column, group="People ever below (%)")
_glucose = functools.partial(Column, group="Glucose (mg/dl)", text=whole_glucose)
_events = functools.partial(Column, group="Events", text=whole)
COLUMNS: Final = (
    Column(name="people", value=pl.len(), empty=0, text=whole),
    _worse_off(name="worse", value=_WORSE.sum(), head="people", text=whole, short="worse\noff"),
    Column(
        name="worse_people",
        value=_PERSON.filter(_WORSE).sort_by(_MORE.filter(_WORSE), descending=True, maintain_order=True),
    ),
    _worse_off(name="worst_more_pct", value=_MORE.max(), head="most (%)"),
    _below_60(name="below_60_mean_pct", value=_60.mean(), head="mean", short="<60\nmean"),
    _below_60(name="below_60_worst_pct", value=_60.max(), head="longest", short="<60\nlongest"),
    _below_54(name="below_54_mean_pct", value=_54.mean(), head="mean"),
    _below_54(name="below_54_worst_pct", value=_54.max(), head="longest", short="<54\nlongest"),
    _ever_below(name="ever_below_60_pct", value=100.0 * (_LOWEST < 60.0).mean(), head="60 mg/dl"),
    _ever_below(name="ever_below_54_pct", value=100.0 * (_LOWEST < 54.0).mean(), head="54 mg/dl"),
    Column(
        name="people_below_validity",
        value=(pl.col("time_below_validity_pct") > 0.0).sum(),
        group="Model not valid",
        head="people",
        text=whole,
    ),
    _glucose(
        name="lowest_mg_dl",
        # below 0 it is no concentration: the model is not valid
        value=pl.when(_LOWEST.min() >= 0.0).then(_LOWEST.min()),
        head="lowest",
        missing=lambda row: NOT_VALID if row["people"] else NOT_AVAILABLE,
        short="lowest\nmg/dl",
    ),
    _glucose(name="lowest_person", value=_PERSON.get(_LOWEST.arg_min()), head="of person", text=whole),
    _glucose(name="highest_mg_dl", value=pl.col("peak_mg_dl").max(), head="highest"),
    _events(name="low_events", value=pl.col("low_events").sum().cast(pl.Int64), head="low", short="low\nevents"),
    _events(name="very_low_events", value=pl.col("very_low_events").sum().cast(pl.Int64), head="very low"),
    _share("saturated", "\nsat."),
    _share("missing"),
    _share("rejected"),
    _share("fallback", "fall\nback", only=_guarded),
    _share("suspended", "\nsusp.", only=_guarded),
    _share("dose_limited"),
)
"""The numbers of a cell, of which the people who were worse off come first."""
_RESCUE: Final = Column(
    name="rescue_g_day",
    value=pl.col("rescue_carbs_g").mean() / pl.col("days").first(),
    group="Rescue carbohydrate",
    head="g/day",
    text=decimals(1),
    short="rescue\ng/day",
)


_GLUCAGON: Final = Column(
    name="glucagon_ug_day",
    value=pl.col("glucagon_total_ug").mean() / pl.col("days").first(),
    group="Glucagon",
    head="ug/day",
    text=decimals(0),
    short="glucagon\nug/day",
)


def _columns_of(config: StressTest) -> tuple[Column, ...]:
    """Numbers of a cell, with carbohydrate against low glucose and glucagon where there are any."""
    further = [column for column, given in ((_RESCUE, config.rescue), (_GLUCAGON, config.glucagon)) if given]
    return (*COLUMNS, *further)


_GUARDS: Final = {False: "without the guard", True: "with the guard"}
_ACTS: Final = ("rejected", "fallback", "suspended", "dose_limited")
"""Acts of a guard on a reading or a dose, by the names of their columns."""
_MAX_LISTED: Final = 5
_MAX_NAMED: Final = 20


def notes(config: StressTest) -> tuple[str, ...]:
    """Notes on intravenous boluses, and on rhythms."""
    return (*intravenous_boluses(config), *steady_without_rhythm(config))


def results_of(config: StressTest, folder: TrialFolder) -> Results:
    """Numbers of each cell, and why the worst-off person of each guarded cell that fails was worse off."""
    cells, people, base = list(_cells_of(config)), people_table(folder.people()), config.base
    days = folder.trial.horizon_min / MIN_PER_DAY
    table = _cell_table(cells, people, folder.trial.samples, days, _columns_of(config))
    prepared = prepare(folder.trial)
    reasons = [
        {
            "controller": cell.controller,
            "fault": cell.fault,
            "person": row["worse_people"][0],
            "more_pct": row["worst_more_pct"],
            "text": reason_of(prepared, cell.label, row["worse_people"][0]),
        }
        for cell, row in zip(cells, table.to_dicts(), strict=True)
        if cell.guarded and row["worse"]
    ]
    designed = {cell.controller: prepared.computed_settings[cell.label] for cell in cells}
    facts = {
        **controllers_facts(base.cases, designed, base.start_min or 0.0),
        **trial_facts(base),
        **engine_facts(prepared.engines),
    }
    del facts["Faults"]  # those of the base; the page lists the faults of the test
    plain = {
        "facts": facts,
        "people": config.people,
        # who has a basal rate does not depend on the cell
        "able": people.filter(label=cells[0].label)["feasible"].sum(),
        "rows": table.to_dicts(),
        "reasons": reasons,
        "repeat": "glucoloop stress --config stress.toml --out again",
    }
    return Results(plain, {"stress.csv": table, "stress.parquet": table})


class _Grid:
    """The cells of a stress test in their places."""

    def __init__(self, results: Results) -> None:
        self.rows = {_StressCell(row["controller"], row["guarded"], row["fault"]): row for row in results.rows}
        self.controllers = list(dict.fromkeys(cell.controller for cell in self.rows))
        self.guards = sorted({cell.guarded for cell in self.rows})
        faults = dict.fromkeys(cell.fault for cell in self.rows if cell.fault != NO_FAULT)
        self.names = {NO_FAULT: "no fault", **short_names(list(faults))}
        """Short name of each fault, that of no fault first."""

    def pair(self, controller: str, fault: str) -> list[Row]:
        """A controller under a fault, without and with the guard, as far as they were tried."""
        return [self.rows[_StressCell(controller, guarded, fault)] for guarded in self.guards]

    def sections(self) -> list[tuple[str, list[tuple[str, list[Row]]]]]:
        """Each controller with the pairs of all faults."""
        return [
            (controller, [(name, self.pair(controller, fault)) for fault, name in self.names.items()])
            for controller in self.controllers
        ]

    def under_faults(self, guarded: bool) -> list[Row]:
        """All cells with a fault, those that increase the time below 60 mg/dl most first."""
        rows = [row for cell, row in self.rows.items() if cell.fault != NO_FAULT and cell.guarded == guarded]
        return sorted(rows, key=lambda row: -(row["worst_more_pct"] or 0.0))


def tables(config: StressTest, results: Results) -> Iterator[FittingTable]:
    """A section for each controller and a line for each fault, without and with the guard side by side."""
    grid = _Grid(results)
    which = (
        "In each pair a|b, a is without the guard and b with it."
        if len(grid.guards) > 1
        else f"All numbers are {_GUARDS[grid.guards[0]]}."
    )
    yield terminal_table(
        "Fault",
        grid.sections(),
        _columns_of(config),
        caption=f"{which} Worse off: people whose time below 60 mg/dl was longer by over {_MAX_MORE_PCT:g} % of the "
        "run than without the fault. <60, <54: time below 60 or 54 mg/dl in percent of the run, as the mean over the "
        "people and for the person with the longest time. Low events: periods of 15 min or longer below 70 mg/dl, "
        "summed over all people. Saturated (dose at the pump's limits), fallback (at most the basal rate "
        "for want of readings), suspended (the guard stopped insulin): percentage of the samples.",
    )


def sentences(config: StressTest, results: Results) -> Iterator[str]:
    """Conclusions, and the reasons why people were worse off with the guard."""
    yield from _conclusions(results)
    names = _Grid(results).names
    for reason in results.plain["reasons"]:
        [who] = config.population.called(config.seed, [reason["person"]])
        yield (
            f"{reason['controller']} under {names[reason['fault']]}, with the guard: person {who}, below "
            f"60 mg/dl for {percent(reason['more_pct'])} of the run longer. {reason['text']}"
        )


def _conclusions(results: Results) -> Iterator[str]:
    """Conclusions in sentences; every number is computed."""
    grid = _Grid(results)
    yield from _left_out(results)
    if results.plain["able"]:
        yield from _passing(grid) if len(grid.names) > 1 else ["No fault was tried."]
        yield from _failing(grid)
        yield from _harm_of_the_guard(grid)
        yield from _without_a_fault(grid)
        yield from _beyond_the_model(grid)


def _left_out(results: Results) -> Iterator[str]:
    """Sentences on people who are in no cell, or not in all."""
    people, feasible = results.plain["people"], results.plain["able"]
    if missing := people - feasible:
        yield (
            f"{missing} of {how_many(people, 'person', 'people')} {'has' if missing == 1 else 'have'} no basal rate "
            f"for the setpoint and {'was' if missing == 1 else 'were'} left out."
        )
    lost = {cell: row for cell, row in _Grid(results).rows.items() if row["people"] < feasible}
    if lost:
        fewest = min(int(row["people"]) for row in lost.values())
        where = _one_of([cell.label for cell, row in lost.items() if row["people"] == fewest])
        yield (
            f"In {len(lost)} of {len(results.rows)} combinations the glucose of some people, "
            f"{feasible - fewest} of {how_many(feasible, 'person', 'people')} at most ({where}), "
            "did not stay a finite number, with or without the fault; they are in no number there."
        )


def _passing(grid: _Grid) -> Iterator[str]:
    texts: list[str] = []
    for guarded in reversed(grid.guards):
        tried_rows = [row for row in grid.under_faults(guarded) if row["people"]]
        passing = f"{_GUARDS[guarded].capitalize()}, {sum(not row['worse'] for row in tried_rows)} of {len(tried_rows)}"
        texts.append(
            f"{passing} passed."
            if texts
            else f"{passing} combinations of a controller and a fault passed: with the fault, nobody's time below "
            f"60 mg/dl was longer by more than {_MAX_MORE_PCT:g} % of the run than without it."
        )
    unknown = sum(not row["people"] for row in grid.under_faults(grid.guards[-1]))
    if unknown:
        texts.append(f"In {how_many(unknown, 'further combination')} nobody could take part.")
    yield " ".join(texts)


def _failing(grid: _Grid) -> Iterator[str]:
    guarded = grid.guards[-1]
    rows = [row for row in grid.under_faults(guarded) if row["worse"]]
    if rows:
        listed = [f"{row['controller']} under {grid.names[row['fault']]} ({_worse_text(row)})" for row in rows]
        more = f"; and {len(rows) - _MAX_LISTED} more" if len(rows) > _MAX_LISTED else ""
        yield f"Combinations that failed {_GUARDS[guarded]}: {'; '.join(listed[:_MAX_LISTED])}{more}."


def _harm_of_the_guard(grid: _Grid) -> Iterator[str]:
    """Sentence on harm by the guard; the absence of harm is stated too, since the test looks for it."""
    pairs = [grid.pair(controller, fault) for controller in grid.controllers for fault in grid.names]
    pairs = [pair for pair in pairs if len(pair) > 1 and all(row["people"] for row in pair)]
    longer = [(row["below_60_mean_pct"] - bare["below_60_mean_pct"], row) for bare, row in pairs]
    longer = [(difference, row) for difference, row in longer if difference > 0.0]
    if longer:
        most = max(difference for difference, _ in longer)
        where = _one_of(
            [
                f"{row['controller']} {'under' if row['fault'] else 'with'} {grid.names[row['fault']]}"
                for difference, row in longer
                if difference == most
            ]
        )
        yield (
            f"In {len(longer)} of {len(pairs)} combinations, those without a fault included, the mean time below "
            f"60 mg/dl was longer with the guard than without it: by at most {percent(most)} of the run, in {where}."
        )
    elif pairs:
        yield "In no combination, with or without a fault, did the guard lengthen the mean time below 60 mg/dl."


def _without_a_fault(grid: _Grid) -> Iterator[str]:
    """Sentences on the effect of the guard without a fault."""
    texts, acts = [], []
    for controller in grid.controllers:
        pair = [row for row in grid.pair(controller, NO_FAULT) if row["people"]]
        if pair:
            below = _change([percent(row["below_60_worst_pct"]) for row in pair])
            highest = _change([whole_glucose(row["highest_mg_dl"]) for row in pair])
            texts.append(f"{controller}: {below} and {highest} mg/dl")
            # each sample has one status
            acted = [sum(float(row[f"{act}_pct"]) for act in _ACTS) for row in pair if row["guarded"]]
            acts += [f"{percent(share)} with {controller}" for share in acted]
    if texts:
        how = " (without → with the guard)" if len(grid.guards) > 1 else ""
        yield (
            "Without a fault, the longest time that a person spent below 60 mg/dl, and the highest "
            f"glucose{how}, were {'; '.join(texts)}."
            + (f" The guard then acted at this percentage of the samples: {'; '.join(acts)}." if acts else "")
        )


def _beyond_the_model(grid: _Grid) -> Iterator[str]:
    beyond = {cell: row for cell, row in grid.rows.items() if row["people_below_validity"]}
    if beyond:
        most = max(int(row["people_below_validity"]) for row in beyond.values())
        most_rows = {cell.label: row for cell, row in beyond.items() if row["people_below_validity"] == most}
        row = next(iter(most_rows.values()))
        yield (
            f"In {len(beyond)} of {len(grid.rows)} combinations glucose fell below the valid range of the patient's "
            f"model, for at most {row['people_below_validity']} of {how_many(row['people'], 'person', 'people')} "
            f"({_one_of(list(most_rows))}). Read it as severe hypoglycemia; its depth means nothing."
        )


def _one_of(labels: Sequence[str]) -> str:
    """The first of combinations that share an extreme, and the number of the others."""
    return labels[0] if len(labels) == 1 else f"{labels[0]} and {len(labels) - 1} more"


def _change(texts: Sequence[str]) -> str:
    return texts[0] if len(set(texts)) == 1 else " → ".join(texts)


def _worse_text(row: Row) -> str:
    """Number of people who were worse off, and the largest difference."""
    return (
        f"{row['worse']} of {how_many(row['people'], 'person', 'people')} worse off, by at most "
        f"{percent(row['worst_more_pct'])} of the run"
    )


def _worse_people_text(row: Row) -> str:
    """Numbers of the people who were worse off, shortened if there are many."""
    return the_first([str(person) for person in row["worse_people"]], _MAX_NAMED)


def _maps(results: Results) -> list[HeatMap]:
    """Longest time of a person below 60 mg/dl, without the guard and with it: faults in rows, controllers across."""
    grid = _Grid(results)
    faults = {name: fault for fault, name in grid.names.items()}
    longest = next(column for column in COLUMNS if column.name == "below_60_worst_pct")

    def map_of(guarded: bool) -> HeatMap:
        def cell(name: str, controller: str) -> HeatCell:
            row = grid.rows[_StressCell(controller, guarded, faults[name])]
            lines = [f"{controller}, {name}, {_GUARDS[guarded]}"]
            for group, columns in headings(COLUMNS):
                lines.append(f"{group}: {', '.join(f'{column.head} {column.value_text(row)}' for column in columns)}")
            mark = f"▲{row['worse']}" if row["worse"] else ""
            return HeatCell(shade_of(row[longest.name]), longest.value_text(row), mark, "\n".join(lines))

        return HeatMap(_GUARDS[guarded].capitalize(), list(faults), grid.controllers, cell)

    return [map_of(guarded) for guarded in grid.guards]


def _plot_stress(results: Results, *, title: str | None = None, width: Width = "double") -> Figure:
    """Draw the maps of a stress test; see `plot_heat_maps`."""
    return plot_heat_maps(
        _maps(results),
        what="of the run below 60 mg/dl",
        mark=f"people below for {_MAX_MORE_PCT:g} % of the run longer than without the fault",
        title=title,
        width=width,
    )


def page(config: StressTest, results: Results) -> str:
    """The page of a stress test: one file that needs neither network nor script."""
    grid, heat_maps = _Grid(results), _maps(results)
    files = {"stress.csv": "all numbers of each cell", "summary.json": "the same, with the reasons"}
    reasons = {(reason["controller"], reason["fault"]): reason for reason in results.plain["reasons"]}
    failing = [row for row in grid.under_faults(True) if row["worse"]]
    values: dict[str, Any] = {
        "grid": grid,
        "start_min": config.start_min or 0.0,
        "guards": _GUARDS,
        "people": max(row["people"] for row in results.rows),
        "most_more_pct": f"{_MAX_MORE_PCT:g}",
        "maps": heat_maps,
        "shades": legend_shades(heat_maps),
        "reasons": [(row, grid.names[row["fault"]], reasons[row["controller"], row["fault"]]) for row in failing],
        "worse_text": _worse_text,
        "worse_people_text": _worse_people_text,
        "bodies": {
            controller: [
                (name, [("with" if row["guarded"] else "without", row) for row in pair]) for name, pair in lines
            ]
            for controller, lines in grid.sections()
        },
        "columns": _columns_of(config),
        "faults": [(name, FAULTS.choose(fault)) for fault, name in grid.names.items() if fault != NO_FAULT],
    }
    return render(
        Path(__file__).with_name("page.html"),
        "Stress test",
        sentences=_conclusions(results),
        facts=results.plain["facts"],
        repeat=Repeat("stress --config stress.toml", config.tree(whole=True), files, explicit=config.tree()),
        **values,
    )


def files_of(config: StressTest, results: Results) -> dict[str, bytes]:
    """Page and figure, by the names of their files."""
    return {"stress.html": page(config, results).encode(), **figure_files("figure", _plot_stress(results))}
