"""The reproduction, or some tables and figures of it: run, compared with the printed numbers, drawn and told."""

from __future__ import annotations

import base64
import dataclasses
import functools
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Final

import numpy as np

import glucoloop
from glucoloop.component.request import Request
from glucoloop.patients import OPERATING_POINTS
from glucoloop.refusal import Refusal
from glucoloop.reporting import plot, plot_identification, plot_validation
from glucoloop.reporting.columns import Column, FittingTable, Line, terminal_table
from glucoloop.reporting.figure_files import figure_files
from glucoloop.reporting.sse_surface import plot_surface
from glucoloop.reporting.template import render
from glucoloop.reproduction.parker1999 import PAPER_CONTROLLERS, Reproduction
from glucoloop.reproduction.parker1999.comparison import (
    INTERPRETATIONS,
    UNSETTLED,
    ComparedEntry,
    Reproduced,
    compare,
    count,
    left_out,
    reason_for,
)
from glucoloop.reproduction.parker1999.experiments import (
    DEAD_TIMES_MIN,
    NOISE_FREE,
    Experiment,
    PointResults,
    Progress,
    all_experiments,
    noisy_runs,
    study,
)
from glucoloop.situations.case import Case, label_of
from glucoloop.storage.results import Results
from glucoloop.tuning.search import printed_tuning

if TYPE_CHECKING:
    from matplotlib.figure import Figure


_CAPTIONS: Final = {
    "figure-2": (
        "Fig. 2. Impulse response from a noisy record: as estimated, projected on two Laguerre functions, and free of "
        "noise."
    ),
    "figure-3": "Fig. 3. Validation of the Laguerre model by a random binary sequence.",
    "figure-4": "Fig. 4. 50 g of glucose at 50 min, readings with noise of variance 1.45: linear MPC and MPC/SE.",
    "figure-5": "Fig. 5. 50 g of glucose at 50 min without noise: four controllers.",
    "figure-6": "Fig. 6. Linear MPC with dead times that it does not know of, readings with noise of variance 1.45.",
    "tuning-mpc": "Sum of squared errors of linear MPC over its tunings, without noise.",
    "tuning-mpc-se": "Sum of squared errors of MPC/SE over its tunings, without noise.",
    "tuning-nlqdmc-se": "Sum of squared errors of NLQDMC/SE over its tunings, without noise.",
}
_QUICK_DEAD_TIMES_MIN: Final = (0, 5)


@dataclass(frozen=True)
class _PaperPart:
    """A table or figure of the paper, or several together."""

    experiments: frozenset[Experiment]
    entries: tuple[str, ...] = ()
    """Beginnings of the names of its printed numbers; empty where it has no numbers."""
    figures: tuple[str, ...] = ()
    """Names of figures, as in `_CAPTIONS`."""


WHOLE: Final = _PaperPart(all_experiments(), entries=("",), figures=tuple(_CAPTIONS))
_TABLES: Final = {
    "I": _PaperPart(frozenset({NOISE_FREE}), entries=("table-1.",)),
    "II": _PaperPart(noisy_runs(), entries=("table-2.",)),
}
FIGURES: Final = {
    "2": _PaperPart(frozenset({"model"}), figures=("figure-2",)),
    "3": _PaperPart(frozenset({"model"}), entries=("model.validation.",), figures=("figure-3",)),
    "4": _PaperPart(noisy_runs((0,)), entries=("figure-4.",), figures=("figure-4",)),
    "5": _PaperPart(frozenset({NOISE_FREE}), figures=("figure-5",)),
    "6": _PaperPart(frozenset(("mpc", f"{minutes}") for minutes in DEAD_TIMES_MIN), figures=("figure-6",)),
}
_ARABIC: Final = {"1": "I", "2": "II"}


def _chosen(tables: Sequence[str], figures: Sequence[str]) -> _PaperPart:
    """The named tables and figures together; the whole paper if none is named."""
    parts = []
    for kind, names, catalogue in (("table", tables, _TABLES), ("figure", figures, FIGURES)):
        for name in names:
            key = name.strip().upper()
            key = _ARABIC.get(key, key) if kind == "table" else key
            if key not in catalogue:
                raise Refusal(f"unknown {kind} {name!r}; the known ones are: {', '.join(catalogue)}")
            parts.append(catalogue[key])
    if not parts:
        return WHOLE
    return _PaperPart(
        experiments=frozenset().union(*(part.experiments for part in parts)),
        entries=tuple(entry for part in parts for entry in part.entries),
        figures=tuple(figure for part in parts for figure in part.figures),
    )


