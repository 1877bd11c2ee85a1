"""Declaration of a study, from which its command, help, folder, resumption, files, JSON and exit code are made.

To add a study
--------------
1. ``studies/NAME/__init__.py`` declares it: what it asks for, a class of settings that usually extends a
   `situations.run.Run` or a `trials.trial.Trial`, with other defaults where it has its own, and one of the three
   kinds below. It imports nothing heavy, since help is shown from it. Add a line to ``studies/catalogue.py``: the
   command is there.
2. The module that it names, ``studies/NAME/study.py``, does the work, in functions. What they are given (``config``) is
   that class, complete and checked. Loops of people are closed by `trials.engine.loop_of`.
3. ``page.html`` beside it, if it has a page, extends ``reporting/templates/base.html``; `reporting.template.render`
   fills it.

Every module has ``tables(config, results)``, which makes tables for the terminal, as by
`reporting.columns.terminal_table`, of which ``tables.tex`` is made; where the study keeps files, also
``files_of(config, results)``: pages and figures by the names of their files. It may have

- ``notes(config)``: sentences on what is possible and hardly meant, before the work begins.
- ``sentences(config, results)``: conclusions, for the terminal and the page.
- ``next_steps(results, files)``: sentences on the use of the files, whose paths it gets by their names.

By its kind it has

- `TrialStudy`: its cells are cases of a trial, whose folder resumes. ``trial_of(config)`` is that trial;
  ``results_of(config, folder)`` sums up the people of its shards. Example: ``studies/stress``.
- `SearchStudy`: it keeps a row for each step in a folder that resumes. ``rows(config)`` describes the rows;
  ``search(config)`` prepares the search, which may take long: its ``missing(rows)`` yields the rows that follow those
  that are there, and its ``results_of(rows)`` sums up all. Example: ``studies/adversary``.
- `PlainStudy`: it is carried out in one go by ``results_of(config, progress)``, where `progress` is called with a text
  for what was done or, in a study that counts units, with their number; ``amount(config)`` is that of all. A folder is
  written whole or not at all, with what was found, what was drawn and the configuration. Where ``holds`` or
  ``complete`` is False among the results, the exit code is 1. Example: ``studies/tuning``.

What was found is a `storage.results.Results`: plain values, which are the summary and the JSON, and tables by the
names of their files. ``notes`` among the plain values are sentences that JSON tells on standard error too. A finished
folder gives the plain values back, so `tables` and `sentences` of a study that resumes use nothing else; figures may
also use ``extra``, which is not kept. A number of a cell is declared once, as a `reporting.columns.Column`:
``measured`` computes it from people, and files, JSON, terminal and page follow. ``reporting/heat.py`` draws heat maps,
and ``reporting/templates/parts.html`` has macros for tables of columns, maps, faults, facts and how to repeat a study.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Final

from glucoloop.component.base import Component

COMPONENTS_HELP: Final = (
    "A COMPONENT is a name and its settings, like 'mpc-se, move_horizon=2'; settings without a name change the "
    "component that is there. `glucoloop list` shows all components, `glucoloop list mpc-se` the settings of one. A "
    "number may have its unit: 5.5mmol/l, 4U/h, 1.5h."
)
"""Paragraph of the help of every command that takes components."""


@dataclass(frozen=True, kw_only=True)
class Study:
    """Declaration that all kinds of studies share."""

    name: str
    """Name of the command, and of its configuration file."""
    what: str
    """The study in messages: ``"a stress test"``."""
    help: str
    module: str
    """Module that does the work, imported when it runs."""
    request: type[Component]
    """Class of its requests: its own settings, and those of the run or the trial that it extends."""
    option_texts: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)
    """Fields of options by key, in place of the default ones: ``{"help": {"people": "All people."}}``."""
    files: tuple[str, ...] = ()
    """Names of all its tables, pages and figures."""
    summary: str = "summary.json"
    """Name of the file with everything that was found, as JSON."""
    extent: tuple[str, ...] = ()
    """Settings that may differ when it is resumed: how far it goes, and what is asked of its results."""


@dataclass(frozen=True, kw_only=True)
class TrialStudy(Study):
    """A study whose cells are cases of a trial: it keeps the folder of that trial, and sums it up in its own way."""

    on_clusters: bool = False
    """Whether it can be computed on a cluster."""


@dataclass(frozen=True, kw_only=True)
class SearchStudy(Study):
    """A study that keeps a row for each of its steps, and goes on where it was."""

    results: str
    """File of its rows."""
    needs_folder: bool = True
    """Whether it is always kept in a folder."""
    partial: bool = False
    """Whether the first rows are results too, which are shown after an interrupt where no folder keeps them."""


@dataclass(frozen=True, kw_only=True)
class PlainStudy(Study):
    """A study that is carried out in one go."""

    unit: str = ""
    """Name of the units that are counted while it works, ``"samples"``; none by default."""
