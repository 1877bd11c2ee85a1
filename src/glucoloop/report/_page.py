"""Common parts of all pages: their style in light and dark mode, and plots that need no network."""

from __future__ import annotations

import html
from collections.abc import Sequence
from string import Template
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from glucoloop._extras import missing
from glucoloop.report._style import OKABE_ITO

FOOTER: Final = "Research software, not a medical device."
GREY: Final = "#808080"  # seen on white and on black
PALE: Final = "rgba(128, 128, 128, 0.25)"
TRANSPARENT: Final = "rgba(0, 0, 0, 0)"


def page(title: str, main: str, style: str = "") -> str:
    """A self-contained HTML page.

    Parameters
    ----------
    title : str
        Title; characters special to HTML are escaped.
    main : str
        HTML below the title.
    style : str
        CSS in addition to that of all pages.
    """
    return _PAGE.substitute(title=html.escape(title), style=style, main=main, footer=FOOTER)


def picture(
    data: Sequence[dict[str, Any]],
    layout: dict[str, Any],
    *,
    name: str,
    height_px: float,
    buttons: Sequence[str],
    library: bool = True,
) -> str:
    """HTML of a plot whose text follows the reader's theme; without plotly, a sentence in its place.

    Parameters
    ----------
    data, layout
        Data and layout in plotly's form.
    name : str
        Name of the HTML element.
    height_px : float
    buttons : sequence of str
        Names of plotly's buttons; its default set includes one that uploads the data. Empty for no button bar.
    library : bool
        Whether plotly itself is included, as it must be with the first plot of a page.
    """
    lacking = plots_lack()
    if lacking:
        return f'<p class="lacking">{html.escape(lacking, quote=False)}</p>'
    import plotly.io

    drawn: str = plotly.io.to_html(
        {"data": list(data), "layout": layout},
        config={
            "responsive": True,
            "displaylogo": False,
            "displayModeBar": "hover" if buttons else False,
            "modeBarButtons": [list(buttons)],
            "toImageButtonOptions": {"format": "svg", "filename": "glucoloop"},
        },
        include_plotlyjs=library,
        full_html=False,
        default_height=f"{height_px:g}px",
        validate=False,  # an attribute that an older plotly does not know is passed over
        div_id=name,
        post_script=_FOLLOW_THEME,
    )
    return drawn


def plots_lack() -> str | None:
    """Reason why plots of pages cannot be drawn and how to mend it; None if they can."""
    return missing("A plot to zoom into", "plotly")


def plain_layout(**layout: Any) -> dict[str, Any]:
    """Plotly layout with the page's font and background."""
    return {
        "autosize": True,
        "paper_bgcolor": TRANSPARENT,
        "plot_bgcolor": TRANSPARENT,
        "font": {"family": "system-ui, sans-serif", "size": 13, "color": GREY},
        "modebar": {"orientation": "v", "bgcolor": TRANSPARENT, "color": GREY, "activecolor": OKABE_ITO[0]},
    } | layout


def numbers(values: npt.ArrayLike, digits: int = 3) -> list[float | None]:
    """Rounded numbers for JSON, with None for NaN."""
    return [round(value, digits) if np.isfinite(value) else None for value in np.asarray(values, float).tolist()]


def tinted(colour: str, opacity: float) -> str:
    """A colour of six hexadecimal digits, made transparent."""
    red, green, blue = (int(colour[place : place + 2], 16) for place in (1, 3, 5))
    return f"rgba({red}, {green}, {blue}, {opacity:g})"


# Plotly draws in fixed colours; these follow the page's, which follow the reader's.
_FOLLOW_THEME: Final = """
const dark = window.matchMedia("(prefers-color-scheme: dark)");
const follow = () => {
  const style = getComputedStyle(document.body);
  Plotly.relayout("{plot_id}", {
    "font.color": style.color,
    "hoverlabel.bgcolor": style.backgroundColor,
    "hoverlabel.font.color": style.color
  });
};
follow();
dark.addEventListener("change", follow);
"""

_PAGE: Final = Template("""<!doctype html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<title>$title</title>
<style>
:root { color-scheme: light dark; --ink: #222; --paper: #fff; --rule: rgba(128, 128, 128, 0.35); }
@media (prefers-color-scheme: dark) { :root { --ink: #ddd; --paper: #181818; } }
body { margin: 0 auto; padding: 1rem; max-width: 70rem; color: var(--ink); background: var(--paper);
       font: 1rem/1.45 system-ui, sans-serif; }
h1 { font-size: 1.4rem; font-weight: 600; margin: 0.5rem 0 1rem; overflow-wrap: anywhere; }
.scroll { overflow-x: auto; margin-top: 1.5rem; }
table { border-collapse: collapse; font-size: 0.9rem; font-variant-numeric: tabular-nums; }
th, td { padding: 0.2rem 0.9rem 0.2rem 0; text-align: left; font-weight: normal; vertical-align: bottom; }
thead th, th[scope=rowgroup] { font-weight: 600; }
thead th { border-bottom: 1px solid var(--rule); }
th[scope=rowgroup] { padding-top: 0.9rem; }
th[scope=row] { padding-left: 0.9rem; white-space: pre; }
.value { text-align: right; }
td.value { white-space: nowrap; }
footer { margin: 2rem 0 1rem; padding-top: 0.6rem; border-top: 1px solid var(--rule); font-size: 0.85rem; }
$style</style>
</head>
<body>
<h1>$title</h1>
<main>
$main
</main>
<footer>$footer</footer>
</body>
</html>
""")
