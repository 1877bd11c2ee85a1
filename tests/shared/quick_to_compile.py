"""Programs that run once: XLA compiles them quickly rather than well, which takes a third of the time."""

import mmap
import os
import threading
from pathlib import Path

import jax
import jaxlib
from jax._src.interpreters import mlir
from jax._src.lib.mlir import ir

from glucoloop.private_folder import refuse_of_others

FLAGS = (
    "--xla_backend_optimization_level=0",
    "--xla_cpu_use_fusion_emitters=false",  # half of the time of a large program
    "--xla_cpu_parallel_codegen_split_count=1",  # the other processor has tests of its own
)
"""Optimising takes longer than what it saves in programs that run once."""
PROGRAMS_OF_A_CONTEXT = 100
CACHE = "GLUCOLOOP_TESTS_COMPILED"
"""Variable that names where what JAX compiled is kept for the workers of one run, most of whose time is compiling;
runs, and the documentation, may share it.
"""


def set_flags(folder):
    """Have XLA compile quickly in this process and in those that it starts, unless XLA_FLAGS names a file.

    Those have one thread for linear algebra and for tables, as the other processors have tests of their own: small
    matrices take a hundredfold of processor time where threads wait for each other.

    The flags are kept in a file of the folder, which XLA reads when it first computes: commands warn of flags in the
    environment.
    """
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    os.environ.setdefault("POLARS_MAX_THREADS", "1")
    given = os.environ.get("XLA_FLAGS", "")
    if not given or given.startswith("-"):
        Path(folder).mkdir(parents=True, exist_ok=True)
        flags = Path(folder) / "xla_flags"
        text = " ".join([given, *filter(_known, FLAGS)])
        if not flags.exists() or flags.read_text() != text:  # another process may be reading it
            flags.write_text(text)
        os.environ["XLA_FLAGS"] = str(flags)


def keep_compiled(folder):
    """Have this process and those that it starts keep what JAX compiles in a folder, where others find and run it."""
    refuse_of_others(Path(folder))
    cache = {
        "jax_compilation_cache_dir": str(folder),
        "jax_persistent_cache_min_compile_time_secs": 0.0,
        "jax_persistent_cache_min_entry_size_bytes": -1,
    }
    for name, value in cache.items():
        jax.config.update(name, value)
        os.environ[name.upper()] = str(value)


def share_contexts():
    """Have JAX write many programs in one MLIR context.

    Making a context takes 3 ms, more than the rest of lowering a small program, and 1 MB for as long as JAX keeps the
    program. A context keeps all constants that were written in it, so a new one is made now and then. A program that is
    compiled while another one is written has a context of its own: in the same one it would be written into the other.
    """
    make, last = getattr(mlir, "make_ir_context", None), threading.local()
    if make is None:
        return  # another JAX, which has its own way

    def make_ir_context():
        if ir.Context.current is not None:
            return make()
        programs = getattr(last, "programs", 0)
        if programs % PROGRAMS_OF_A_CONTEXT == 0:
            last.context = make()
        last.programs = programs + 1
        return last.context

    mlir.make_ir_context = make_ir_context


def _known(flag):
    """Whether this version of XLA has a flag; it would end the process otherwise."""
    name = flag.removeprefix("--").partition("=")[0].encode()
    for library in Path(jaxlib.__file__).parent.glob("libjax_common.*"):
        with library.open("rb") as file, mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as code:
            return code.find(name) >= 0
    return False
