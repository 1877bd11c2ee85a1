"""When, and with which version, the figures of a page were made: the last words of each table."""

from datetime import date, datetime
from pathlib import Path

import glucoloop


def made(*results, version=glucoloop.__version__):
    """Words on the newest of some files with results; without one, on what was computed just now."""
    on = max((datetime.fromtimestamp(Path(path).stat().st_mtime).date() for path in results), default=date.today())
    return f"made on {on.isoformat()} with glucoloop {version}"
