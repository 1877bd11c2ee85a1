"""Declaration of a study, from which its command, help, folder, resumption, files, JSON and exit code are made.

To add a study
--------------
1. ``studies/NAME/__init__.py`` declares it: a record of its own settings, each an annotated field (see `config.key`),
   and one of the three kinds below. It imports nothing heavy, since help is shown from it. Add the study to
   ``studies/catalogue.py``, and take its old command out of ``cli/app.py``: the command is there.
2. The module that it names, ``studies/NAME/study.py``, does the work, in functions. A request (``asked``) is what
   `read` returns: complete and checked, with ``keys()``, the flat keys of all that is used, and ``given``, those that
   were given. The configuration that a folder keeps is read from the latter alone.
3. ``page.html`` beside it, if it has a page, extends ``report/templates/base.html``; `report.template.render` fills it.

Every module has

- ``read(keys, cases, names)``: the request, from flat keys; a Refusal names the keys as the user did.
- ``notes(asked)``: sentences on what is possible and hardly meant, before the work begins.
- ``tables(asked, found)``: tables for the terminal; ``report.columns.terminal_table`` makes one from columns.
- ``sentences(asked, found)``: conclusions, for the terminal and the page.
- ``drawn(asked, found)``: pages and figures by the names of their files.

and, by its kind:

- `TrialStudy`: its cells are cases of a trial, whose folder resumes. ``asked.trial`` is that trial;
  ``found(asked, folder)`` sums up the people of its shards. Example: ``studies/stress``.
- `SearchStudy`: it keeps a row for each step in a folder that resumes. ``rows(asked)`` describes the rows;
  ``search(asked)`` prepares a `RowSearch`, which makes the missing rows and sums them up. Example: ``studies/robust``.
- `PlainStudy`: it is carried out in one go by ``found(asked, progress)``. A folder is written whole or not at all, with
  what was found, what was drawn and the configuration. Where ``holds`` is False among the findings, the exit code is
  1; where ``interrupted`` is true, 130. Examples: ``studies/tuning``, and ``studies/verification``, which counts its
  loops and keeps nothing.

What was found is a `storage.findings.Findings`: plain values, which are the summary and the JSON, and tables by the
names of their files. ``notes`` among the plain values are sentences that JSON tells on standard error too. A finished
folder gives the plain values back, so `tables` and `sentences` of a study that resumes use nothing else; figures may
also use ``extra``, which is not kept. A number of a cell is declared once, as a `report.columns.Column`: ``measured``
computes it from people, and files, JSON, terminal and page follow. ``report/heat.py`` draws heat maps, and
``report/templates/parts.html`` has macros for tables of columns, maps, faults, facts and how to repeat a study.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Literal, Protocol

if TYPE_CHECKING:
    from glucoloop.storage.findings import Findings
    from glucoloop.storage.rows import Rows
    from glucoloop.storage.trials.folder import TrialFolder


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
    settings: tuple[type, ...]
    """Records of the study's own keys."""
    shared: Literal["trial", "run", "nothing"]
    """Keys that it shares with a trial or with a single run."""
    taken: tuple[str, ...] | None = None
    """The shared keys that the study has; by default all."""
    refused: tuple[str, ...] = ()
    """Shared keys that it does not have."""
    usual: Mapping[str, Any] = field(default_factory=dict)
    """Usual values of shared keys, where they are others than for a trial or a run."""
    words: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)
    """Fields of options by key, in place of the usual ones: ``{"help": {"people": "All people."}}``."""
    files: tuple[str, ...] = ()
    """Names of all its tables, pages and figures."""
    summary: str = "summary.json"
    """Name of the file with everything that was found, as JSON."""


@dataclass(frozen=True, kw_only=True)
class TrialStudy(Study):
    """A study whose cells are cases of a trial: it keeps the folder of that trial, and sums it up in its own way."""

    shared: Literal["trial", "run", "nothing"] = "trial"


@dataclass(frozen=True, kw_only=True)
class SearchStudy(Study):
    """A study that keeps a row for each of its steps, and goes on where it was."""

    shared: Literal["trial", "run", "nothing"] = "trial"
    needs_folder: bool = True
    """Whether it is always kept in a folder."""
    extent: type | None = None
    """The record, among those of the settings, of the keys that may differ when it is resumed: how far it goes."""


@dataclass(frozen=True, kw_only=True)
class PlainStudy(Study):
    """A study that is carried out in one go."""

    shared: Literal["trial", "run", "nothing"] = "run"
    unit: str = ""
    """Name of the units that are counted while it works, also among its findings: ``"loops"``; none by default."""
    keeps_files: bool = True
    """Whether it can write a folder, and read a configuration file."""


class Asked(Protocol):
    """A request that is complete and checked."""

    def keys(self) -> dict[str, Any]:
        """The flat keys of all values that are used."""
        ...

    @property
    def given(self) -> Mapping[str, Any] | None:
        """The flat keys that were given, from which the others follow; only for a study that keeps files."""
        ...


class Module(Protocol):
    """Module of a study of any kind."""

    def read(
        self, keys: Mapping[str, Any], cases: Sequence[Mapping[str, Any]] = (), names: Mapping[str, str] | None = None
    ) -> Any:
        """Read a request from flat keys and those of its cases; Refusal for what cannot be."""
        ...

    def notes(self, asked: Any) -> Iterable[str]:
        """Sentences on a request that is possible and hardly meant, before the work begins."""
        ...

    def tables(self, asked: Any, found: Findings) -> Iterable[object]:
        """Tables for the terminal."""
        ...

    def sentences(self, asked: Any, found: Findings) -> Iterable[str]:
        """Conclusions from what was found."""
        ...


class TrialModule(Module, Protocol):
    """Module of a study whose cells are cases of a trial; its request has a ``trial``."""

    def found(self, asked: Any, folder: TrialFolder) -> Findings:
        """Sum up the people of a folder whose shards are done."""
        ...

    def drawn(self, asked: Any, found: Findings) -> Mapping[str, bytes]:
        """Pages and figures, by the names of their files."""
        ...


class RowSearch(Protocol):
    """A search that was prepared."""

    def missing(self, rows: Sequence[Any]) -> Iterator[Any]:
        """The rows that follow those that are there, in their order."""
        ...

    def found(self, rows: Sequence[Any]) -> Findings:
        """Sum up all rows."""
        ...


class SearchModule(Module, Protocol):
    """Module of a study that keeps a row for each of its steps."""

    def rows(self, asked: Any) -> Rows[Any]:
        """Describe the rows that are kept."""
        ...

    def search(self, asked: Any) -> RowSearch:
        """Prepare the search, which may take long."""
        ...

    def drawn(self, asked: Any, found: Findings) -> Mapping[str, bytes]:
        """Pages and figures, by the names of their files."""
        ...


class PlainModule(Module, Protocol):
    """Module of a study that is carried out in one go."""

    def amount(self, asked: Any) -> int:
        """Amount of work in units of the study; only for one that counts them."""
        ...

    def found(self, asked: Any, progress: Callable[[Any], None]) -> Findings:
        """Carry it out; `progress` is called with the number of units, or with a text for what was done."""
        ...

    def drawn(self, asked: Any, found: Findings) -> Mapping[str, bytes]:
        """Pages and figures, by the names of their files; only for a study that keeps files."""
        ...
