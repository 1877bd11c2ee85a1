"""The commands of studies as functions of Python, with the words of the command line and the same results.

``glucoloop run --controller 'mpc, move_weight=2' --noise 1.45 --out first`` is ::

    gl.run(controller="mpc, move_weight=2", noise=1.45, out="first")

Each keyword is an option without its dashes, or the key of it in a configuration file. A number, a text with a unit
(``"10h"``), a component or its text, a mapping of its settings, or a list of any of these where the option may be
repeated, are taken as the command line and files take them, and refused in the same words.
"""

from __future__ import annotations

import importlib
import io
import numbers
import warnings
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from datetime import timedelta
from decimal import Decimal
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from glucoloop.cli.command import CommandOption, Given
from glucoloop.cli.screen import collected_notes
from glucoloop.cli.study_command import StudyOutcome, carry_out, study_options
from glucoloop.component.base import Component
from glucoloop.component.code import loaded
from glucoloop.component.effects import NoEffectWarning
from glucoloop.component.grammar import component_text
from glucoloop.component.setting import known_names, value_text
from glucoloop.meals import Meal
from glucoloop.refusal import Refusal
from glucoloop.situations.meal_text import meal_text
from glucoloop.studies.catalogue import STUDIES
from glucoloop.studies.study import Study

if TYPE_CHECKING:
    import polars as pl
    from matplotlib.figure import Figure

    from glucoloop.simulation import Trace

_WIDTH = 100
"""Characters of a line of the printed tables."""


@dataclass(frozen=True, repr=False)
class CommandResult:
    """Results of a command: numbers, tables, and the files that hold them.

    ``print(result)`` shows what the command prints, and a notebook shows the same.
    """

    command: str
    """Name of the command."""
    outcome: StudyOutcome
    notes: tuple[str, ...]
    """Sentences that the command prints on standard error."""

    @property
    def config(self) -> dict[str, Any]:
        """The whole configuration as plain values, as a file of the command has them."""
        config: dict[str, Any] = self.outcome.run.config.tree(whole=True)
        return config

    @property
    def results(self) -> Mapping[str, Any]:
        """All results as plain values, which are the JSON of the command."""
        return self.outcome.results.plain

    @property
    def tables(self) -> Mapping[str, pl.DataFrame]:
        """Tables by the name of their file; none of work that was finished before, whose folder holds them."""
        return self.outcome.results.tables

    @property
    def files(self) -> Mapping[str, str]:
        """Paths of the files that were written, by name; empty without ``out``."""
        return self.outcome.files

    @property
    def holds(self) -> bool:
        """Whether everything that the command checks holds; its exit code is 0 then."""
        return self.outcome.holds

    @property
    def traces(self) -> Mapping[str, Trace]:
        """Trace of each controller by its label, of `run` and `compare`; Refusal for another command."""
        outcomes = getattr(self.outcome.results.extra, "outcomes", None)
        if outcomes is None:
            raise Refusal(f"{self.command} keeps no traces; gl.run and gl.compare do")
        return {label: outcome.trace for label, outcome in outcomes.items()}

    def plot(self) -> Figure:
        """Figure of the traces of `run` and `compare`."""
        from glucoloop.reporting import plot

        return plot(self.traces)

    def to_pandas(self, name: str | None = None) -> Any:
        """A table as a DataFrame of pandas, by the name of its file or the first one; needs pandas and nothing else."""
        pd = importlib.import_module("pandas")

        name = next(iter(self.tables), "") if name is None else name
        if name not in self.tables:
            raise Refusal(f"{self.command} has no table {name!r}; {known_names(name, list(self.tables))}")
        return pd.DataFrame(self.tables[name].to_dict(as_series=False))

    def __repr__(self) -> str:
        where = f", in {self.outcome.run.output.out}" if self.outcome.run.output.out is not None else ""
        return f"<glucoloop {self.command}: {', '.join(self.tables) or 'results'}{where}>"

    def __str__(self) -> str:
        return self._printed()[0]

    def _repr_html_(self) -> str:
        return self._printed()[1]

    def _printed(self) -> tuple[str, str]:
        from rich.console import Console

        console = Console(width=_WIDTH, record=True, file=io.StringIO(), highlight=False, markup=False, emoji=False)
        for item in (*self.outcome.tables(), *self.outcome.sentences()):
            console.print(item)
        html = console.export_html(inline_styles=True, code_format="<pre>{code}</pre>", clear=False)
        return console.export_text().rstrip(), html


