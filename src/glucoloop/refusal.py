"""The error of a value that cannot be used, or of a package that is missing: the user's mistake and no bug."""

from __future__ import annotations

import re
from collections.abc import Collection, Iterator
from contextlib import contextmanager
from typing import Final, Self

_OPTION: Final = re.compile(r"(?<![\w-])--[a-z][a-z-]*")
_COMMAND: Final = re.compile(r"`[^`]*`")


class Refusal(ValueError):  # noqa: N818 (it is no failure of the program)
    """A given value that is refused, in a sentence that names the value, the bound and the remedy.

    The command line prints the sentence and exits with code 2; any other error is a bug. Code of your own that checks
    the settings of a patient or a controller raises it too.

    Parameters
    ----------
    problem : str
        Sentence on what is wrong; with the remedy where every command that can raise it has the options of that.
    *remedies : str
        Ways out, each in the imperative. One that names an option, like ``add --allow-unusual``, is left out by
        commands that have no such option; what stands between backquotes is another command.
    """

    @property
    def problem(self) -> str:
        """Sentence on what is wrong, without the remedies."""
        return str(self.args[0]) if self.args else ""

    @property
    def remedies(self) -> tuple[str, ...]:
        """Ways out, each in the imperative."""
        return self.args[1:]

    def __str__(self) -> str:
        return _sentence(self.problem, self.remedies)

    def within(self, place: str) -> Refusal:
        """The same refusal of something that is part of a larger whole, which the sentence names first."""
        return Refusal(f"{place}: {self.problem}" if place else self.problem, *self.remedies)

    def with_remedy(self, remedy: str) -> Self:
        """The same refusal with one more way out."""
        self.args = (*self.args, remedy)
        return self

    def of_command(self, name: str, options: Collection[str]) -> str:
        """The sentence in a command that has these options, with the remedies that it has."""
        possible = tuple(remedy for remedy in self.remedies if options_named(remedy) <= set(options))
        if self.remedies and not possible:
            possible = (f"no option of glucoloop {name} changes that",)
        return _sentence(self.problem, possible)


def options_named(text: str) -> set[str]:
    """Options that a text names, like ``--out``, but for those of commands in backquotes."""
    return set(_OPTION.findall(_COMMAND.sub("", text)))


def _sentence(problem: str, remedies: tuple[str, ...]) -> str:
    if not remedies:
        return problem
    ways = ", or ".join(filter(None, (", ".join(remedies[:-1]), remedies[-1])))
    return f"{problem} {ways[0].upper()}{ways[1:]}" if problem.endswith(".") else f"{problem}; {ways}"


EXTRAS: Final = {
    "cmaes": "search",
    "dask": "dask",
    "distributed": "dask",
    "duckdb": "query",
    "fsspec": "store",
    "gymnasium": "gym",
    "optuna": "search",
    "python_calamine": "xlsx",
    "simglucose": "uva",
    "stable_baselines3": "rl",
}
"""Extra of ``pyproject.toml`` that installs a package."""


class MissingExtraError(Refusal):
    """An optional package is not installed; the message names its extra."""


@contextmanager
def needed_for(what: str) -> Iterator[None]:
    """Turn a failed import of an optional package in the block into a MissingExtraError that names the extra.

    `what` is the purpose of the import, as the subject of a sentence in the singular.
    """
    try:
        yield
    except ModuleNotFoundError as error:
        package = (error.name or "").partition(".")[0]
        if package not in EXTRAS:
            raise
        raise missing(what, package) from None


def missing(what: str, package: str) -> MissingExtraError:
    """Error that says which extra installs the optional package that something needs."""
    return MissingExtraError(f"{what} needs {package}; install it with: pip install 'glucoloop[{EXTRAS[package]}]'")
