"""JAX as the command line uses it: what it compiled once is kept for the next command."""

from __future__ import annotations

import importlib
import os
import tempfile
import warnings
from pathlib import Path
from typing import Final

VARIABLE: Final = "GLUCOLOOP_CACHE_DIR"
OFF: Final = "off"


def keep_compiled() -> None:
    """Switch JAX's persistent cache on, and silently leave it off where its folder cannot be written to."""
    config = importlib.import_module("jax").config  # untyped: JAX's own stubs leave `update` so
    # A bug keeps its whole traceback; `mistakes` tells bugs apart by where an error was raised.
    config.update("jax_traceback_filtering", "off")
    folder = cache_folder()
    if folder is None or not _writable(folder):
        return
    config.update("jax_compilation_cache_dir", str(folder))
    config.update("jax_persistent_cache_min_compile_time_secs", 0)
    config.update("jax_persistent_cache_min_entry_size_bytes", -1)
    warnings.filterwarnings("ignore", message=".*persistent compilation cache.*")


def cache_folder() -> Path | None:
    """Where compiled code is kept; None where the environment says that it is not."""
    import platformdirs

    told = os.environ.get(VARIABLE, "").strip()
    if told.lower() == OFF:
        return None
    return Path(told) if told else Path(platformdirs.user_cache_dir("glucoloop", appauthor=False)) / "compiled"


def _writable(folder: Path) -> bool:
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder):
            return True
    except OSError:
        return False
