"""Tables and sentences of a league, its figure and its page."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from itertools import groupby
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from glucoloop.reporting import Repeat
from glucoloop.reporting.columns import Column, FittingTable, Row, headings, terminal_table
from glucoloop.reporting.figure_files import figure_files
from glucoloop.reporting.heat import SHADES_PCT, UNKNOWN, HeatCell, HeatMap, plot_heat_maps
from glucoloop.reporting.template import render
from glucoloop.situations.case import label_of
from glucoloop.storage.results import Results
from glucoloop.studies.league import League, reach, texts
from glucoloop.studies.league.numbers import ALL, COLUMNS, DESIGN, GLUCAGON, RESCUE, signed
from glucoloop.text import NOT_AVAILABLE, how_many, the_first

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from glucoloop.reporting._style import Width


def columns_of(config: League) -> tuple[Column, ...]:
    """Numbers of each line, with the distance to the best doses where those are asked for."""
    further = [column for column, given in ((RESCUE, config.rescue), (GLUCAGON, config.glucagon)) if given]
    return (DESIGN, *COLUMNS, *further, *(reach.COLUMNS if config.bound_people else ()))


def _by_family(config: League, results: Results) -> dict[str, list[Row]]:
    return {name: [row for row in results.rows if row["family"] == name] for name in config.family_names}


def _cell_name(row: Row) -> str:
    """Sensor and scenario of a row, or both together."""
    return "all cells" if row["sensor"] == ALL else f"{row['sensor']}, {row['scenario']}"


def tables(config: League, results: Results) -> Iterator[FittingTable]:
    """A section for each family and a line for each controller, over all cells."""
    sections = [
        (family, [(row["controller"], [row]) for row in rows if row["sensor"] == ALL])
        for family, rows in _by_family(config, results).items()
    ]
    yield terminal_table(
        "Controller",
        sections,
        columns_of(config),
        caption=f"Over all sensors and scenarios. In bold: on target (Battelino et al., 2019). Harmed: people below 54 "
        f"or 70 mg/dl for over {config.worse_by_pct:g} % of the time longer than under {config.reference_label}. Less "
        "ref.: the mean difference from it. GRI: glycemia risk index, 0 is best.",
    )
    if results.plain["nearest"]:
        yield terminal_table(
            "Family",
            [("", [(row["family"], [row]) for row in results.plain["nearest"] if row["scenario"] == ALL])],
            reach.NEAREST,
            caption=reach.CAPTION,
        )


def sentences(config: League, results: Results) -> Iterator[str]:
    """Conclusions: the controllers that are best for whom, where each does harm, and those that take no part."""
    yield from _verdicts(results)
    yield from _harms(config, results)
    yield from results.plain["absent"]


def _harmed(number: int) -> str:
    return f"{number or 'nobody'} {'are' if number > 1 else 'is'}"


def _harms(config: League, results: Results) -> Iterator[str]:
    for row in results.plain["harms"]:
        if row["equal_cells"] > 1:
            which = f"{row['equal_cells']} cells have as much harm, and one of them"
        else:
            which = f"the cell with {'the most' if row['harmed_cells'] > 1 else 'any'} harm"
        yield (
            f"{row['controller']}: {which} is {row['family']} ({_cell_name(row)}). Of "
            f"{how_many(row['people'], 'person', 'people')}, {_harmed(row['harmed_below_54'])} below 54 mg/dl, and "
            f"{_harmed(row['harmed_below_70'])} below 70 mg/dl, for over {config.worse_by_pct:g} % of the time longer "
            f"than under {config.reference_label}.{_below_54(row) if row['harmed_below_54'] else ''}"
        )


def _below_54(row: Row) -> str:
    median, p95, most = (signed(row[f"more_below_54_{name}_pct"]) for name in ("median", "p95", "most"))
    return (
        f" Below 54 mg/dl that is {median} % for the median of all people, {p95} % at the 95th percentile, and "
        f"{most} % at most."
    )


def _verdicts(results: Results) -> Iterator[str]:
    """Best overall, best for the worst-off, for how many people each is best, and whom the best one harms."""
    harmed = {
        (row["family"], row["controller"]): row["harmed_below_54"] for row in results.rows if row["sensor"] == ALL
    }
    for of in results.plain["rankings"]:
        if not of["people"]:
            yield f"{of['family']}: nobody's numbers are known under all controllers that took part in all cells."
            continue
        best, worst = of["overall"]["best"], of["worst_off"]
        whom = sorted(((number, label) for label, number in of["for_whom"].items() if number), reverse=True)
        best_for = "; ".join(f"{label} for {number}" for number, label in whom) or "no single controller for anybody"
        number = harmed[of["family"], best]
        harm = how_many(number, "person is", "people are") if number else "nobody is"
        yield (
            f"{of['family']}: best overall is {_first(of['overall'])}. For the worst-off tenth, "
            f"{how_many(worst['people'], 'person', 'people')}, it is {_first(worst)}. Of "
            f"{how_many(of['people'], 'person', 'people')}, the minimum index is with {best_for}."
            f"{'' if number is None else f' With {best} {harm} harmed below 54 mg/dl.'}"
        )


def _first(of: Mapping[str, Any]) -> str:
    """The best controller, and how far ahead of the next it is; or all those that share the minimum."""
    index = f"a glycemia risk index of {of['gri'][of['best']]:.1f}"
    if of.get("equal"):
        return f"shared by {the_first(of['equal'])}, each with {index}"
    best = f"{of['best']} with {index}"
    if "second" not in of:
        return f"{best}, the only one"
    interval = "" if of["low"] is None else f" (95 % interval {of['low']:z.1f} to {of['high']:z.1f})"
    caption = f"{of['difference']:.1f}{interval} less than {of['second']}, the next"
    return (
        f"{best}, {caption}"
        if of["distinguished"]
        else f"{best}, which does not differ significantly from {of['second']}: {caption}"
    )


_ZONES: Final = tuple(
    shade._replace(most=most, label=label)
    for shade, (most, label) in zip(
        SHADES_PCT[1:],
        ((20.0, "A: to 20"), (40.0, "B: to 40"), (60.0, "C: to 60"), (80.0, "D: to 80"), (100.0, "E: above 80")),
        strict=False,
    )
)
"""Zones of the glycemia risk index, of D. C. Klonoff et al., J. Diabetes Sci. Technol. 17(5), 1226-1242, 2023."""


def _family_map(family: str, rows: Sequence[Row]) -> HeatMap:
    """Glycemia risk index of a family: cells in rows, all of them first, and controllers across."""
    by_place = {(_cell_name(row), row["controller"]): row for row in rows}
    risk = next(column for column in COLUMNS if column.name == "gri_mean")

    def cell(name: str, controller: str) -> HeatCell:
        row = by_place[name, controller]
        caption = [f"{controller}, {family}, {name}"]
        for group, columns in headings(COLUMNS):
            caption.append(f"{group}: {', '.join(f'{column.head} {column.value_text(row)}' for column in columns)}")
        shade = UNKNOWN
        if row["gri_mean"] is not None:
            shade = next((zone for zone in _ZONES if row["gri_mean"] <= zone.most), _ZONES[-1])
        harmed = row["harmed_below_54"]
        return HeatCell(shade, risk.value_text(row), f"▲{harmed}" if harmed else "", "\n".join(caption))

    controllers = list(dict.fromkeys(row["controller"] for row in rows))
    return HeatMap("Glycemia risk index", list(dict.fromkeys(map(_cell_name, rows))), controllers, cell)


def _plot_league(config: League, results: Results, *, title: str | None = None, width: Width = "double") -> Figure:
    """Draw the glycemia risk index over all cells, families in rows and controllers across."""
    maps = {family: _family_map(family, rows) for family, rows in _by_family(config, results).items()}
    controllers = list(dict.fromkeys(name for each in maps.values() for name in each.columns))

    def cell(family: str, controller: str) -> HeatCell:
        each = maps[family]
        return each.cell(each.rows[0], controller) if controller in each.columns else HeatCell(UNKNOWN, NOT_AVAILABLE)

    shown = HeatMap("Glycemia risk index, over all sensors and scenarios", list(maps), controllers, cell, apart=0.0)
    unknown = any(each.shade is UNKNOWN for each in shown.cells())
    return plot_heat_maps(
        [shown],
        what="(zones of the index)",
        mark="people harmed below 54 mg/dl" if any(each.mark for each in shown.cells()) else "",
        shades=[*_ZONES, *([UNKNOWN] if unknown else [])],
        title=title,
        width=width,
    )


def page(config: League, results: Results) -> str:
    """The page of a league: one file that needs neither network nor script."""
    by_family = _by_family(config, results)
    maps = {family: _family_map(family, rows) for family, rows in by_family.items()}
    unknown = any(cell.shade is UNKNOWN for each in maps.values() for cell in each.cells())
    bodies = {
        family: [(name, [(row["controller"], row) for row in alike]) for name, alike in groupby(rows, _cell_name)]
        for family, rows in by_family.items()
    }
    facts = {
        "People": f"{config.people} of each family, or all of one that has fewer",
        "Scenarios": "; ".join(texts(config.scenarios)),
        "Sensors": "; ".join(texts(config.sensors)),
        "Controllers": "; ".join(map(label_of, config.cases)),
        "Reference": config.reference_label,
        **({} if config.rescue is None else {"Rescue carbohydrate": config.rescue.text}),
        **({} if config.glucagon is None else {"Glucagon": config.glucagon.text}),
        **(
            {"Best doses": f"of the first {config.bound_people} people in each scenario"} if config.bound_people else {}
        ),
        "Seed": str(config.seed),
    }
    files = {"league.csv": "all numbers", "people.parquet": "metrics of each person", "summary.json": "what was found"}
    return render(
        Path(__file__).with_name("page.html"),
        "League of controllers",
        sentences=_harms(config, results),
        facts=facts,
        repeat=Repeat("league --config league.toml", config.tree(whole=True), files, explicit=config.tree()),
        config=config,
        about=results.plain["families"],
        verdicts=dict(zip(by_family, _verdicts(results), strict=True)),
        rankings=results.plain["rankings"],
        maps=maps,
        shades=[*_ZONES, *([UNKNOWN] if unknown else [])],
        bodies=bodies,
        columns=columns_of(config),
        nearest=[
            (family, [(row["scenario"] or "all", row) for row in of_family])
            for family, of_family in groupby(results.plain["nearest"], lambda row: row["family"])
        ],
        nearest_columns=reach.NEAREST,
        nearest_caption=reach.CAPTION,
        distances={family: reach.distances(rows) if config.bound_people else "" for family, rows in by_family.items()},
        absent=results.plain["absent"],
    )


def files_of(config: League, results: Results) -> dict[str, bytes]:
    """Page and figure, by the names of their files."""
    return {"league.html": page(config, results).encode(), **figure_files("figure", _plot_league(config, results))}