def results_of(config: Reproduction, progress: Progress) -> Results:
    """Run what is asked for at each operating point, and compare the results with the printed numbers."""
    part = _chosen(config.table, config.figure)
    if config.controller and not any(isinstance(one, tuple) or one == NOISE_FREE for one in part.experiments):
        raise Refusal(
            "the named figures have no loops, so that a controller has no place in them; leave --controller out, or "
            "name a table"
        )
    own = _own_cases(config)
    for name in config.points:
        if name not in OPERATING_POINTS:
            raise Refusal(f"unknown operating point {name!r}; the known ones are: {', '.join(OPERATING_POINTS)}")
    experiments = part.experiments
    if config.quick:
        experiments &= all_experiments(_QUICK_DEAD_TIMES_MIN, tunings=False)
    return _compared_results(
        {
            point: study(point, experiments, seeds=config.runs, seed=config.seed, progress=progress, own=own)
            for point in config.points
        },
        part,
        config.seed,
        list(own),
    )


def _own_cases(config: Reproduction) -> dict[str, Request[Case]]:
    """Controllers that the paper does not have, by label."""
    cases: dict[str, Request[Case]] = {}
    for case in config.controller:
        label = label_of(case)
        if label in PAPER_CONTROLLERS:
            raise Refusal(
                f"{label} is one of the paper's own controllers, which are in its tables already; give it other "
                "settings, or leave it out"
            )
        if label in cases:
            raise Refusal(f"two controllers are named {label!r}; give one of them a label of its own")
        cases[label] = case
    return cases


@dataclass(frozen=True)
class _ReproductionResults:
    """Results at each operating point, and the entries of a part of the paper beside them."""

    studies: Mapping[str, PointResults]
    rows: Sequence[ComparedEntry]
    figures: Sequence[str]


def _compared_results(
    studies: Mapping[str, PointResults], part: _PaperPart, seed: int, own: Sequence[str] = ()
) -> Results:
    """Results of the study from those at each operating point; `own` are labels of controllers of one's own."""
    rows = [row for row in compare(studies, part.entries, own) if row.reproduced or not row.entry.is_own]
    entries = [
        {
            **dataclasses.asdict(row.entry),
            "reproduced": {
                point: {
                    "median": result.median,
                    "p10": result.low,
                    "p90": result.high,
                    "unsettled": result.unsettled,
                    "difference": row.difference(point),
                    "agrees": row.agrees(point),
                    "agrees_by_spread": row.agrees_by_spread(point),
                }
                for point, result in row.reproduced.items()
            },
        }
        for row in rows
    ]
    plain = {
        "paper": "Parker, Doyle, Peppas 1999, IEEE Trans. Biomed. Eng. 46(2), 148-157",
        "seed": seed,
        "seeds": {point: results.seeds for point, results in studies.items()},
        "entries": entries,
        "interpretations": INTERPRETATIONS,
    }
    return Results(plain, extra=_ReproductionResults(studies, rows, part.figures))


def tables(config: Reproduction, results: Results) -> Iterator[FittingTable]:
    """Each entry that was reproduced, as printed and at each operating point."""
    lines: list[Line] = []
    for row in results.extra.rows:
        texts = {point: _reproduced(row, point) for point in config.points}
        lines += [(row.entry.what, [{"printed": _printed_with_unit(row), **texts}])] if row.reproduced else []
    unsettled = any(UNSETTLED in text for _, cells in lines for text in cells[0].values())
    columns = [Column(name=name, short=name, text=str) for name in ("printed", *config.points)]
    if lines:
        yield terminal_table("entry", [("", lines)], columns, caption=f"{_CELLS}{_UNSETTLED if unsettled else ''}")


def sentences(config: Reproduction, results: Results) -> Iterator[str]:
    """Number of entries that reproduce at each operating point; without printed numbers, what there is instead."""
    rows = results.extra.rows
    if rows:
        yield from (f"{point}: {count(rows, point)}." for point in config.points)
        yield from filter(None, [left_out(rows)])
    else:
        yield "Nothing is printed there in numbers; the pictures are among the files of --out."


