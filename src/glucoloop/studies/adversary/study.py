"""A search for the worst sensor errors carried out: its numbers, and the worst loops as a table and a figure."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from itertools import groupby
from typing import TYPE_CHECKING, Any, Final, NamedTuple

import numpy as np
import polars as pl

from glucoloop.build.designs import controller_of
from glucoloop.patients.population import VirtualPeople
from glucoloop.refusal import Refusal
from glucoloop.reporting import _style
from glucoloop.reporting._style import FONT_PT, GREY, OKABE_ITO
from glucoloop.reporting.columns import Column, FittingTable, decimals, terminal_table, whole
from glucoloop.reporting.descriptions import engine_facts
from glucoloop.reporting.figure_files import figure_files
from glucoloop.sensors import whole_samples
from glucoloop.simulation.engines import one_at_a_time
from glucoloop.situations.run import intravenous_boluses
from glucoloop.storage.results import Results
from glucoloop.storage.rows import Rows
from glucoloop.studies.adversary import ADVERSARY, Adversary
from glucoloop.studies.adversary.attack import (
    VERY_LOW_MG_DL,
    Array,
    Attack,
    ErrorSpace,
    Worst,
    generations,
    judge_of,
    random_errors,
    worst_of,
)
from glucoloop.studies.guarded import WITH_GUARD
from glucoloop.text import glucose_text
from glucoloop.trials.trial import Trial
from glucoloop.tuning.evolution import library

if TYPE_CHECKING:
    from matplotlib.artist import Artist
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


class _ErrorSearch(NamedTuple):
    """One search: a controller, guarded or not, under errors of one size."""

    key: dict[str, Any]
    """Values that tell it from all other searches, by the names of their columns."""
    trial: Trial
    """Trial with one case, the controller."""
    space: ErrorSpace


def _called(row: Mapping[str, Any]) -> str:
    return f"{row['controller']}, guarded" if row["guarded"] else str(row["controller"])


def _name(row: Mapping[str, Any]) -> str:
    """Name of a search, unique among all."""
    return f"{_called(row)}, ±{row['error_pct']:g} %"


def loops(config: Adversary) -> Iterator[list[_ErrorSearch]]:
    """Searches that share a loop: those of one controller, guarded or not, from small errors to large ones.

    Refusal for a part of a sample, or a library that is missing.
    """
    library()
    spaces = [
        ErrorSpace(
            samples=config.samples,
            error=error / 100.0,
            hold_samples=whole_samples(config.hold_min, config.sample_time_min, "a time for which an error holds"),
            stretches=config.stuck_times,
            stretch_samples=whole_samples(config.stuck_min, config.sample_time_min, "a stuck stretch"),
        )
        for error in sorted(config.errors_pct)
    ]
    for case in config.cases:
        for guarded in WITH_GUARD[config.guards]:
            alone = config.with_cases((config.with_guard(case, guarded),))
            key = {"controller": case.label, "guarded": guarded}
            yield [_ErrorSearch({**key, "error_pct": 100.0 * space.error}, alone, space) for space in spaces]


notes = intravenous_boluses


class _GenerationScores(NamedTuple):
    """A generation of a search."""

    search: str
    generation: int
    score: Array
    """(lanes,) harm of each sequence."""


def rows(config: Adversary) -> Rows[_GenerationScores]:
    """Rows that are kept: the scores of each generation."""
    names = {_name(search.key) for searches in loops(config) for search in searches}
    amount = len(names) * config.generations

    def row(cells: Mapping[str, Any], before: Sequence[_GenerationScores]) -> _GenerationScores:
        results = _GenerationScores(cells["search"], cells["generation"], np.array(cells["score"], float))
        number = sum(other.search == results.search for other in before)
        expected = results.search in names and results.generation == number < config.generations
        if not expected or results.score.shape != (config.lanes,):
            raise Refusal("this is no generation of the search")
        return results

    return Rows(
        file=ADVERSARY.results,
        what="generations",
        wanted=amount,
        most=amount,
        schema={"search": pl.String, "generation": pl.Int64, "score": pl.List(pl.Float64)},
        cells=lambda scores: {**scores._asdict(), "score": scores.score.tolist()},
        row=row,
        width=config.lanes,
        longest_text=1000,  # the name of a search
        every_s=5.0,  # since all scores are written each time
    )


class _AdversarySearch:
    """All searches, each of which begins at the worst of the smaller errors."""

    def __init__(self, config: Adversary) -> None:
        self._config = config
        self._numbers: list[dict[str, Any]] = []
        self._loops: list[pl.DataFrame] = []
        self._engines: dict[str, dict[str, str]] = {}

    def missing(self, rows: Sequence[_GenerationScores]) -> Iterator[_GenerationScores]:
        """Carry out the searches; the generations that are known are not simulated again."""
        for searches in loops(self._config):
            first = searches[0]
            with one_at_a_time:
                controller = controller_of(first.trial, first.trial.cases[0])
                attack = Attack(first.trial, controller, first.space, lanes=self._config.lanes)
                who = attack.person(self._config.person)
            self._engines[_called(first.key)] = attack.engine_facts
            smaller: tuple[ErrorSpace, Array] | None = None
            for one in searches:
                name = _name(one.key)
                before = [row.score for row in rows if row.search == name]
                known = None if smaller is None else one.space.points_of(*smaller)
                for generation in generations(judge_of(attack, who), one.space, self._config, before, known):
                    if generation.number >= len(before):
                        yield _GenerationScores(name, generation.number, generation.score)
                smaller = one.space, generation.best
                worst = worst_of(attack, who, one.space, generation)
                self._numbers.append(_numbers(one, worst, attack, who, self._config.search_seed))
                self._loops.append(
                    worst.loop.select(*(pl.lit(value).alias(key) for key, value in one.key.items()), pl.all())
                )

    def results_of(self, rows: Sequence[_GenerationScores]) -> Results:
        """Numbers of each search, and the worst loops."""
        del rows
        glucose = pl.col("^.*lowest.*_mg_dl$")  # below 0 the model is not valid, and there is no number
        table = pl.DataFrame(self._numbers).drop("stuck_from_min").with_columns(pl.when(glucose >= 0.0).then(glucose))
        tables = {"adversary.csv": table, "worst.parquet": pl.concat(self._loops)}
        plain = {
            "config": self._config.tree(whole=True),
            "searches": self._numbers,
            "engines": self._engines,
            "notes": [f"Engine: {engine_facts(self._engines)['Engine']}."],
        }
        return Results(plain, tables)


search = _AdversarySearch


def _numbers(search: _ErrorSearch, worst: Worst, attack: Attack, who: VirtualPeople, seed: int) -> dict[str, Any]:
    """Numbers of one search, with those without errors, and with random ones of the same size on the people."""
    space, trial = search.space, search.trial
    never = np.full((space.stretches, 1), float(space.samples))
    without = attack.harm(who, np.zeros((space.samples, 1)), never)
    random = random_errors(attack, space, trial.people, seed)
    people = random.lowest_mg_dl.size
    return {
        **search.key,
        "below_54_min": worst.harm.below_54_min.item(),
        "lowest_mg_dl": worst.harm.lowest_mg_dl.item(),
        "peak_mg_dl": worst.harm.peak_mg_dl.item(),
        "stuck_from_min": (worst.stuck_from * trial.sample_time_min).tolist(),
        "sequences_tried": worst.sequences,
        "random_people": people,
        "random_ever_below_54_pct": 100.0 * float((random.below_54_min > 0.0).mean()) if people else None,
        "random_lowest_mg_dl": float(random.lowest_mg_dl.min()) if people else None,
        "lowest_without_errors_mg_dl": without.lowest_mg_dl.item(),
        "peak_without_errors_mg_dl": without.peak_mg_dl.item(),
    }


_COLUMNS: Final = (
    Column(name="below_54_min", short="Worst errors:\nmin below 54", text=whole),
    Column(name="lowest_mg_dl", short="lowest\nmg/dl", text=glucose_text),
    Column(name="peak_mg_dl", short="peak\nmg/dl", text=glucose_text),
    Column(name="random_ever_below_54_pct", short="Random errors:\npeople < 54, %", text=decimals(2)),
    Column(name="random_lowest_mg_dl", short="lowest\nmg/dl", text=glucose_text),
    Column(name="lowest_without_errors_mg_dl", short="No errors:\nlowest", text=glucose_text),
    Column(name="peak_without_errors_mg_dl", short="peak\nmg/dl", text=glucose_text),
)


def tables(config: Adversary, results: Results) -> Iterator[FittingTable]:
    """A section for each controller and a line for each size of the errors."""
    by_controller = groupby(results.plain["searches"], _called)
    sections = [(name, [(f"± {row['error_pct']:g} %", [row]) for row in rows]) for name, rows in by_controller]
    yield terminal_table("Errors", sections, _COLUMNS)


def _title(config: Adversary) -> str:
    who = "the nominal patient" if config.one_person is None else config.one_person.name
    if config.person is not None:
        who = f"person {config.population.called(config.seed, [config.person])[0]} of {config.population.name}"
    stuck = f", {config.stuck_times} stretches of {config.stuck_min:g} min stuck" if config.stuck_times else ""
    return f"The worst errors found for {who}: each held for {config.hold_min:g} min{stuck}"


def sentences(config: Adversary, results: Results) -> Iterator[str]:
    """Conclusions from the numbers."""
    searches = results.plain["searches"]
    number, people = sum(row["sequences_tried"] for row in searches), searches[0]["random_people"]
    yield f"{_title(config)}; {number} sequences were tried. Worse errors may exist: a search does not prove a bound."
    yield f"Random errors: of the same size, drawn uniformly, on {people} people of {config.population.name}."


def files_of(config: Adversary, results: Results) -> dict[str, bytes]:
    """Figure of the worst loops, by the names of its files."""
    return figure_files("worst", _plot_adversary(results, _title(config)))


_ROW_MM: Final = 52.0
_STATUS: Final = {
    "reading rejected": ("reading rejected", OKABE_ITO[4]),
    "fallback basal": ("fallback to the basal rate", OKABE_ITO[2]),
    "fallback reduced": ("fallback to a part of it", OKABE_ITO[5]),
    "suspended": ("insulin suspended", OKABE_ITO[3]),
    "dose limited": ("dose limited", "0.6"),
}
"""Label and colour of each status of a guard."""


def _plot_adversary(results: Results, title: str) -> Figure:
    """Draw the worst loop of every controller, one row for each, one column for each size of the errors.

    Above: the person's glucose, the sensor's readings, and lines at 54 and 70 mg/dl. Below: insulin as delivered, and
    behind it, in colour, the status of the guard.
    """
    worst, searches = results.tables["worst.parquet"], results.plain["searches"]
    loops = zip(searches, worst.partition_by("controller", "guarded", "error_pct", maintain_order=True), strict=True)
    rows = [list(of_controller) for _, of_controller in groupby(loops, lambda loop: _called(loop[0]))]
    figure = _style.new_figure("double", 18.0 + _ROW_MM * len(rows), title)
    ratios = [2.2, 1.0] * len(rows)
    panels = figure.subplots(
        2 * len(rows), len(rows[0]), squeeze=False, sharex=True, sharey="row", height_ratios=ratios
    )
    t_min = np.unique(worst["t_min"])
    edges = np.append(t_min, 2.0 * t_min[-1] - t_min[-2])
    highest = 1.05 * float(np.nanmax(worst.select("glucose_mg_dl", "reading_mg_dl").to_numpy()))
    most = 1.05 * float(worst["insulin_mU_min"].to_numpy().max())
    entries: dict[str, Artist] = {}
    for above, below, row in zip(panels[::2], panels[1::2], rows, strict=True):
        above[0].set(ylabel="Glucose\n(mg/dl)", ylim=(0.0, highest))
        below[0].set(ylabel="Insulin\n(mU/min)", ylim=(0.0, most))
        for glucose, insulin, (numbers, loop) in zip(above, below, row, strict=True):
            below_min, lowest = (column.value_text(numbers) for column in _COLUMNS[:2])
            name = f"{_name(numbers)}\n{below_min} min below 54, lowest {lowest} mg/dl"
            glucose.set_title(name, fontsize=FONT_PT, loc="left")
            entries |= _draw_glucose(glucose, loop) | _draw_insulin(insulin, loop, edges)
    divisor, unit, _ = _style.time_axis(edges[-1], "double")
    _, _, tick = _style.time_axis(edges[-1], "single")
    for axes in panels.ravel():
        _style.dress(axes)
        axes.set_xlim(0.0, edges[-1])
        axes.xaxis.set_major_locator(_style.every(tick * divisor))
        axes.xaxis.set_major_formatter(lambda value, place: f"{value / divisor:g}")
    for axes in panels[-1]:
        axes.set_xlabel(f"Time ({unit})")
    _style.add_legend(figure, entries, "double")
    return figure


def _draw_glucose(axes: Axes, loop: pl.DataFrame) -> dict[str, Artist]:
    t_min, glucose, reading = (loop[name].to_numpy() for name in ("t_min", "glucose_mg_dl", "reading_mg_dl"))
    for bound in (VERY_LOW_MG_DL, 70.0):
        axes.axhline(bound, color=GREY, linewidth=0.6, linestyle=(0, (4, 3)), zorder=1)
    low = glucose < VERY_LOW_MG_DL
    axes.fill_between(t_min, glucose, VERY_LOW_MG_DL, where=low, color=OKABE_ITO[1], alpha=0.35, linewidth=0.0)
    return {
        "glucose": axes.plot(t_min, glucose, color="black", linewidth=1.1)[0],
        "reading": axes.plot(t_min, reading, color=OKABE_ITO[1], marker=".", markersize=1.6, linewidth=0.4)[0],
    }


def _draw_insulin(axes: Axes, loop: pl.DataFrame, edges: Array) -> dict[str, Artist]:
    entries: dict[str, Artist] = {}
    for status, (label, colour) in _STATUS.items():
        for sample in np.flatnonzero(loop["status"] == status):
            during = edges[sample], edges[sample + 1]
            entries[label] = axes.axvspan(*during, color=colour, alpha=0.45, linewidth=0.0)
    insulin = loop["insulin_mU_min"].to_numpy()
    entries["insulin"] = axes.stairs(insulin, edges, color=OKABE_ITO[0], linewidth=1.1, baseline=None)
    return entries
