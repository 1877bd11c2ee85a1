"""A command whose help shows each name whole, and that takes no option twice."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import typer.core

from glucoloop.refusal import Refusal

if TYPE_CHECKING:
    from rich.text import Text


class WholeNames(typer.core.TyperCommand):
    """A command whose help breaks a name that is too long for its column; Typer would cut it off.

    An option that has one value is refused a second time; Typer would take the last.
    """

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """Parse the arguments."""
        typed = list(args)
        rest = super().parse_args(ctx, args)
        _, _, order = self.make_parser(ctx).parse_args(typed)
        for parameter in order:
            if not getattr(parameter, "multiple", True) and order.count(parameter) > 1:
                names = " or ".join([*parameter.opts, *parameter.secondary_opts])
                raise Refusal(f"{names} is given {order.count(parameter)} times, but has one value; give it once")
        return rest

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