def files_of(config: Reproduction, result: Results) -> dict[str, bytes]:
    """Figures, and the page with them."""
    results: _ReproductionResults = result.extra
    files: dict[str, bytes] = {}
    images = []
    for point, of_point in results.studies.items():
        for name, figure in _figures_of(of_point, results.figures).items():
            files |= figure_files(f"{point}-{name}", figure)
            images.append((f"{_CAPTIONS[name]} At {point}.", base64.b64encode(files[f"{point}-{name}.svg"]).decode()))
    return {**files, "report.html": page(results.studies, results.rows, config.seed, images).encode()}


def _figures_of(results: PointResults, names: Collection[str]) -> dict[str, Figure]:
    """The named figures of an operating point, apart from those whose experiments were not carried out."""
    figures: dict[str, Callable[[], Figure]] = {}
    if (model := results.model) is not None:
        insulin = np.asarray(model.validation_record.insulin_mU_min) - float(results.patient.basal_insulin_mU_min)
        figures["figure-2"] = lambda: plot_identification(model.noisy, truth=model.noise_free.impulse_response)
        figures["figure-3"] = lambda: plot_validation(
            model.validation,
            sample_time_min=model.noisy.model.sample_time_min,
            insulin_deviation_mU_min=insulin,
            width="double",
        )
    traces = {run: loops.example for run, loops in results.runs.items()}
    own = {name: name for name, _ in traces if name not in PAPER_CONTROLLERS}
    labels = {**PAPER_CONTROLLERS, **own}
    loops_of = {
        "figure-4": {text: traces[name, "0"] for name, text in labels.items() if (name, "0") in traces},
        "figure-5": {text: traces[name, NOISE_FREE] for name, text in labels.items() if (name, NOISE_FREE) in traces},
        "figure-6": {
            f"{time} min": trace for (name, time), trace in traces.items() if name == "mpc" and time.isdigit()
        },
    }
    figures |= {name: functools.partial(plot, loops) for name, loops in loops_of.items() if loops}
    for name, surface in results.tuning.items():
        printed = printed_tuning(results.operating_point, name)
        figures[f"tuning-{name}"] = functools.partial(plot_surface, surface, printed=printed)
    return {name: figure() for name, figure in figures.items() if name in names}


_SECTIONS: Final = (
    ("Table I: disturbance rejection without noise", "table-1."),
    ("Table II: dead time, with noise", "table-2."),
    ("Figures and claims of the text", ("figure-", "claim.")),
    ("Patient, model and identification", "model."),
    ("Tunings", "tuning."),
)
_CELLS: Final = (
    "In each cell: the result, its difference from the printed number, and whether it agrees. Spread: it agrees only "
    "because the printed number lies within the spread of the seeds. Input: the printed number was put in, so that it "
    "cannot but agree."
)
_UNSETTLED: Final = f" {UNSETTLED}: glucose has not settled by the end of the run."
_NUMBERS: Final = {name: str(number) for number, name in enumerate(INTERPRETATIONS, 1)}
"""Numbers of the interpretations, by which the rows name them."""


@dataclass(frozen=True)
class _Table:
    """Rows of text under a heading."""

    heading: str
    note: str
    columns: Sequence[str]
    rows: Sequence[Sequence[str]]


def _entry_tables(rows: Sequence[ComparedEntry], studies: Mapping[str, PointResults]) -> list[_Table]:
    """Tables of the printed entries; those of experiments that were not carried out are left out."""
    shown: list[_Table] = []
    for heading, beginning in _SECTIONS:
        cells = [
            (
                row.entry.what,
                _printed_with_unit(row),
                *(_reproduced(row, point) for point in studies),
                "" if row.entry.is_own else f"p. {row.entry.page}, {row.entry.place}",
                ", ".join(_NUMBERS[name] for name in row.entry.interpretations),
            )
            for row in rows
            if row.entry.id.startswith(beginning) and row.reproduced
        ]
        if cells:
            columns = ("Entry", "Printed", *studies, "Place", "Interpretations")
            unsettled = _UNSETTLED if any(UNSETTLED in text for line in cells for text in line) else ""
            note = unsettled.strip() if shown else f"{_CELLS}{unsettled}"
            shown.append(_Table(heading, note, columns, cells))
        if cells and beginning == "table-2." and any(one.identified_anew for one in studies.values()):
            shown.append(_known_dead_times(studies))
    return shown


