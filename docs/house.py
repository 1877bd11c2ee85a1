"""The house in one drawing: the layers of the package, made from its imports, as an SVG.

    python docs/house.py house.svg

Modules are read, never imported; an import for types alone counts too. A layer stands above all that it imports.
"""

import ast
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from xml.sax.saxutils import escape

PACKAGE = "glucoloop"
WIDTH = 380
STEP = 44
BOX = (86, 25)
MAX_IN_A_ROW = 4
"""Four boxes beside each other can be read on a telephone."""
STYLE = (
    "path{fill:none;stroke:#0072b2;opacity:.4}rect{fill:#f4f4f4;stroke:#888}"
    "text{font:12px sans-serif;text-anchor:middle}"
)
"""For an SVG that stands alone; on a page the style sheet has it."""


def layer_files(root: Path) -> dict[str, list[Path]]:
    """Files of each layer: a package, or a module, of the root package."""
    result: dict[str, list[Path]] = {}
    for path in sorted(root.iterdir()):
        if path.name.startswith("_"):
            continue
        if path.suffix == ".py":
            result[path.stem] = [path]
        elif (path / "__init__.py").exists():
            result[path.name] = sorted([*path.rglob("*.py"), *path.rglob("*.pyi")])
    return result


def imported(path: Path, root: Path) -> Iterator[str]:
    """Layers that a file imports, at its head or anywhere in it."""
    here = [PACKAGE, *path.relative_to(root).parent.parts]
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            names = [alias.name.split(".") for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            base = here[: len(here) - node.level + 1] if node.level else []
            base += node.module.split(".") if node.module else []
            names = [[*base, alias.name] for alias in node.names]
        else:
            continue
        yield from (name[1] for name in names if name[0] == PACKAGE and len(name) > 1)


def imports(root: Path) -> dict[str, set[str]]:
    """The layers that each layer imports."""
    files = layer_files(root)
    return {
        layer: {name for path in paths for name in imported(path, root)} & set(files) - {layer}
        for layer, paths in files.items()
    }


def floors(of: dict[str, set[str]]) -> list[list[str]]:
    """Layers by floor, the lowest first: each stands above all that it imports."""
    floor: dict[str, int] = {}
    while len(floor) < len(of):
        ready = [layer for layer in of if layer not in floor and of[layer] <= set(floor)]
        if not ready:
            raise ValueError(f"layers that import each other in a ring: {', '.join(sorted(set(of) - set(floor)))}")
        floor |= {layer: 1 + max((floor[name] for name in of[layer]), default=-1) for layer in ready}
    return [sorted(layer for layer in of if floor[layer] == n) for n in range(1 + max(floor.values()))]


def direct(of: dict[str, set[str]]) -> list[tuple[str, str]]:
    """Imports that do not follow from others: what is reached through another layer is left out."""
    below: dict[str, set[str]] = {}
    for layer in [name for floor in floors(of) for name in floor]:
        below[layer] = of[layer].union(*(below[name] for name in of[layer]))
    return [
        (layer, name)
        for layer in of
        for name in sorted(of[layer])
        if not any(name in below[other] for other in of[layer] - {name})
    ]


def placed(of: dict[str, set[str]]) -> tuple[dict[str, tuple[float, float]], float]:
    """Middle of the box of each layer, with the highest floor at the top, and the height of the drawing."""
    rows = []
    for floor in reversed(floors(of)):
        wide = -(-len(floor) // -(-len(floor) // MAX_IN_A_ROW))
        rows += [floor[start : start + wide] for start in range(0, len(floor), wide)]
    middles = {
        name: (WIDTH * (column + 0.5) / len(row), STEP * (number + 0.5))
        for number, row in enumerate(rows)
        for column, name in enumerate(row)
    }
    return middles, STEP * len(rows)


def drawing(of: dict[str, set[str]], told: Callable[[str], str] = str) -> str:
    """The house as an SVG to stand within a page; `told` says in words what a layer is."""
    at, height = placed(of)
    parts = [
        f'<svg class="house" xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {WIDTH} {height}" role="img"'
        f' aria-label="Layers of {PACKAGE}, each above those that it imports">'
    ]
    for upper, lower in direct(of):
        (x, y), (u, v) = at[upper], at[lower]
        bend = (v - y) / 2
        parts.append(f'<path d="M{x:.1f} {y} C{x:.1f} {y + bend:.1f} {u:.1f} {v - bend:.1f} {u:.1f} {v}"/>')
    for name, (x, y) in at.items():
        used = sorted(layer for layer in of if name in of[layer])
        title = [
            told(name),
            f"Imports: {', '.join(sorted(of[name])) or 'none'}.",
            f"Imported by: {', '.join(used) or 'none'}.",
        ]
        parts.append(
            f"<g><title>{escape(chr(10).join(title))}</title>"
            f'<rect x="{x - BOX[0] / 2:.1f}" y="{y - BOX[1] / 2}" width="{BOX[0]}" height="{BOX[1]}" rx="4"/>'
            f'<text x="{x:.1f}" y="{y + 4}">{escape(name)}</text></g>'
        )
    return "\n".join([*parts, "</svg>"]) + "\n"


if __name__ == "__main__":
    svg = drawing(imports(Path(__file__).resolve().parent.parent / "src" / PACKAGE))
    Path(sys.argv[1]).write_text(svg.replace(">", f"><style>{STYLE}</style>", 1), encoding="utf-8")