def run(**options: Any) -> CommandResult:
    """Close the loop of one controller with a virtual patient, as ``glucoloop run`` does.

    Parameters
    ----------
    **options
        Options of the command: ``controller``, ``patient``, ``meal``, ``noise``, ``duration``, ``out`` and so on.

    Returns
    -------
    CommandResult
        Results with the trace in ``traces`` and the metrics in ``results``.

    Raises
    ------
    ValueError
        For an unknown option or a value that the command refuses.

    Examples
    --------
    >>> import glucoloop as gl
    >>> gl.run(controller="basal", duration="2h").results["metrics"]["minimum_mg_dl"] > 70.0
    True
    """
    return _command("run", options)


def compare(*controllers: Any, **options: Any) -> CommandResult:
    """Close the loop of several controllers in the same situation, as ``glucoloop compare`` does.

    `controllers` are those of ``--controller``; `options` are those of `run`. Returns, raises: as `run`.
    """
    return _command("compare", {**options, **({"controller": list(controllers)} if controllers else {})})


def trial(**options: Any) -> CommandResult:
    """Try controllers on a population of virtual people, as ``glucoloop trial`` does, in the folder ``out``.

    A folder that is unfinished is continued, and a finished one is read. Returns, raises: as `run`.
    """
    return _command("trial", options)


def report(*files: Any, **options: Any) -> CommandResult:
    """Report records of a glucose monitor, or glucose of simulations, as ``glucoloop report`` does.

    `files` are records and folders, as on the command line; `options` are ``period``, ``label``, ``goals``, ``out`` and
    so on. Returns, raises: as `run`.
    """
    return _command("report", {**options, **({"files": [str(file) for file in files]} if files else {})})


def _command(name: str, options: Mapping[str, Any]) -> CommandResult:
    study: Study = loaded(STUDIES[name].place)
    typed = _typed(name, study_options(study), options)
    with collected_notes() as notes:
        try:
            outcome = carry_out(study, typed)
        except SystemExit as end:  # an interrupt, after which the command keeps what was done
            raise KeyboardInterrupt(" ".join(notes)) from end
    for text in outcome.run.without_effect:
        warnings.warn(text, NoEffectWarning, stacklevel=3)
    return CommandResult(name, outcome, tuple(notes))


def _typed(command: str, options: tuple[CommandOption, ...], values: Mapping[str, Any]) -> Given:
    """Options by their keys, each with the text that stands on the command line for a value of Python."""
    by_name = {option.key: option for option in options}
    by_name |= {option.flag.lstrip("-").replace("-", "_"): option for option in options if not option.is_argument}
    typed: Given = {}
    for name, value in values.items():
        option = by_name.get(name)
        if option is None:
            raise Refusal(f"{command} has no option {name!r}; {known_names(name, list(by_name))}")
        if option.key in typed:
            raise Refusal(f"{option.key} is given twice, once as {name!r}; leave one out")
        if option.metavar is None:
            typed[option.key] = bool(value)
        elif value is not None:
            texts = [_text(option, item) for item in _items(option, value)] or ["none"]
            if len(texts) > 1 and not option.many:
                raise Refusal(f"{option.key} takes one value, not {len(texts)}; leave all but one out")
            typed[option.key] = texts if option.many else texts[0]
    return typed


def _items(option: CommandOption, value: Any) -> list[Any]:
    """Items of a list, of an iterator, and of an array or a column of one dimension; else the value alone."""
    if isinstance(value, set | frozenset):
        raise Refusal(f"{option.key} is a set, which has no order; give a list")
    if isinstance(value, list | tuple | Iterator):
        return list(value)
    whole = next((getattr(value, name) for name in ("tolist", "to_list") if hasattr(value, name)), None)
    if whole is None or isinstance(value, np.ma.MaskedArray):
        return [value]
    items = whole()
    return items if isinstance(items, list) else [items]


def _text(option: CommandOption, value: Any) -> str:
    """Text that stands on the command line for a value."""
    if isinstance(value, type) and issubclass(value, Component):
        value = value()
    if isinstance(value, Component):
        return component_text(value.as_request().tree())
    if isinstance(value, Meal) and value.announced_g is None and value.announced_min is None:
        return meal_text(value)
    if isinstance(value, Mapping):
        return component_text(value)
    if value is True and option.alone:
        return option.alone
    if isinstance(value, bool) and option.metavar in ("DIR", "FILE", "FILE..."):
        raise Refusal(f"{option.key} is {value}; give the name of a place, or leave it out")
    if isinstance(value, timedelta):
        return f"{value.total_seconds()!r}s"
    if isinstance(value, float):
        return repr(value)  # every digit
    if not isinstance(value, str | Path | numbers.Number | Decimal):
        raise Refusal(
            f"{option.key} is of the type {type(value).__name__}; give a number, a text as on the command line, a "
            "component or its settings, or a list of these"
        )
    text = str(value) if isinstance(value, str | Path) else value_text(value)
    if "\0" in text:
        raise Refusal(f"{option.key} has a character that no text has, NUL; leave it out")
    return text
