"""Columns of people in a table: whose each row is."""

from __future__ import annotations

import re
from typing import Final

import polars as pl

from glucoloop.records.answers import Answers
from glucoloop.refusal import Refusal

_NAME: Final = re.compile(
    r"(?i)^((pt|pat|patient|subj|subject|usubj|participant|person|people|proband|deident|anon\w*"
    r"|patienten?|paciente?|paziente|patiënt|pacjent|sujeto|sujet|soggetto|participante?|probandin|versuchsperson)"
    r"([ _.-]*(id|no|nr|number|code|key|nummer))?"
    r"|id[ _.-]*(pt|pat|patient|subj|subject|participant|person|proband)"
    r"|((user|case|study|record)[ _.-]*)?id|pid|uid|kennung)s?$"
)
_MOST_ALIKE: Final = 0.05
"""Largest share of times that a table of one person has more than once with other readings."""
_FEW: Final = 10


def person_column(frame: pl.DataFrame, used: set[str], times: pl.Series, answers: Answers) -> str | None:
    """Name of the column that says whose each row is; None for a table of one person.

    It is the one that is named, or one whose name says so and that has several values, each for many rows. Refusal
    where times stand there more than once as in a table of people, and no name of a column says so.
    """
    if answers.person_column is not None:
        by_text = {name.casefold(): name for name in reversed(frame.columns)}
        name = by_text.get(answers.person_column.strip().casefold())
        if name is None:
            raise Refusal(
                f"it has no column {answers.person_column!r}", "give person_column (--person-column) as it stands"
            )
        return name
    free = [name for name in frame.columns if name not in used]
    named = [name for name in free if _NAME.match(name.strip())]
    likely = [name for name in named if _of_people(frame[name])]
    if likely:
        return max(likely, key=lambda name: (_repeats(times, frame[name]) == 0, -frame[name].n_unique()))
    if _repeats(times, None) <= max(_FEW, _MOST_ALIKE * frame.height):
        return None
    telling = [
        name
        for name in free
        if _of_people(frame[name]) and _repeats(times, frame[name]) <= max(_FEW, _MOST_ALIKE * frame.height)
    ]
    if telling:
        raise Refusal(
            "it has the same times more than once, as a table of several people has",
            f"name the column that says whose each row is with person_column (--person-column), as {telling[0]!r}",
            "write each person's record with `glucoloop records --person-column`",
        )
    return None


def _of_people(column: pl.Series) -> bool:
    """Whether a column has several values, each for several rows."""
    cells = column.drop_nulls()
    kinds = cells.n_unique()
    return 1 < kinds and 2 * kinds <= len(cells)


def _repeats(times: pl.Series, column: pl.Series | None) -> int:
    """Number of rows whose time, for the same value of a column, stands in an earlier row too."""
    table = times.to_frame("time") if column is None else pl.DataFrame({"time": times, "who": column})
    table = table.filter(pl.col("time").is_not_null())
    return table.height - table.n_unique()
