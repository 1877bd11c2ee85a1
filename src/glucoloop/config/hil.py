"""Configuration of hardware in the loop: the run, the chip, and the disturbances of its link and power."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from glucoloop.config.checked import checked
from glucoloop.config.key import declared, own_keys, plain
from glucoloop.config.options.hil import DisturbanceKeys, HilKeys
from glucoloop.config.run import Run, read_run
from glucoloop.firmware.hil.build import EMULATED
from glucoloop.firmware.hil.faults import Disturbances
from glucoloop.refusal import Refusal


@dataclass(frozen=True)
class Hil:
    """A run, and the chip on which its controller runs."""

    run: Run
    chip: HilKeys
    given_of_chip: Mapping[str, Any] = field(default_factory=dict, compare=False)
    """Flat keys of the chip that were given."""

    @property
    def samples(self) -> int:
        """Number of samples."""
        return round(self.run.situation.duration_min / self.run.situation.sample_time_min)

    @property
    def emulated(self) -> bool:
        """Whether the chip needs no hardware."""
        return self.chip.chip in EMULATED

    @property
    def given(self) -> dict[str, Any] | None:
        """Flat keys from which it was read, if it was."""
        return None if self.run.given is None else {**self.run.given, **self.given_of_chip}

    @property
    def disturbances(self) -> Disturbances:
        """Numbers of disturbances."""
        return Disturbances(**own_keys(plain(self.chip), DisturbanceKeys))

    def keys(self) -> dict[str, Any]:
        """The flat keys from which the same run is read."""
        return {**self.run.keys(), **plain(self.chip)}

    def with_run(self, run: Run) -> Hil:
        """The same chip with another run."""
        return dataclasses.replace(self, run=run)


def read_hil(keys: Mapping[str, object], names: Mapping[str, str] | None = None) -> Hil:
    """Read the configuration of hardware in the loop from flat keys.

    Raises
    ------
    ValueError
        For an unknown key, a value of the wrong type or out of bounds, or disturbances that are not possible.
    """
    chip = checked(HilKeys, own_keys(keys, HilKeys), names)
    run = read_run({key: value for key, value in keys.items() if key not in declared(HilKeys)}, names)
    asked = Hil(run=run, chip=chip, given_of_chip=own_keys(keys, HilKeys))
    if not asked.emulated and "/" not in chip.chip:
        raise Refusal(
            f"the chip is {chip.chip!r}; the known ones are: {', '.join(EMULATED)}, or the path of a serial port such "
            "as /dev/ttyACM0"
        )
    if not asked.emulated and asked.disturbances.of_power:
        raise Refusal(
            f"the power of the board at {chip.chip} cannot be cut from here, nor its program made to hang; "
            "let --power-cuts and --hangs be 0, or take an emulated chip"
        )
    asked.disturbances.check(asked.samples)
    return asked
