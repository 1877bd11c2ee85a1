"""Help in which the name of each option can be read, however narrow the terminal is."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import typer.core

if TYPE_CHECKING:
    from rich.text import Text


class WholeNames(typer.core.TyperCommand):
    """A command whose help breaks a name that is too long for its column; Typer would cut it off."""

    def format_help(self, ctx: Any, formatter: Any) -> None:
        """Print the help."""
        from typer import rich_utils

        # Typer has no setting for it, but hands all names through these.
        of_names = {name: getattr(rich_utils, name, None) for name in ("highlighter", "negative_highlighter")}
        try:
            for name, highlight in of_names.items():
                if highlight is not None:
                    setattr(rich_utils, name, _breaking(highlight))
            super().format_help(ctx, formatter)
        finally:
            for name, highlight in of_names.items():
                if highlight is not None:
                    setattr(rich_utils, name, highlight)


def _breaking(highlight: Callable[[Any], Text]) -> Callable[[Any], Text]:
    def highlighted(text: Any) -> Text:
        shown = highlight(text)
        shown.overflow = "fold"
        return shown

    return highlighted
