"""The arithmetic that results depend on to the bit: settings of JAX, libraries, processor, and flags of XLA.

Importing glucoloop switches JAX to float64, when JAX is there or as soon as it is imported, and changes nothing else:
neither JAX's other settings nor the environment that child processes inherit. The command line calls `pin`, which
fixes all of `SETTINGS` for its process. `identity` says which arithmetic a process has, so that results of two kinds
of arithmetic are never mixed in one folder.
"""

from __future__ import annotations

import functools
import json
import os
import warnings
from collections.abc import Mapping
from typing import Final

from glucoloop._lazy_jax import jax, once_imported

FLOAT64: Final = "jax_enable_x64"
SETTINGS: Final[Mapping[str, bool | int | str | None]] = {
    FLOAT64: True,
    "jax_default_matmul_precision": None,
    "jax_default_prng_impl": "threefry2x32",
    "jax_disable_jit": False,
    "jax_disable_most_optimizations": False,
    "jax_numpy_dtype_promotion": "standard",
    "jax_random_seed_offset": 0,
    "jax_threefry_partitionable": True,
}
"""Settings of JAX that change results, with the values that glucoloop uses."""
PROCESSOR: Final = "processor"
"""Name of the kind of processor in an identity."""
LIBRARIES: Final = ("jax", "jaxlib", "llvmlite", "numpy", "scipy")
XLA_FLAGS: Final = "XLA_FLAGS"
_VARIABLES: Final = (XLA_FLAGS, "NPY_DISABLE_CPU_FEATURES", "OPENBLAS_CORETYPE")
"""Variables of the environment that change results and are not JAX's."""
_ROUNDING_FLAGS: Final = ("--xla_cpu_", "--xla_allow_")
_YES: Final = ("y", "yes", "t", "true", "on", "1")
_settings: dict[str, bool | int | str | None] = {}
"""Settings that are applied as soon as JAX is imported."""


def use_float64() -> None:
    """Switch JAX to float64, now or as soon as it is imported; warn if ``JAX_ENABLE_X64`` asks for something else."""
    configure_jax({FLOAT64: SETTINGS[FLOAT64]})


def pin() -> list[str]:
    """Fix `SETTINGS` for this process and its children; return sentences about what is ignored or changes results."""
    notes = []
    for name, value in SETTINGS.items():
        variable = name.upper()
        given = os.environ.get(variable)
        if given is not None and not _means(given, value):
            instead = "without it" if value is None else f"with {variable}={_text(value)}"
            notes.append(f"{variable}={given} is not heeded; glucoloop computes {instead}.")
            if value is None:
                del os.environ[variable]
            else:
                os.environ[variable] = _text(value)
    configure_jax(SETTINGS)
    flags = [flag for flag in os.environ.get(XLA_FLAGS, "").split() if flag.startswith(_ROUNDING_FLAGS)]
    if flags:
        notes.append(f"{XLA_FLAGS} has {' '.join(flags)}; results may differ from those without it.")
    return notes


def identity() -> dict[str, str]:
    """Versions, processor, platform, flags and settings; two processes with the same identity give the same bits."""
    import jax

    return {
        **_versions(),
        PROCESSOR: _processor(),
        "platform": jax.default_backend(),
        **{name: " ".join(os.environ.get(name, "").split()) for name in _VARIABLES},
        **{name: _text(value) for name, value in jax.config.values.items() if name in SETTINGS},
    }


def digest(facts: Mapping[str, str]) -> str:
    """A short name of an identity."""
    import hashlib  # slow, and needed for results only

    return hashlib.sha256(json.dumps(dict(facts), sort_keys=True).encode()).hexdigest()[:16]


def difference(earlier: Mapping[str, str], current: Mapping[str, str]) -> tuple[str, str, str] | None:
    """The first thing in which two identities differ, as its name and the two values; None if they are the same."""
    for name in dict.fromkeys([*current, *earlier]):
        before, now = (facts.get(name) or "not given" for facts in (earlier, current))
        if before != now:
            return name, before, now
    return None


@functools.cache
def _versions() -> Mapping[str, str]:
    import importlib.metadata  # slow, and needed for results only

    return {name: importlib.metadata.version(name) for name in LIBRARIES}


@functools.cache
def _processor() -> str:
    """Name of the processor in LLVM, and a digest of the features that code may use."""
    import hashlib

    from llvmlite import binding

    features = binding.get_host_cpu_features().flatten()
    return f"{binding.get_host_cpu_name()} ({hashlib.sha256(features.encode()).hexdigest()[:8]})"


def configure_jax(settings: Mapping[str, bool | int | str | None]) -> None:
    """Give JAX settings, at once or when it is imported."""
    _settings.update(settings)
    once_imported(_apply)


def _apply() -> None:
    given = os.environ.get(FLOAT64.upper())
    if given is not None and not _means(given, SETTINGS[FLOAT64]):
        warnings.warn(
            f"{FLOAT64.upper()}={given} is not heeded: glucoloop designs controllers in float64 and switches JAX to "
            "it; leave the variable out",
            stacklevel=2,
        )
    for name, value in _settings.items():
        if jax.config.values.get(name, value) != value:
            jax.config.update(name, value)  # type: ignore[no-untyped-call]


def _means(given: str, value: bool | int | str | None) -> bool:
    if isinstance(value, bool):
        return (given.strip().lower() in _YES) == value
    return given.strip() == _text(value)


def _text(value: object) -> str:
    if isinstance(value, bool):
        return "1" if value else "0"
    return "" if value is None else str(value)
