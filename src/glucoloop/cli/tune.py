"""``glucoloop tune``: every tuning of a grid in one situation, and which of them are any good."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final

from glucoloop.cli.options import (
    CASE,
    FAULTS,
    NO_FAULT,
    OF_OTHERS,
    OUTPUT,
    SITUATION,
    Given,
    Option,
    names,
    with_options,
)
from glucoloop.cli.request import Output, file_keys, split_off_output, with_lists
from glucoloop.cli.screen import show, stage, stages
from glucoloop.cli.telling import print_json, where_written
from glucoloop.registry.controllers import CONTROLLERS, TUNABLE, controller_entry, setting_names
from glucoloop.registry.guard import GUARD
from glucoloop.registry.patients import USUAL_PATIENT
from glucoloop.storage.strict_json import with_version

if TYPE_CHECKING:
    from rich.table import Table

    from glucoloop.config import Run
    from glucoloop.control import MPCTuning
    from glucoloop.storage.folder import OutputFolder
    from glucoloop.storage.model_file import ModelFile
    from glucoloop.tuning.surface import TuningRank, TuningSurface

HELP: Final = (
    "Try every tuning of a grid: the same patient, meals, sensor and pump for each, one table, one picture.\n\n"
    "A tuning is acceptable if it keeps the constraints (rate, magnitude, glucose above 60 mg/dl) and does not "
    "oscillate; acceptable ones are ranked by the sum of squared errors, and the paper's own tuning is told beside "
    "them. Ranges are written 1:4, with both ends, 2:16:2 or .3:.8:.05, in steps, or 0,1,3. With --noise, results are "
    "medians over seeds, and oscillation is judged without noise.\n\n"
    "  glucoloop tune --move-horizon 1:4 --prediction-horizon 2:16 --out surface\n\n"
    "  glucoloop tune --controller mpc-se --reference-filter .3:.8:.1 --top 5\n\n"
    "  glucoloop tune --noise 1.45 --seeds 20 --move-horizon 2 --prediction-horizon 10 --move-weight 0,1,3"
)
MOST_SEEDS: Final = 1000
_GRID: Final = "Grid"
_SUMMARIES: Final = {
    "move_horizon": ("Numbers of planned moves, m.", "1:4"),
    "prediction_horizon": ("Numbers of predicted samples, p; those below m are left out.", "1:14"),
    "reference_filter": (
        "Filters of the reference, φ_r; closer to 1 is slower.",
        "mpc-se: .3:.8:.05; nlqdmc-se: .3:.5:.1,.57,.7,.8",
    ),
    "output_weight": ("Weights on the error of glucose, Γ_y; only the ratio to Γ_u matters.", "the paper's"),
    "move_weight": ("Weight on each move of insulin, Γ_u.", "the paper's"),
}
_RANGES: Final = tuple(
    Option(key, f"--{key.replace('_', '-')}", str, summary, _GRID, metavar="RANGE", default=default)
    for key, (summary, default) in _SUMMARIES.items()
)
_SEEDS: Final = Option(
    "seeds",
    "--seeds",
    int,
    "Number of runs of each tuning with noise, from --seed on.",
    _GRID,
    metavar="N",
    default="5",
)
_TOP: Final = Option("top", "--top", int, "Number of tunings in the table.", _GRID, metavar="N", default="10")


_NOT_TUNED: Final = ("guard", *GUARD)
"""Settings of the guard, which are not tuned, since a search is for the controller in a sound loop."""


def _fixed() -> Iterator[Option]:
    """Options of a case that are not tuned: settings of controllers that are not tuned here are left out."""
    own = {setting.name for name in TUNABLE for setting in CONTROLLERS[name].settings}
    foreign = setting_names() - own
    for option in CASE:
        if option.key == "controller":
            told = "; ".join(f"{name}: {CONTROLLERS[name].summary}" for name in TUNABLE)
            yield dataclasses.replace(option, help=f"{told}; {OF_OTHERS}.")
        elif option.key not in {*_SUMMARIES, *foreign, *_NOT_TUNED}:
            yield option


def _situation() -> Iterator[Option]:
    return (option for option in SITUATION if option.key not in (FAULTS, NO_FAULT))


_OPTIONS: Final = (*_RANGES, _SEEDS, _TOP, *_situation(), *_fixed(), *OUTPUT)


@dataclass(frozen=True)
class _Asked:
    """A search, complete and checked."""

    run: Run
    """Run with the situation, and the controller with the parameters that are not tuned."""
    ranges: Mapping[str, str]
    """Range of each tuned parameter, as written."""
    grid: Sequence[MPCTuning]
    seeds: int
    top: int

    def keys(self) -> dict[str, Any]:
        """The flat keys from which the same search is read."""
        return {**self.run.keys(), **self.ranges, "seeds": self.seeds, "top": self.top}


@dataclass(frozen=True)
class _Found:
    """Results of a search."""

    surface: TuningSurface
    printed: TuningRank
    model: ModelFile | None
    notes: tuple[str, ...]


@with_options(_OPTIONS)
def command(given: Given) -> None:
    """Check the request, search, write and print the results."""
    keys, output, file = split_off_output(given)
    texts = with_lists(keys), file_keys(file)
    files: dict[str, str] = {}
    with output.folder() as folder:
        with stage("Importing the simulator"):
            from glucoloop.cli.compiled import keep_compiled

            asked = _read(*texts)
        keep_compiled()
        found = _search(asked)
        if folder is not None:
            with stage("Drawing"):
                found = _write(folder, asked, found)
            files = folder.paths()
    _tell(asked, found, output, files)


def _read(keys: Given, of_file: Given) -> _Asked:
    from glucoloop.config import overlay, read_run

    called = names(_OPTIONS, keys)
    together = overlay(of_file, keys, called)
    controller = str(together.get("controller", "mpc"))
    entry = controller_entry(controller)
    if not entry.tunable:
        raise ValueError(f"the controller {controller!r} cannot be tuned; the known ones are: {', '.join(TUNABLE)}")
    told = {key: _text(together.pop(key), called.get(key, key)) for key in _SUMMARIES if key in together}
    for key in told:
        entry.setting(key)
    top = _whole(together.pop("top", 10), called.get("top", "top"), 1, 100_000)
    seeds = together.pop("seeds", None)
    run = read_run(together, called)
    noisy = run.situation.noisy
    if seeds is not None and not noisy and seeds != 1:
        raise ValueError(f"{called.get('seeds', 'seeds')} is {seeds}, but without noise all are alike; leave it out")
    ranges = {**_default_ranges(run), **told}
    return _Asked(
        run=run,
        ranges=ranges,
        grid=_grid(run, ranges, called),
        seeds=_whole(seeds, called.get("seeds", "seeds"), 1, MOST_SEEDS) if seeds is not None else 5 if noisy else 1,
        top=top,
    )


def _text(value: object, name: str) -> str:
    """A range as text; a file may hold a number or a list of numbers."""
    if isinstance(value, list) and value:
        return ",".join(_text(item, name) for item in value)
    if isinstance(value, str | int | float) and not isinstance(value, bool):
        return str(value)
    raise ValueError(f"{name} is {value!r}; write it like 1:4 or 0,1,3")


def _whole(value: object, name: str, least: int, most: int) -> int:
    if not isinstance(value, int) or isinstance(value, bool) or not least <= value <= most:
        raise ValueError(f"{name} is {value!r}; give a whole number from {least} to {most}")
    return value


def _default_ranges(run: Run) -> dict[str, str]:
    from glucoloop.tuning.paper import REFERENCE_FILTERS

    weights = {key: f"{run.case.tuning[key]:g}" for key in ("output_weight", "move_weight")}
    filters = REFERENCE_FILTERS.get(run.case.controller)
    horizons = {key: _SUMMARIES[key][1] for key in ("move_horizon", "prediction_horizon")}
    return {**horizons, **weights, **({} if filters is None else {"reference_filter": filters})}


def _grid(run: Run, ranges: Mapping[str, str], called: Mapping[str, str]) -> list[MPCTuning]:
    from glucoloop.tuning.grid import parse_integers, parse_numbers, tuning_grid

    def numbers(key: str) -> tuple[float, ...]:
        return parse_numbers(ranges[key], called.get(key, key))

    return tuning_grid(
        parse_integers(ranges["move_horizon"], called.get("move_horizon", "move_horizon")),
        parse_integers(ranges["prediction_horizon"], called.get("prediction_horizon", "prediction_horizon")),
        output_weights=numbers("output_weight"),
        move_weights=numbers("move_weight"),
        reference_filters=numbers("reference_filter") if "reference_filter" in ranges else None,
        reference_start=int(run.case.tuning.get("reference_start", 1)),
    )


def _search(asked: _Asked) -> _Found:
    from glucoloop.cli import closed_loop
    from glucoloop.experiments.surroundings import pump_of, sensor_of
    from glucoloop.simulation import Adaptive, Exponential
    from glucoloop.tuning.designers import designer
    from glucoloop.tuning.paper import usual_tuning
    from glucoloop.tuning.search import search

    run, situation = asked.run, asked.run.situation
    made = situation.situation()
    with stage("Identifying"):
        model = closed_loop.model_for(run, made)

    design = designer(
        made,
        run.case.case(),
        None if model is None else model.step_response_model(),
        model_is_late=model is not None and bool(model.provenance.dead_time_min),
    )
    printed = usual_tuning(made, run.case.controller)
    called = "printed" if made.patient == USUAL_PATIENT.name else "usual"
    grid = [*asked.grid] if printed in asked.grid else [*asked.grid, printed]
    noise, bound, late = situation.noise_variance, situation.noise_bound_mg_dl, situation.dead_time_samples
    with stages(f"Designing {len(grid)} controllers") as progress:
        surface = search(
            made.nominal,
            design,
            grid,
            name=run.case.controller,
            scenario=situation.scenario(announced=situation.announce_meals),
            sensor=sensor_of(noise, bound, late, situation.site),
            quiet_sensor=sensor_of(0.0, bound, late, situation.site) if situation.noisy else None,
            seeds=range(situation.seed, situation.seed + asked.seeds),
            pump=pump_of(made.limits, situation.pump_resolution_mU_min),
            limits=made.limits,
            integrator=Exponential() if situation.integrator == "fast" else Adaptive(),
            progress=lambda done, total: progress(f"{done} of {total} runs"),
        )
    notes = (*closed_loop.notes_on(run, model), *_notes(asked, surface))
    return _Found(surface=surface, printed=surface.rank_of(printed, called), model=model, notes=notes)


def _notes(asked: _Asked, surface: TuningSurface) -> Iterator[str]:
    points = len(surface.tunings)
    broken = int((~surface.feasible).sum())
    ringing = int((surface.oscillates & surface.feasible).sum())
    yield (
        f"Of {points} tunings {broken} break a constraint and {ringing} more oscillate; "
        f"{int(surface.acceptable.sum())} are acceptable."
    )
    if surface.refused:
        yield f"{len(surface.refused)} tunings have no controller: {surface.refused[0][1]}."
    if asked.run.situation.noisy:
        yield f"Results are medians of {surface.seeds} seeds; oscillation was judged without noise."


def _write(folder: OutputFolder, asked: _Asked, found: _Found) -> _Found:
    import polars as pl

    from glucoloop.cli.pictures import write_figure
    from glucoloop.config import toml_text
    from glucoloop.report.surface import plot_surface
    from glucoloop.report.surface_page import surface_page
    from glucoloop.storage import tables
    from glucoloop.storage.strict_json import json_text

    table = pl.DataFrame(found.surface.columns())
    folder.write("surface.parquet", tables.parquet(table))
    folder.write("surface.csv", tables.csv(table))
    folder.write("tune.json", json_text(with_version(_report(asked, found))) + "\n")
    repeat = asked
    if found.model is not None:
        folder.write("model.json", found.model.text())
        if asked.run.case.model is not None:
            repeat = dataclasses.replace(asked, run=asked.run.with_model("model.json"))
    folder.write("tune.toml", toml_text(repeat.keys(), "tune --config tune.toml"))
    title = f"{asked.run.case.controller} at {asked.run.situation.place}"
    told = [_verdict(found), *found.notes]
    page = surface_page(found.surface, found.printed, title=f"Tunings of {title}", grid=asked.grid, notes=told)
    folder.write("surface.html", page)
    try:
        # the printed tuning is drawn where the grid that was asked for has it, and told beside the picture elsewhere
        figure = plot_surface(
            found.surface.only(asked.grid), printed=found.printed.tuning, called=found.printed.called, title=title
        )
    except ValueError as error:
        return dataclasses.replace(found, notes=(*found.notes, f"No picture was drawn: {error}."))
    write_figure(folder, "surface", figure)
    return found


def _report(asked: _Asked, found: _Found) -> dict[str, object]:
    surface, printed = found.surface, found.printed
    columns = {name: values.tolist() for name, values in surface.columns().items()}
    return {
        "config": {**asked.keys(), "controller": surface.controller},
        "model": None if found.model is None else found.model.model_dump(mode="json"),
        "best": None if printed.best is None else {**dataclasses.asdict(printed.best), "sse": printed.best_sse},
        "printed": {**dataclasses.asdict(printed.tuning), "sse": printed.sse, "rank": printed.rank},
        "acceptable": printed.points,
        "surface": columns,
    }


def _tell(asked: _Asked, found: _Found, output: Output, files: dict[str, str]) -> None:
    if output.json:
        print_json(_report(asked, found), files, found.notes)
        return
    show(_table(found, asked.top))
    print(_verdict(found))
    for line in found.notes:
        print(line)
    print(where_written(output.out, files))


def _table(found: _Found, top: int) -> Table:
    """The first tunings of the order, and the printed one at its place."""
    from rich import box
    from rich.table import Table

    from glucoloop.report.tuning_rows import heads, tuning_rows

    table = Table(box=box.SIMPLE_HEAD, pad_edge=False)
    for name, unit in heads(found.surface):
        table.add_column(f"{name}\n{unit}" if unit else name, justify="right" if name else "left")
    for row in tuning_rows(found.surface, found.printed, top):
        if row.apart:
            table.add_section()
        table.add_row(*row.cells)
    return table


def _verdict(found: _Found) -> str:
    from glucoloop.tuning.surface import tuning_text

    printed = found.printed
    told = f"The {printed.called} tuning {tuning_text(printed.tuning)}"
    if printed.rank is None:
        return f"{told} is not acceptable here."
    if printed.rank == 1:
        return f"{told} is the best of {printed.points} acceptable ones."
    best = "" if printed.best is None else f" with {printed.sse:.4g} against {printed.best_sse:.4g} of the best"
    return f"{told} ranks {printed.rank} of {printed.points} by the sum of squared errors,{best}."
