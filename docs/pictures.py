"""Run every script of ``docs/gallery``, and keep its figure and what it prints.

    python docs/pictures.py

``conf.py`` calls it before each build. A script begins with a title and a sentence or two as its docstring, and leaves
a ``figure``. Each becomes ``_pictures/NAME.png``, ``NAME-figure.md``, and ``NAME-code.md`` with what it prints; the
gallery and the tutorial include them. What has been made stays until the script or the package changes.
"""

import ast
import contextlib
import hashlib
import io
import runpy
from dataclasses import dataclass
from pathlib import Path

# In the order of the gallery. The tutorial shows all up to own_controller, and the pages in docs/for the others.
SCRIPTS = (
    "first_run",
    "one_change",
    "identification",
    "three_controllers",
    "noise",
    "population",
    "own_controller",
    "guard",
    "slow_and_quick",
    "feedback_is_late",
    "fortnight",
    "why_this_dose",
)
_DPI = 150


@dataclass(frozen=True)
class Script:
    path: Path
    title: str
    text: str
    code: str

    @classmethod
    def read(cls, path: Path) -> "Script":
        source = path.read_text(encoding="utf-8")
        tree = ast.parse(source)
        told = ast.get_docstring(tree) or ""
        title, _, text = told.partition("\n\n")
        if not title or not text:
            raise ValueError(f"{path.name} begins without a title and a description in its docstring")
        code = "\n".join(source.splitlines()[tree.body[0].end_lineno :]).strip()
        return cls(path=path, title=title, text=" ".join(text.split()), code=code)

    def key(self, package: str) -> str:
        """What the picture and its parts depend on."""
        texts = (path.read_text(encoding="utf-8") for path in (self.path, Path(__file__)))
        return hashlib.sha256("".join((package, *texts)).encode()).hexdigest()

    @property
    def name(self) -> str:
        return self.path.stem

    def parts(self, printed: str) -> dict[str, str]:
        """What pages include, by file name: the code with what it prints, and the figure."""
        figure = f"```{{figure}} /_pictures/{self.name}.png\n:alt: {self.title}\n:width: 100%\n\n{self.text}\n```\n"
        code = f"```python\n{self.code}\n```\n\nIt prints:\n\n```text\n{printed.strip()}\n```\n"
        return {f"{self.name}-code.md": code, f"{self.name}-figure.md": figure}


def package_digest() -> str:
    import glucoloop

    digest = hashlib.sha256()
    for path in sorted(Path(glucoloop.__file__).parent.rglob("*.py")):
        digest.update(path.read_bytes())
    return digest.hexdigest()


def run(script: Script, folder: Path) -> None:
    """Run a script, and write its figure and its part."""
    printed = io.StringIO()
    with contextlib.redirect_stdout(printed):
        figure = runpy.run_path(str(script.path)).get("figure")
    if figure is None:
        raise ValueError(f"{script.path.name} leaves no figure")
    figure.savefig(folder / f"{script.name}.png", dpi=_DPI)
    for name, text in script.parts(printed.getvalue()).items():
        (folder / name).write_text(text, encoding="utf-8")


def gallery(scripts: list[Script]) -> str:
    """Each figure with its code beneath."""
    lines = []
    for script in scripts:
        lines.append(f"## {script.title}\n")
        lines += [f"```{{include}} _pictures/{script.name}-{part}.md\n```\n" for part in ("figure", "code")]
    return "\n".join(lines)


def make_all(docs: Path) -> None:
    """Make the pictures that are missing or no longer true."""
    import matplotlib

    matplotlib.use("agg")
    folder = docs / "_pictures"
    folder.mkdir(exist_ok=True)
    scripts = [Script.read(docs / "gallery" / f"{name}.py") for name in SCRIPTS]
    left_out = {path.stem for path in (docs / "gallery").glob("*.py")} - set(SCRIPTS)
    if left_out:
        raise ValueError(f"scripts of docs/gallery without a place in docs/pictures.py: {', '.join(sorted(left_out))}")
    package = package_digest()
    for script in scripts:
        stamp = folder / f"{script.name}.key"
        if not stamp.exists() or stamp.read_text(encoding="utf-8") != script.key(package):
            stamp.unlink(missing_ok=True)
            run(script, folder)
            stamp.write_text(script.key(package), encoding="utf-8")
    text = gallery(scripts)
    page = folder / "gallery.md"
    if not page.exists() or page.read_text(encoding="utf-8") != text:
        page.write_text(text, encoding="utf-8")


if __name__ == "__main__":
    make_all(Path(__file__).resolve().parent)
