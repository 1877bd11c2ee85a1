"""Packages that glucoloop is installed without, and the extra that brings each."""

from __future__ import annotations

import importlib.util
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Final

EXTRAS: Final = {
    "cmaes": "search",
    "dask": "dask",
    "distributed": "dask",
    "duckdb": "query",
    "optuna": "search",
    "plotly": "pages",
}
"""The extra of ``pyproject.toml`` that installs a package."""


class MissingExtraError(ValueError):
    """A package is missing that an extra installs."""


@contextmanager
def needed_for(what: str) -> Iterator[None]:
    """Around the import of a package of an extra.

    Parameters
    ----------
    what : str
        What the package is imported for, as the subject of a sentence in the singular.

    Raises
    ------
    MissingExtraError
        If the package is not installed; it names the extra.
    """
    try:
        yield
    except ModuleNotFoundError as error:
        package = (error.name or "").partition(".")[0]
        if package not in EXTRAS:
            raise
        raise MissingExtraError(_sentence(what, package)) from None


def missing(what: str, package: str) -> str | None:
    """What to say if a package is not installed; None if it is."""
    return None if importlib.util.find_spec(package) else _sentence(what, package)


def _sentence(what: str, package: str) -> str:
    return f"{what} needs {package}; install it with: pip install 'glucoloop[{EXTRAS[package]}]'"
