"""Sphinx extension: warn of a page that is too long to load quickly; scripts and styles, which pages share, aside."""

from collections.abc import Iterator
from pathlib import Path

from sphinx.application import Sphinx
from sphinx.util import logging

logger = logging.getLogger(__name__)
MAX_BYTES = 300_000


def too_long(folder: Path) -> Iterator[tuple[Path, int]]:
    """Pages over the bound with their sizes; what a page offers to download is no page."""
    for path in sorted(folder.rglob("*.html")):
        size = path.stat().st_size
        if size > MAX_BYTES and "_downloads" not in path.relative_to(folder).parts:
            yield path, size


def check(app: Sphinx, error: Exception | None) -> None:
    if error is None and app.builder.format == "html":
        for path, size in too_long(Path(app.outdir)):
            logger.warning("%s has %d bytes, of at most %d", path.relative_to(app.outdir), size, MAX_BYTES)


def setup(app: Sphinx) -> dict[str, bool]:
    app.connect("build-finished", check)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
