"""A search of a grid carried out: the surface of all tunings, in order, as a table, a picture and a page."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
import polars as pl

from glucoloop.control import MPCTuning
from glucoloop.models.settings import FileComponent
from glucoloop.patients.catalogue import DEFAULT_PATIENT
from glucoloop.refusal import Refusal
from glucoloop.reporting import Repeat
from glucoloop.reporting.columns import Column, FittingTable, Line, terminal_table
from glucoloop.reporting.descriptions import run_facts
from glucoloop.reporting.figure_files import figure_files
from glucoloop.reporting.sse_surface import CELL_WORDS, Cell, SurfaceLayout, cell_colours, layout, plot_surface, texts
from glucoloop.reporting.template import render
from glucoloop.storage.model_file import ModelFile
from glucoloop.storage.results import Results
from glucoloop.studies.closed_loop import integrator_of, model_arguments, model_for, notes_on
from glucoloop.studies.tuning import GridSearch
from glucoloop.text import how_many
from glucoloop.tuning.grid import parse_integers, parse_numbers, tuning_grid
from glucoloop.tuning.search import default_tuning, designer, kind_of_tuning, search
from glucoloop.tuning.surface import TuningRank, TuningSurface, tuning_text

MAX_ROWS: Final = 200
"""Largest number of tunings in the list on the page; all are in ``surface.csv``."""
_ENGINE: Final = "JAX (xla), which runs many tunings at once"


def _grid_of(config: GridSearch) -> list[MPCTuning]:
    """Every tuning of the grid."""
    ranges = config.all_ranges
    whole = {key: parse_integers(ranges[key], key) for key in ("move_horizon", "prediction_horizon")}
    numbers = {key: parse_numbers(ranges[key], key) for key in ranges if key not in whole}
    for key, values in {**whole, **numbers}.items():
        for value in values:
            config.case.controller.setting(key).check(value)
    return tuning_grid(
        whole["move_horizon"],
        whole["prediction_horizon"],
        output_weights=numbers["output_weight"],
        move_weights=numbers["move_weight"],
        reference_filters=numbers.get("reference_filter"),
        reference_start=int(config.case.tuning.get("reference_start", 1)),
    )


# ---------------------------------------------------------------------------------------------- what is found


@dataclass(frozen=True)
class _Searched:
    """Surface of a search, from which its table, picture and page are made."""

    surface: TuningSurface
    printed: TuningRank
    """Rank of the default tuning of the patient; for the patient of 1999 it is the printed one."""
    model: ModelFile | None = None


def results_of(config: GridSearch, progress: Callable[[str], None]) -> Results:
    """Try every tuning of the grid, and the default one; Refusal for a design that is not possible."""
    case = config.case
    name = case.controller.display_name
    kind_of_tuning(name)  # refuses one that cannot be tuned
    default, grid = default_tuning(config, name), _grid_of(config)
    grid = grid if default in grid else [*grid, default]
    model = model_for(config, case)
    design = designer(config, case, **model_arguments(model))
    progress(f"designing {len(grid)} controllers")
    surface = search(
        config,
        design,
        grid,
        name=name,
        scenario=config.as_scenario(),
        seeds=range(config.seed, config.seed + config.number_of_seeds),
        integrator=integrator_of(config),
        progress=lambda done, total: progress(f"{done} of {total} runs"),
    )
    printed = surface.rank_of(default, "printed" if isinstance(config.patient, DEFAULT_PATIENT) else "usual")
    plain = {
        "config": config.tree(whole=True),
        "model": None if model is None else model.plain(),
        "best": None if printed.best is None else {**dataclasses.asdict(printed.best), "sse": printed.best_sse},
        "printed": {**dataclasses.asdict(printed.tuning), "sse": printed.sse, "rank": printed.rank},
        "acceptable": printed.points,
        "surface": {name: values.tolist() for name, values in surface.columns().items()},
        "notes": [*notes_on(config, case, model), *_counts(config, surface), *_no_picture(config, surface)],
    }
    table = pl.DataFrame(surface.columns())
    return Results(plain, {"surface.csv": table, "surface.parquet": table}, _Searched(surface, printed, model))


def _counts(config: GridSearch, surface: TuningSurface) -> Iterator[str]:
    """Sentences on the numbers of tunings and seeds."""
    points = len(surface.tunings)
    broken = int((~surface.feasible).sum())
    ringing = int((surface.oscillates & surface.feasible).sum())
    yield (
        f"Of {how_many(points, 'tuning')} {how_many(broken, 'breaks', 'break')} a constraint and "
        f"{how_many(ringing, 'more oscillates', 'more oscillate')}; "
        f"{how_many(int(surface.acceptable.sum()), 'is', 'are')} acceptable."
    )
    if surface.refused:
        yield f"{how_many(len(surface.refused), 'tuning has', 'tunings have')} no controller: {surface.refused[0][1]}."
    if config.noisy:
        yield (
            f"Results are medians of {how_many(surface.seeds, 'seed')}; oscillation was judged without "
            f"{'the noise around the sensor' if config.drawn_otherwise else 'noise'}."
        )
    elif surface.seeds > 1:
        yield f"Results are medians of {surface.seeds} seeds; oscillation was judged in the run of the first."


def _no_picture(config: GridSearch, surface: TuningSurface) -> Iterator[str]:
    """Sentence on why there is no picture, if there is none."""
    plotted = surface.only(_grid_of(config))
    try:
        layout(plotted)
        if not np.isfinite(plotted.sse).any():
            raise Refusal("the surface has no finite sum of squared errors to show")
    except Refusal as error:
        yield f"No picture was drawn: {error}."


# ---------------------------------------------------------------------------------------------- how it is shown

_COLUMNS: Final = (
    Column(name="move_horizon", head="m", short="m", text=str),
    Column(name="prediction_horizon", head="p", short="p", text=str),
    Column(name="output_weight", head="Γ_y", short="Γ_y", text="{:g}".format),
    Column(name="move_weight", head="Γ_u", short="Γ_u", text="{:g}".format),
    Column(
        name="reference_filter", head="φ_r", short="φ_r", text="{:g}".format, only=lambda row: "reference_filter" in row
    ),
    Column(name="sse", head="Sum of squared errors (mg/dl)²", short="SSE\n(mg/dl)²", text="{:.1f}".format),
    Column(name="undershoot_mg_dl", head="Undershoot (mg/dl)", short="Undershoot\nmg/dl", text="{:.1f}".format),
    Column(name="settling", head="Settling to 2 % (min)", short="Settling, 2 %\nmin", text=str),
    Column(
        name="insulin_total_variation_mU_min",
        head="Travel (mU/min)",
        short="Travel\nmU/min",
        text="{:.0f}".format,
    ),
    Column(name="remarks", head="Remarks", short="", text=str, left=True),
)


def _lines_of(searched: _Searched, top: int) -> tuple[list[Line], list[Line]]:
    """The best tunings in order with their ranks, and the printed one if it is not among them."""
    surface, printed = searched.surface, searched.printed
    order, rows = surface.order().tolist(), pl.DataFrame(surface.columns()).to_dicts()
    position = order.index(surface.index(printed.tuning))

    def line(point: int) -> Line:
        tuning = surface.tunings[point]
        rank, is_printed = surface.rank_of(tuning).rank, tuning == printed.tuning
        remarks = ", ".join([*([printed.label] if is_printed else []), *_faults(surface, point)])
        texts = {"settling": _settling(surface, point), "remarks": remarks, "printed": is_printed}
        return "-" if rank is None else str(rank), [{**rows[point], **texts}]

    return [line(point) for point in order[:top]], [line(order[position])] if position >= top else []


def _faults(surface: TuningSurface, point: int) -> Iterator[str]:
    """Reasons why a tuning is not acceptable."""
    if not surface.feasible[point]:
        yield "breaks a constraint"
    if surface.oscillates[point]:
        yield "oscillates"


def tables(config: GridSearch, results: Results) -> Iterator[FittingTable]:
    """The first tunings of the order, and the printed one at its place."""
    best, beyond = _lines_of(results.extra, config.top)
    yield terminal_table("Rank", [("", best), *([("", beyond)] if beyond else [])], _COLUMNS)


def sentences(config: GridSearch, results: Results) -> Iterator[str]:
    """Sentence on the default tuning among the others."""
    printed: TuningRank = results.extra.printed
    subject = f"The {printed.label} tuning {tuning_text(printed.tuning)}"
    if printed.rank is None:
        yield f"{subject} is not acceptable here."
    elif printed.points == 1:
        yield f"{subject} is the only acceptable one."
    elif printed.rank == 1 and printed.equal:
        others = "all others" if printed.equal == printed.points - 1 else how_many(printed.equal, "other")
        yield f"{subject} shares the minimum sum of squared errors with {others} of {printed.points} acceptable ones."
    elif printed.rank == 1:
        yield f"{subject} is the best of {how_many(printed.points, 'acceptable one')}."
    else:
        best = "" if printed.best is None else f" with {printed.sse:.4g} against {printed.best_sse:.4g} of the best"
        yield f"{subject} ranks {printed.rank} of {printed.points} by the sum of squared errors,{best}."


def files_of(config: GridSearch, results: Results) -> dict[str, bytes]:
    """Page and picture, the model, and the configuration that names it."""
    searched: _Searched = results.extra
    files, used, explicit = {}, config.tree(whole=True), config.tree()
    if searched.model is not None:
        files["model.json"] = searched.model.text().encode()
        if isinstance(config.case.model, FileComponent):
            model_file = {"name": FileComponent.name, "path": "model.json"}
            used["controller"][0]["model"] = explicit["model"] = model_file
    data = {"surface.csv": "all tunings", "tune.json": "the same"}
    again = Repeat("tune --config tune.toml", used, data, explicit=explicit)
    files["tune.toml"] = again.text.encode()
    title = f"{config.case.controller.display_name} at {config.place}"
    ranges = {f"Range of the {key.replace('_', ' ')}": text for key, text in config.all_ranges.items()}
    files["surface.html"] = _surface_page(
        searched,
        f"Tunings of {title}",
        _grid_of(config),
        sentences=[*sentences(config, results), *results.plain["notes"]],
        facts={**ranges, **run_facts(config, config.case), "Engine": _ENGINE},
        repeat=again,
    ).encode()
    if not any(_no_picture(config, searched.surface)):
        # the printed tuning is drawn where the grid that was asked for has it, and told beside the picture elsewhere
        printed = searched.printed
        plotted = searched.surface.only(_grid_of(config))
        files |= figure_files(
            "surface", plot_surface(plotted, printed=printed.tuning, label=printed.label, title=title)
        )
    return files


# ---------------------------------------------------------------------------------------------- the page

_SYMBOLS: Final = {
    "prediction_horizon": "p",
    "reference_filter": "φ_r",
    "move_horizon": "m",
    "move_weight": "Γ_u",
    "output_weight": "Γ_y",
}
_EMPTY: Final = dict.fromkeys(("text", "marks", "ground", "ink"), "")
"""A cell of the surface without a number."""


def _surface_page(searched: _Searched, title: str, grid: Sequence[MPCTuning], **common: Any) -> str:
    """The page of a search: every place of the grid, and the first tunings in order; `common` as for `render`."""
    plotted, printed = searched.surface.only(grid), searched.printed
    best, beyond = _lines_of(searched, MAX_ROWS)
    values: dict[str, Any] = {
        "panels": [],
        "printed": printed,
        "printed_text": tuning_text(printed.tuning),
        "beside": printed.tuning not in plotted.tunings,
        "points": len(searched.surface.tunings),
        "most_rows": MAX_ROWS,
        "columns": [column for column in _COLUMNS if column.only(best[0][1][0])],
        "lines": [*best, *beyond],
        "why_not": "",
        "impossible": CELL_WORDS["impossible"],
    }
    try:
        places = layout(plotted)
    except Refusal as error:
        values["why_not"] = str(error)
    else:
        values |= {
            "across": _axis(places.x),
            "upwards": _axis(places.y),
            "corner": f"{_SYMBOLS[places.y]} \\ {_SYMBOLS[places.x]}",
            "foot": [f"{value:g}" for value in places.levels[places.x]],
            "panels": list(_panels(plotted, printed, places)),
        }
    return render(Path(__file__).with_name("page.html"), title, **common, **values)


def _axis(name: str) -> str:
    unit = ", samples" if name == "prediction_horizon" else ""
    return f"{name.replace('_', ' ')} {_SYMBOLS[name]}{unit}"


def _panels(
    surface: TuningSurface, printed: TuningRank, places: SurfaceLayout
) -> Iterator[tuple[str, list[tuple[str, list[dict[str, str]]]]]]:
    """Caption of each panel, and its rows of cells from the top down."""
    colours = cell_colours(surface)
    best = surface.best() if surface.acceptable.any() else None
    for combination, panel in places.cells.items():
        rows = [
            (f"{value:g}", [_EMPTY | _cell(surface, best, printed.tuning, colours, cell) for cell in row])
            for value, row in zip(places.levels[places.y], panel, strict=True)
        ]
        yield texts(places.panels, _SYMBOLS, combination), rows[::-1]


def _cell(
    surface: TuningSurface,
    best: MPCTuning | None,
    printed: MPCTuning,
    colours: Sequence[tuple[str, str]],
    cell: Cell,
) -> dict[str, str]:
    """Class, hover text, number, marks and colours of a cell, by the names that the page has for them."""
    point = cell.point
    if point is None:
        reason = f": {cell.reason}" if cell.reason else ""
        return {"kind": cell.kind.replace(" ", "-"), "hover": CELL_WORDS[cell.kind] + reason}
    tuning = surface.tunings[point]
    if cell.kind == "not finite":
        return {"kind": "refused", "hover": f"{tuning_text(tuning)}: {CELL_WORDS[cell.kind]}"}
    numbers = (
        f"{tuning_text(tuning)}: SSE {surface.sse[point]:.4g} (mg/dl)²",
        f"undershoot {surface.undershoot_mg_dl[point]:.1f} mg/dl",
        f"settling {_settling(surface, point)} min",
    )
    ground, ink = colours[point]
    return {
        "kind": cell.kind,
        "hover": ", ".join([*numbers, *_faults(surface, point)]),
        "text": _short(float(surface.sse[point])),
        "marks": ("★" if tuning == best else "") + ("◆" if tuning == printed else ""),
        "ground": ground,
        "ink": ink,
    }


def _settling(surface: TuningSurface, point: int) -> str:
    return f"{surface.settling_2pct_min[point]:.0f}{'' if surface.settled_2pct[point] else '+'}"


def _short(value: float) -> str:
    """Text of a number with three significant digits, without an exponent in the default range."""
    return f"{value:.0f}" if 100.0 <= value < 1e7 else f"{value:.3g}"
