"""Configuration of an export: the run for which a controller is designed, and the form of its C."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Final, Literal

from pydantic import BaseModel, Field

from glucoloop.config.run import STRICT, Run, checked, read_run

KEYS: Final = ("precision", "target", "form", "samples")


class ChipKeys(BaseModel):
    """Keys of the writing and checking of C."""

    model_config = STRICT

    precision: Literal["float32", "float64"] = "float32"
    target: Literal["c", "cortex-m4f", "cortex-m7", "rv32"] = "c"
    form: Literal["auto", "unrolled", "compact"] = "auto"
    samples: int = Field(default=120, ge=6, le=1_000_000)
    """Number of samples that are recorded for the self-test."""


@dataclass(frozen=True)
class Export:
    """A controller in its situation, and the form of its C."""

    run: Run
    chip: ChipKeys

    def keys(self) -> dict[str, Any]:
        """The flat keys from which the same export is read."""
        return {**self.run.keys(), **self.chip.model_dump(mode="json")}


def read_export(keys: Mapping[str, object], names: Mapping[str, str] | None = None) -> Export:
    """Read the configuration of an export from flat keys.

    Raises
    ------
    ValueError
        For an unknown key, or a value of the wrong type or out of bounds.
    """
    chip = checked(ChipKeys, {key: value for key, value in keys.items() if key in KEYS}, names)
    return Export(run=read_run({key: value for key, value in keys.items() if key not in KEYS}, names), chip=chip)
