"""Tables of a study as LaTeX, for a paper: what the terminal shows, with a unit in every heading that has one.

A table of the terminal is a table of rich, from `reporting.columns`; this module reads its headings, alignment,
sections, bold numbers and caption, so that any study has its LaTeX from what it has already. Rules are those of
``booktabs``.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Sequence
from typing import TYPE_CHECKING, Any, Final

import glucoloop
from glucoloop.reporting.columns import FittingTable

if TYPE_CHECKING:
    from rich.table import Table

_MATHS: Final = {
    **{"<": "<", ">": ">", "≤": r"\le", "≥": r"\ge", "±": r"\pm", "×": r"\times", "·": r"\cdot", "∞": r"\infty"},
    **{"→": r"\rightarrow", "−": "-", "²": "^2", "³": "^3", "▲": r"\blacktriangle", "√": r"\surd", "∆": r"\Delta"},
    **{"α": r"\alpha", "β": r"\beta", "γ": r"\gamma", "δ": r"\delta", "κ": r"\kappa", "λ": r"\lambda", "π": r"\pi"},
    **{"µ": r"\mu", "μ": r"\mu", "ρ": r"\rho", "σ": r"\sigma", "τ": r"\tau", "φ": r"\varphi", "ω": r"\omega"},
    **{"Γ": r"\Gamma", "Δ": r"\Delta", "Σ": r"\Sigma", "Φ": r"\Phi"},
}
_TEXTS: Final = {
    **{letter: f"\\{letter}" for letter in "&%$#_{}"},
    **{"\\": r"\textbackslash{}", "~": r"\textasciitilde{}", "^": r"\textasciicircum{}", "|": r"\textbar{}"},
    **{"°": r"\textdegree{}", "–": "--", "—": "---", "…": r"\ldots{}", '"': "''", "\N{NO-BREAK SPACE}": "~"},
}
_ESCAPES: Final = str.maketrans({**_TEXTS, **{letter: f"${maths}$" for letter, maths in _MATHS.items()}})
_NEGATIVE: Final = re.compile(r"(?<![\w)])-(?=\d)")
_RANGE: Final = re.compile(r"(?<![\w-])(\d+)-(\d+)(?![\w-])")
_ALIGNED: Final = re.compile(r"(?<=\|) +")
"""Spaces by which the terminal puts the second numbers of pairs below each other."""
_HEAD: Final = (
    "% By `{command}`, glucoloop {version}.\n"
    "% \\input this file; the preamble needs \\usepackage{{booktabs}}{packages}. A table that is too wide fits with\n"
    "% \\small before it, or without the columns that the text does not speak of.\n"
)


def _latex_text(text: str) -> str:
    """A text as LaTeX prints it, in one line; the sign of a negative number is a minus, and a range has a dash."""
    line = _ALIGNED.sub("", " ".join(text.split()))
    return _RANGE.sub(r"\1–\2", _NEGATIVE.sub("−", line)).translate(_ESCAPES)


def latex_tables(tables: Iterable[object], name: str, command: str) -> str:
    """Tables for the terminal as a file of LaTeX, each a float whose label is ``tab:NAME-NUMBER``.

    Parameters
    ----------
    tables : iterable of FittingTable or rich.table.Table
    name : str
        Name in the labels.
    command : str
        Command that made them, for the captions and the head of the file.

    Raises
    ------
    TypeError
        If one of them is no table.
    """
    floats = "\n".join(_float(table, f"tab:{name}-{number}", command) for number, table in enumerate(tables, start=1))
    packages = " and \\usepackage{amssymb}" if r"\blacktriangle" in floats else ""
    return _HEAD.format(command=command, version=glucoloop.__version__, packages=packages) + "\n" + floats


def _float(fitting: object, label: str, command: str) -> str:
    from rich.table import Table

    table = fitting.table if isinstance(fitting, FittingTable) else fitting
    if not isinstance(table, Table):
        raise TypeError(f"{type(fitting).__name__} is no table")
    heads = (
        fitting.heads
        if isinstance(fitting, FittingTable) and fitting.heads
        else [_plain(c.header) for c in table.columns]
    )
    caption = f"By \\texttt{{{_latex_text(command)}}}. {_latex_text(_plain(table.caption or ''))}".rstrip()
    align = "".join("r" if column.justify == "right" else "l" for column in table.columns)
    rows = [
        *("\\begin{table}", "  \\centering", f"  \\caption{{{caption}}}", f"  \\label{{{label}}}"),
        *(f"  \\begin{{tabular}}{{@{{}}{align}@{{}}}}", "    \\toprule"),
        f"    {' & '.join(map(_head, heads, align))} \\\\",
        *("    \\midrule", *(f"    {line}" for line in _lines(table)), "    \\bottomrule"),
        *("  \\end{tabular}", "\\end{table}"),
    ]
    return "\n".join(rows) + "\n"


def _head(text: str, align: str) -> str:
    """A heading; the lines of a long one stand below each other."""
    lines = [_latex_text(line) for line in text.strip("\n").split("\n")]
    if len(lines) == 1:
        return lines[0]
    below = r"\\".join(lines)
    return f"\\begin{{tabular}}[b]{{@{{}}{align}@{{}}}}{below}\\end{{tabular}}"


def _lines(table: Table) -> Iterator[str]:
    """Rows, with a space where a section ends; the name of a section spans all columns."""
    columns = [list(column.cells) for column in table.columns]
    for number, row in enumerate(table.rows):
        cells = [column[number] for column in columns]
        texts = [_plain(cell) for cell in cells]
        if _is_bold(cells[0]) and not any(texts[1:]):
            yield f"\\multicolumn{{{len(cells)}}}{{@{{}}l@{{}}}}{{\\textbf{{{_latex_text(texts[0])}}}}} \\\\"
        else:
            yield f"{' & '.join(_cells(cells, texts))} \\\\"
        if row.end_section and number < len(table.rows) - 1:
            yield "\\addlinespace"


def _cells(cells: Sequence[Any], texts: Sequence[str]) -> Iterator[str]:
    for number, (cell, text) in enumerate(zip(cells, texts, strict=True)):
        escaped = _latex_text(text)
        indent = "\\quad " if number == 0 and text.startswith(" ") else ""
        yield indent + (f"\\textbf{{{escaped}}}" if escaped and _is_bold(cell) else escaped)


def _is_bold(cell: Any) -> bool:
    return getattr(cell, "style", "") == "bold"


def _plain(cell: Any) -> str:
    """Text of a heading or a cell, which may be markup of rich."""
    from rich.text import Text

    return cell.plain if isinstance(cell, Text) else Text.from_markup(str(cell)).plain
