"""JAX's own cache for the command line, in the folder of `glucoloop._disk_cache`.

It keeps what has no name to be kept by: operations outside of compiled functions, the loops of trials, which are
closures over their settings, and code of the user. JAX finds these by their text, once they are traced and lowered.
"""

from __future__ import annotations

import atexit
import functools
import warnings
from pathlib import Path

from glucoloop.arithmetic import configure_jax
from glucoloop.cli.screen import note
from glucoloop.refusal import Refusal


def keep_compiled() -> None:
    """Switch JAX's persistent cache on, unless the environment says ``off`` for the folder.

    It silently stays off where its folder cannot be written to, and with a note where another user can write to it.
    """
    from glucoloop._disk_cache import cache_folder

    configure_jax({"jax_traceback_filtering": "off"})  # a bug keeps its whole traceback
    folder = cache_folder()
    if folder is None or not _usable(folder):
        return
    configure_jax(
        {
            "jax_compilation_cache_dir": str(folder),
            "jax_persistent_cache_min_compile_time_secs": 0,
            "jax_persistent_cache_min_entry_size_bytes": -1,
        }
    )
    warnings.filterwarnings("ignore", message=".*persistent compilation cache.*")


@functools.cache
def _usable(folder: Path) -> bool:
    """Whether a folder of programs can be used; its contents are checked once per process."""
    from glucoloop._disk_cache import private_folder
    from glucoloop.storage.programs import check_programs, seal_programs

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
