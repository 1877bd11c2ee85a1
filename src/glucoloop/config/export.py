"""Configuration of an export: the run for which a controller is designed, and the form of its C."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from glucoloop.config.checked import checked
from glucoloop.config.key import declared, own_keys, plain
from glucoloop.config.options.export import ChipKeys
from glucoloop.config.run import Run, read_run


@dataclass(frozen=True)
class Export:
    """A controller in its situation, and the form of its C."""

    run: Run
    chip: ChipKeys
    given: Mapping[str, Any] | None = field(default=None, compare=False)
    """Flat keys from which it was read, if it was."""

    def keys(self) -> dict[str, Any]:
        """The flat keys from which the same export is read."""
        return {**self.run.keys(), **plain(self.chip)}


def read_export(keys: Mapping[str, object], names: Mapping[str, str] | None = None) -> Export:
    """Read the configuration of an export from flat keys.

    Raises
    ------
    ValueError
        For an unknown key, or a value of the wrong type or out of bounds.
    """
    chip = checked(ChipKeys, own_keys(keys, ChipKeys), names)
    run = {key: value for key, value in keys.items() if key not in declared(ChipKeys)}
    found = read_run(run, names, only_design=True)
    return Export(run=found, chip=chip, given=dict(keys))
