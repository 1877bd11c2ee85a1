"""Programs that run once: XLA compiles them quickly rather than well, which takes a third of the time."""

import mmap
import os
from pathlib import Path

import jaxlib

FLAGS = (
    "--xla_backend_optimization_level=0",
    "--xla_cpu_use_fusion_emitters=false",  # half of the time of a large program
    "--xla_cpu_parallel_codegen_split_count=1",  # the other processor has tests of its own
)
"""Optimising takes longer than what it saves in programs that run once."""


def set_flags(folder):
    """Have XLA compile quickly in this process and in those that it starts, unless XLA_FLAGS names a file.

    The flags are kept in a file of the folder, which XLA reads when it first computes: commands warn of flags in the
    environment.
    """
    given = os.environ.get("XLA_FLAGS", "")
    if not given or given.startswith("-"):
        Path(folder).mkdir(parents=True, exist_ok=True)
        flags = Path(folder) / "xla_flags"
        flags.write_text(" ".join([given, *filter(_known, FLAGS)]))
        os.environ["XLA_FLAGS"] = str(flags)


def _known(flag):
    """Whether this version of XLA has a flag; it would end the process otherwise."""
    name = flag.removeprefix("--").partition("=")[0].encode()
    for library in Path(jaxlib.__file__).parent.glob("libjax_common.*"):
        with library.open("rb") as file, mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as code:
            return code.find(name) >= 0
    return False
