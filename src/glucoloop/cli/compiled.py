"""Persistent cache of compiled programs for the command line."""

from __future__ import annotations

import atexit
import functools
import importlib
import os
import warnings
from pathlib import Path
from typing import Final

from glucoloop.cli.screen import note
from glucoloop.refusal import Refusal

VARIABLE: Final = "GLUCOLOOP_CACHE_DIR"
OFF: Final = "off"


def keep_compiled() -> None:
    """Switch JAX's persistent cache on.

    It silently stays off where its folder cannot be written to, and with a note where another user can write to it.
    """
    config = importlib.import_module("jax").config  # untyped: JAX's own stubs leave `update` so
    # A bug keeps its whole traceback.
    config.update("jax_traceback_filtering", "off")
    folder = cache_folder()
    if folder is None or not _usable(folder):
        return
    config.update("jax_compilation_cache_dir", str(folder))
    config.update("jax_persistent_cache_min_compile_time_secs", 0)
    config.update("jax_persistent_cache_min_entry_size_bytes", -1)
    warnings.filterwarnings("ignore", message=".*persistent compilation cache.*")


def cache_folder() -> Path | None:
    """Folder of compiled programs; None where the environment switches it off."""
    import platformdirs

    value = os.environ.get(VARIABLE, "").strip()
    if value.lower() == OFF:
        return None
    return Path(value) if value else Path(platformdirs.user_cache_dir("glucoloop", appauthor=False)) / "compiled"


@functools.cache
def _usable(folder: Path) -> bool:
    """Whether a folder of programs can be used; its contents are checked once per process."""
    from glucoloop.storage.programs import check_programs, private_folder, seal_programs

    try:
        private_folder(folder)
        check_programs(folder)
    except OSError:
        return False
    except Refusal as error:
        note([f"Compiled programs are not kept: {error}."])
        return False
    atexit.register(seal_programs, folder)
    return True
