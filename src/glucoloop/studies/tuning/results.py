"""Results of a search of a grid: the surface, sentences, and the files of its folder."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

import polars as pl

from glucoloop.parts.patients import USUAL_PATIENT
from glucoloop.printable import how_many
from glucoloop.refusal import Refusal
from glucoloop.report import Repeat
from glucoloop.report.facts import run_facts
from glucoloop.report.print_figure import figure_files
from glucoloop.report.surface import plot_surface
from glucoloop.report.surface_page import surface_page
from glucoloop.storage.model_file import ModelFile
from glucoloop.storage.strict_json import json_text, with_version
from glucoloop.storage.tables import csv, parquet
from glucoloop.studies.closed_loop import integrator_of, model_arguments, model_for, notes_on
from glucoloop.studies.tuning.keys import GridSearch
from glucoloop.tuning.designers import designer
from glucoloop.tuning.paper import usual_tuning
from glucoloop.tuning.search import search
from glucoloop.tuning.surface import TuningRank, TuningSurface, tuning_text


@dataclass(frozen=True)
class Searched:
    """Results of a search."""

    asked: GridSearch
    surface: TuningSurface
    printed: TuningRank
    """Rank of the tuning that is usual for the patient; for the patient of 1999 it is the printed one."""
    model: ModelFile | None
    notes: tuple[str, ...]

    @property
    def title(self) -> str:
        """The controller and the place."""
        return f"{self.asked.run.case.controller} at {self.asked.run.situation.place}"

    def report(self) -> dict[str, object]:
        """Plain values for JSON."""
        surface, printed = self.surface, self.printed
        return {
            "config": {**self.asked.keys(), "controller": surface.controller},
            "model": None if self.model is None else self.model.model_dump(mode="json"),
            "best": None if printed.best is None else {**dataclasses.asdict(printed.best), "sse": printed.best_sse},
            "printed": {**dataclasses.asdict(printed.tuning), "sse": printed.sse, "rank": printed.rank},
            "acceptable": printed.points,
            "surface": {name: values.tolist() for name, values in surface.columns().items()},
        }

    def verdict(self) -> str:
        """Sentence on the usual tuning among the others."""
        printed = self.printed
        told = f"The {printed.called} tuning {tuning_text(printed.tuning)}"
        if printed.rank is None:
            return f"{told} is not acceptable here."
        if printed.rank == 1:
            return f"{told} is the best of {how_many(printed.points, 'acceptable one')}."
        best = "" if printed.best is None else f" with {printed.sse:.4g} against {printed.best_sse:.4g} of the best"
        return f"{told} ranks {printed.rank} of {printed.points} by the sum of squared errors,{best}."


def search_grid(asked: GridSearch, progress: Callable[[str], None]) -> Searched:
    """Try every tuning of the grid, and the usual one.

    Parameters
    ----------
    asked : GridSearch
    progress : callable
        Called with what has been done.

    Raises
    ------
    ValueError
        For a situation or a design that is not possible.
    """
    run = asked.run
    situation = run.situation.situation()
    model = model_for(run, situation)
    design = designer(situation, run.case.case(), **model_arguments(model))
    printed = usual_tuning(situation, run.case.controller)
    grid = [*asked.grid] if printed in asked.grid else [*asked.grid, printed]
    progress(f"designing {len(grid)} controllers")
    surface = search(
        situation,
        design,
        grid,
        name=run.case.controller,
        scenario=run.situation.scenario(),
        seeds=range(situation.seed, situation.seed + asked.seeds),
        integrator=integrator_of(run.situation),
        progress=lambda done, total: progress(f"{done} of {total} runs"),
    )
    return Searched(
        asked=asked,
        surface=surface,
        printed=surface.rank_of(printed, "printed" if situation.patient == USUAL_PATIENT.name else "usual"),
        model=model,
        notes=(*notes_on(run, model), *_notes(asked, surface)),
    )


def _notes(asked: GridSearch, surface: TuningSurface) -> Iterator[str]:
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
    if asked.run.situation.noisy:
        yield (
            f"Results are medians of {how_many(surface.seeds, 'seed')}; oscillation was judged without "
            f"{'the noise around the sensor' if asked.run.situation.drawn_otherwise else 'noise'}."
        )
    elif surface.seeds > 1:
        yield f"Results are medians of {surface.seeds} seeds; oscillation was judged in the run of the first."


def files_of(found: Searched) -> tuple[dict[str, str | bytes], str | None]:
    """The files of the folder by name, and a sentence if no picture can be drawn."""
    asked, repeat = found.asked, found.asked
    table = pl.DataFrame(found.surface.columns())
    files: dict[str, Any] = {
        "surface.parquet": parquet(table),
        "surface.csv": csv(table),
        "tune.json": json_text(with_version(found.report())) + "\n",
    }
    if found.model is not None:
        files["model.json"] = found.model.text()
        if asked.run.case.model is not None:
            repeat = dataclasses.replace(asked, run=asked.run.with_model("model.json"))
    data = {"surface.csv": "all tunings", "tune.json": "the same"}
    again = Repeat("tune --config tune.toml", repeat.keys(), data, given=repeat.given)
    files["tune.toml"] = again.text
    files["surface.html"] = surface_page(
        found.surface,
        found.printed,
        title=f"Tunings of {found.title}",
        grid=asked.grid,
        notes=[found.verdict(), *found.notes],
        facts={
            **{f"Range of the {key.replace('_', ' ')}": text for key, text in asked.ranges.items()},
            **run_facts(repeat.run),
        },
        repeat=again,
    )
    try:
        # the printed tuning is drawn where the grid that was asked for has it, and told beside the picture elsewhere
        figure = plot_surface(
            found.surface.only(asked.grid), printed=found.printed.tuning, called=found.printed.called, title=found.title
        )
    except Refusal as error:
        return files, f"No picture was drawn: {error}."
    return {**files, **figure_files("surface", figure)}, None