def _printed_text(row: ComparedEntry) -> str:
    """The printed number, bound or word."""
    printed = row.entry.printed
    if row.entry.is_own:
        return "none"
    text = printed if isinstance(printed, str) else f"{printed:g}"
    return f"at most {text}" if row.entry.kind == "at-most" else text


def _printed_with_unit(row: ComparedEntry) -> str:
    text = _printed_text(row)
    return f"{text}, in {row.entry.unit}" if row.entry.is_own and row.entry.unit else f"{text} {row.entry.unit}".strip()


def _reproduced(row: ComparedEntry, point: str) -> str:
    """The result at an operating point, its difference from the printed number, and whether it agrees."""
    results, difference = row.reproduced.get(point), row.difference(point)
    if results is None:
        return "not run"
    if row.entry.is_own:
        return results.text
    if row.agrees_by_spread(point):
        verdict = "spread"
    elif row.agrees(point):
        verdict = "input" if point in row.entry.input_at else "yes"
    else:
        verdict = "no"
    return "; ".join([results.text, *([] if difference is None else [f"{difference:+.2f}"]), verdict])


def _known_dead_times(studies: Mapping[str, PointResults]) -> _Table:
    rows = []
    for point, results in studies.items():
        for dead_time, anew in results.identified_anew.items():
            both = results.runs["mpc", dead_time], anew
            rows.append(
                (
                    point,
                    f"{dead_time.removesuffix('M')} min",
                    *(Reproduced.of(runs.metrics.undershoot_mg_dl).text for runs in both),
                )
            )
    return _Table(
        "Linear MPC with a known dead time, in two ways: undershoot, mg/dl",
        "The paper identifies a new model from delayed records. Two Laguerre functions cannot hold leading zeros, so "
        "such a model counts on a response that has not begun; shifting the model of the undelayed patient is nearer "
        "to the printed rows, and is what Table II above shows.",
        ("Operating point", "Dead time", "Model shifted", "Model identified again"),
        rows,
    )


def _closing_tables(rows: Sequence[ComparedEntry]) -> list[_Table]:
    """Tables of the entries that do not reproduce, and of the interpretations that the rows rest on."""
    if not rows:
        return []
    failed = [
        (row.entry.what, _printed_with_unit(row), point, results.text, reason_for(row.entry.id, point) or "not known")
        for row in rows
        for point, results in row.reproduced.items()
        if row.agrees(point) is False
    ]
    used = {name for row in rows for name in row.entry.interpretations}
    return [
        _Table(
            "What does not reproduce",
            "A number agrees if it is within a tenth of the printed one, or if the printed one lies between the 10th "
            "and the 90th percentile over the seeds, which the tables mark with the word spread; a bound agrees if it "
            "is kept. Everything else is listed here, at each operating point, with the reason where one is known.",
            ("Entry", "Printed", "Operating point", "Reproduced", "Reason"),
            failed,
        ),
        _Table(
            "Interpretations",
            "What the paper leaves open, and how it is read here; rows name by number what they rest on.",
            ("Number", "Name", "Choice"),
            [(_NUMBERS[name], name, choice) for name, choice in INTERPRETATIONS.items() if name in used],
        ),
    ]


def _summary(rows: Sequence[ComparedEntry], studies: Mapping[str, PointResults], seed: int) -> list[str]:
    sentences = []
    for point, results in studies.items():
        if any(row.agrees(point) is not None for row in rows):
            noisy = any(situation.rstrip("M").isdigit() for _, situation in results.runs)
            seeds = f" Noisy entries are medians over {results.seeds} seeds, with the 10th and 90th percentile."
            sentences.append(f"At {point}, {count(rows, point)}.{seeds if noisy else ''}")
    return [*sentences, *filter(None, [left_out(rows)]), f"glucoloop {glucoloop.__version__}, seed {seed}."]


def page(
    studies: Mapping[str, PointResults],
    rows: Sequence[ComparedEntry],
    seed: int,
    images: Sequence[tuple[str, str]] = (),
) -> str:
    """The report as one page; `images` are captions, and SVG files in base64."""
    return render(
        Path(__file__).with_name("page.html"),
        "Parker, Doyle and Peppas (1999), reproduced",
        sentences=_summary(rows, studies, seed),
        tables=_entry_tables(rows, studies),
        figures=images,
        closing_tables=_closing_tables(rows),
    )
