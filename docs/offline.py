"""Sphinx extension: warn of a page that would load anything from a network, so that all pages show without one."""

import re
from collections.abc import Iterator
from pathlib import Path

from sphinx.application import Sphinx
from sphinx.util import logging

logger = logging.getLogger(__name__)

# What a browser loads by itself; a link that a reader follows is none of it.
LOADED = re.compile(
    r"""<(?:script|img|iframe|source|video|audio|embed)\b[^>]*?\ssrc\s*=\s*["']?((?:https?:)?//[^"'\s>]+)"""
    r"""|<link\b(?=[^>]*\brel\s*=\s*["']?(?:stylesheet|icon|preload|preconnect|modulepreload))[^>]*?\shref\s*=\s*["']?"""
    r"""((?:https?:)?//[^"'\s>]+)"""
    r"""|url\(\s*["']?((?:https?:)?//[^"')\s]+)|@import\s+["']((?:https?:)?//[^"']+)""",
    re.IGNORECASE,
)


def loaded(text: str) -> list[str]:
    """Addresses on other machines that a page or a style sheet loads."""
    return [next(filter(None, match.groups())) for match in LOADED.finditer(text)]


def loads(folder: Path) -> Iterator[tuple[Path, str]]:
    """Every such address in a folder, with the file that loads it."""
    for path in sorted(folder.rglob("*")):
        if path.suffix in (".html", ".css"):
            for address in loaded(path.read_text(encoding="utf-8")):
                yield path, address


def check(app: Sphinx, error: Exception | None) -> None:
    if error is None and app.builder.format == "html":
        for path, address in loads(Path(app.outdir)):
            logger.warning("%s loads %s; put it into docs/_static", path.relative_to(app.outdir), address)


def setup(app: Sphinx) -> dict[str, bool]:
    app.connect("build-finished", check)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
