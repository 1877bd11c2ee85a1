"""A search for a robust tuning as a study: its configuration, tables, sentences and files."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Any, Final

import numpy as np
import numpy.typing as npt
import polars as pl

from glucoloop.component.request import Request, completed
from glucoloop.component.setting import known_names
from glucoloop.control.catalogue import CONTROLLERS, SEARCHED
from glucoloop.refusal import Refusal
from glucoloop.reporting import _style
from glucoloop.reporting._style import FONT_PT, GREY
from glucoloop.reporting.columns import Column, FittingTable, Line, terminal_table
from glucoloop.reporting.figure_files import figure_files
from glucoloop.situations.case import Case
from glucoloop.situations.run import Run
from glucoloop.situations.toml import toml_text
from glucoloop.storage.results import Results
from glucoloop.studies.robust import Search
from glucoloop.studies.robust.search import AS_IT_WAS, CHOSEN, OBJECTIVES, SearchEngine, objective, rows_of
from glucoloop.text import NOT_AVAILABLE, how_many

if TYPE_CHECKING:
    from matplotlib.artist import Artist
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


def notes(config: Search) -> tuple[str, ...]:
    """Refuse what is missing before anything is drawn; who is left out is known when people are."""
    for name in config.objectives:
        objective(name)
    for text, (name, _) in zip(config.at_most, config.bounds, strict=True):
        if name not in OBJECTIVES:
            raise Refusal(f"--at-most is {text!r}: unknown objective {name!r}; {known_names(name, OBJECTIVES)}")
    config.sampler.made(space=config.space, batch=config.batch)  # refuses a library that is missing
    return ()


rows = rows_of
search = SearchEngine


def tables(config: Search, results: Results) -> Iterator[FittingTable]:
    """The front in order of its first objective, the initial tuning and the references; and all on others."""
    plain = results.plain
    columns = [
        Column(name="candidate", short="Candidate", text=str, only=lambda row: "candidate" in row),
        *(
            Column(name=name, short=name.replace("_", "\n"), text="{:.4g}".format, only=lambda row: "candidate" in row)
            for name in (tuned.name for tuned in config.space)
        ),
        *OBJECTIVES.values(),
    ]
    chosen, start = plain["chosen"]["candidate"], plain["as_it_was"]
    front = _thinned(plain["front"], config.top, chosen) or [plain["chosen"]]
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


def sentences(config: Search, results: Results) -> Iterator[str]:
    """Conclusions on the bounds, the front and the choice."""
    plain, objectives, prefer = results.plain, config.objectives, config.prefer
    for bound in plain["bounds"]:
        whose = "" if bound["of"] is None else f", what {bound['of']} comes to"
        most = NOT_AVAILABLE if bound["at_most"] is None else f"{bound['at_most']:.4g}"
        yield f"Bound: {bound['objective']} at most {most}{whose}."
    chosen, number = plain["chosen"]["candidate"], how_many(plain["candidates"], "tuning")
    keeping = f"Of {number} {how_many(plain['keeping_the_bounds'], 'keeps', 'keep')} the bounds"
    if not plain["chosen"]["keeps_the_bounds"]:
        yield f"{keeping}; chosen is the one that exceeds them by the smallest amount, candidate {chosen}."
        return
    preferred = f"the minimum of {prefer}" if prefer in objectives else "nearest to the minimum of both"
    front = f"{how_many(len(plain['front']), 'makes', 'make')} the front of {' and '.join(objectives)}"
    yield (
        f"{f'{keeping}, and {front}' if plain['bounds'] else f'Of {number} {front}'}; "
        f"chosen is candidate {chosen}, {preferred}."
    )


def files_of(config: Search, results: Results) -> dict[str, bytes]:
    """The chosen tuning as the configuration of a run, and the figure."""
    trial, case = config.trial, config.tuned
    people = how_many(config.people, "person", "people")
    title = (
        f"{case.label}: {how_many(results.plain['candidates'], 'tuning')}, {people} of {trial.population.name} and "
        f"{how_many(config.seeds, 'seed')} of noise {trial.noise_variance:g} (mg/dl)²"
    )
    best = _best(config, results.plain["chosen"]["tuning"])
    return {
        "best.toml": toml_text(best.tree(whole=True), "run --config best.toml", best.tree()).encode(),
        **figure_files("front", _plot_robust(config, results, title=title)),
    }


def _best(config: Search, tuning: Mapping[str, float]) -> Run:
    """The run of the nominal patient, in the same situation, with a tuning."""
    controller = Request(CONTROLLERS[SEARCHED], {**config.tuned.controller.explicit, **tuning})
    case = Request(Case, {**config.case.explicit, "controller": controller})
    names = [name for name in config.explicit if name in Run.settings()]
    shared = {name: getattr(config, name) for name in dict.fromkeys([*names, "sensor", "meals", "duration_min"])}
    return completed(Request(Run, {**shared, "controller": (case,)}))


_HEIGHT_MM: Final = 94.0
_SHOWN: Final = 0.9
"""Share of the tunings within the bounds that each axis must show; a few are far away."""
_ROOM: Final = 0.06
_MARKERS: Final = ("D", "s", "^", "v", "P", "X")


def _plot_robust(config: Search, results: Results, *, title: str | None = None) -> Figure:
    """Draw the two objectives of every tuning with the front, and undershoot on subjects that were not searched on."""
    figure = _style.new_figure("double", _HEIGHT_MM, title)
    trade, people, noise = figure.subplots(1, 3, gridspec_kw={"width_ratios": [1.5, 1.0, 1.0]})
    styles = _styles([CHOSEN, AS_IT_WAS, *results.plain["beside"]])
    entries = _draw_trade(trade, config, results, styles)
    check = results.tables["check.parquet"]
    _draw_check(people, check.filter(group="people"), "people", styles)
    _draw_check(noise, check.filter(group="noise"), "seeds", styles)
    for axes in (people, noise):
        axes.set_xlim(0.0, 1.04 * check["undershoot_mg_dl"].to_numpy().max())
    noise.tick_params(labelleft=False)
    noise.set_ylabel("")
    _style.dress(trade, people, noise)
    _style.add_legend(figure, entries, "double")
    return figure


def _styles(labels: Sequence[str]) -> dict[str, dict[str, Any]]:
    """Colour, dashes and marker of each controller, of which the first one is chosen."""
    results = {}
    for index, label in enumerate(labels):
        marker = "*" if index == 0 else _MARKERS[(index - 1) % len(_MARKERS)]
        results[label] = {**_style.line_style(index), "marker": marker, "markersize": 10.0 if index == 0 else 5.0}
    return results


def _draw_trade(
    axes: Axes, config: Search, results: Results, styles: Mapping[str, Mapping[str, Any]]
) -> dict[str, Artist]:
    """Draw the tunings, the front, the bounds and the other controllers; returns the entries of the legend."""
    x, y = (OBJECTIVES[name] for name in config.objectives)
    plain = results.plain
    candidates = results.tables["candidates.csv"].filter(pl.all_horizontal(pl.col(x.name, y.name).is_finite()))
    out, within = candidates.filter(~pl.col("keeps_the_bounds")), candidates.filter("keeps_the_bounds")
    front = candidates.filter("on_the_front").sort(x.name, y.name)
    entries: dict[str, Artist] = {}

    def draw(label: str, points: pl.DataFrame, **style: Any) -> None:
        if len(points):
            entries[label] = axes.plot(points[x.name], points[y.name], **{"linestyle": "none", **style})[0]

    draw("exceeds a bound", out, marker="x", markersize=2.8, markeredgewidth=0.5, color="0.72", zorder=1)
    draw("tuning", within, marker="o", markersize=2.4, markeredgewidth=0.0, color="0.5", zorder=2)
    steps = {"drawstyle": "steps-post", "linestyle": "-", "linewidth": 0.8, "markerfacecolor": "white"}
    draw("front", front, **steps, color="black", marker="o", markersize=3.2, markeredgewidth=0.7, zorder=3)
    marks = {CHOSEN: plain["chosen"]["scores"]}
    if plain["as_it_was"] is not None:
        marks[AS_IT_WAS] = plain["as_it_was"]["scores"]
    places = {
        label: np.array([scores[x.name], scores[y.name]], float)
        for label, scores in {**marks, **plain["beside"]}.items()
    }
    for label, place in places.items():
        style = {**styles[label], "markeredgecolor": "black", "markeredgewidth": 0.6}
        entries[label] = axes.plot(*place, **style, zorder=4)[0]
    lines = dict(zip(config.objectives, (axes.axvline, axes.axhline), strict=True))
    for bound in plain["bounds"]:
        if bound["objective"] in lines and bound["at_most"] is not None:
            line = lines[bound["objective"]]
            entries["bound"] = line(bound["at_most"], color=GREY, linewidth=0.8, linestyle=(0, (4, 2)), zorder=0)
    axes.set_xlabel(x.head, fontsize=FONT_PT)
    axes.set_ylabel(y.head, fontsize=FONT_PT)
    readable = np.array([*front.select(x.name, y.name).to_numpy(), *places.values()])
    cloud = (within if len(within) else candidates).select(x.name, y.name).to_numpy()
    _zoom(axes, candidates.select(x.name, y.name).to_numpy(), readable, cloud)
    return entries


def _zoom(
    axes: Axes, points: npt.NDArray[np.float64], readable: npt.NDArray[np.float64], cloud: npt.NDArray[np.float64]
) -> None:
    """Limit the axes to points that must be readable, and to as many of a cloud of others as leave them readable."""
    shown = np.array([*readable, np.quantile(cloud, _SHOWN, axis=0), cloud.min(axis=0)])
    low, high = np.nanmin(shown, axis=0), np.nanmax(shown, axis=0)
    room = np.where(high > low, high - low, 1.0) * _ROOM
    axes.set_xlim(low[0] - room[0], high[0] + room[0])
    axes.set_ylim(low[1] - room[1], high[1] + room[1])
    beyond = int((points > high + room).any(axis=1).sum())
    if beyond:
        inside: dict[str, Any] = {"xytext": (-2.0, -2.0), "xycoords": "axes fraction", "ha": "right", "va": "top"}
        _style.write(axes, f"{beyond} beyond", (1.0, 1.0), **inside, color=GREY)


def _draw_check(axes: Axes, check: pl.DataFrame, what: str, styles: Mapping[str, Mapping[str, Any]]) -> None:
    """Draw the share of the subjects with at most each undershoot, for each controller."""
    for (label,), subjects in check.group_by("controller", maintain_order=True):
        undershoot = np.sort(subjects["undershoot_mg_dl"].to_numpy())
        share = 100.0 * np.arange(1, undershoot.size + 1) / undershoot.size
        style = {key: styles[str(label)][key] for key in ("color", "linestyle", "linewidth")}
        axes.step(np.append(0.0, undershoot), np.append(0.0, share), where="post", **style)
    axes.axhline(95.0, color=GREY, linewidth=0.6, linestyle=(0, (1, 1.5)), zorder=0)
    axes.set_ylim(0.0, 100.0)
    axes.set_title(f"{undershoot.size} {what} not seen", fontsize=FONT_PT, loc="left")
    axes.set_xlabel("Undershoot (mg/dl)", fontsize=FONT_PT)
    axes.set_ylabel("Share with at most so much (%)", fontsize=FONT_PT)
