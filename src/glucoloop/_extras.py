"""Optional packages, and the extra that installs each."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Final

from glucoloop.refusal import Refusal

EXTRAS: Final = {
    "cmaes": "search",
    "dask": "dask",
    "distributed": "dask",
    "duckdb": "query",
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
