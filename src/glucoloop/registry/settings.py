"""What can be set about a part: its name, type, meaning and usual value.

Nothing in this package imports a numerical library, so that help is shown at once.
"""

from __future__ import annotations

import contextlib
import difflib
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Final

from glucoloop.plausible import Quantity

Value = int | float | str

MOST_NAMES_TOLD: Final = 12


@dataclass(frozen=True)
class Default:
    """Value of a setting that was not given; it may depend on whether readings are noisy."""

    noise_free: Value
    noisy: Value | None = None
    """None: as without noise."""

    def value(self, *, noisy: bool) -> Value:
        """The value for a run."""
        return self.noisy if noisy and self.noisy is not None else self.noise_free

    @property
    def text(self) -> str:
        """For help: ``8`` or ``8, with noise 10``."""
        noisy = "" if self.noisy in (None, self.noise_free) else f", with noise {_told(self.noisy)}"
        return f"{_told(self.noise_free)}{noisy}"


Tunings = Mapping[str, Mapping[str, Default]]
"""Controller -> setting -> its usual value for a patient, where that is another than the controller's own."""


def _told(value: Value | None) -> str:
    if isinstance(value, bool):
        return "true" if value else "false"
    return f"{value:g}" if isinstance(value, float) else str(value)


@dataclass(frozen=True)
class Setting:
    """One thing that can be set about a controller.

    The same name may stand in several entries, each with its default, but always with one type.
    """

    name: str
    """As in a configuration file; the option is the same with dashes."""
    type: type[int] | type[float] | type[str] | type[bool]
    summary: str
    """With the paper's symbol, if it has one."""
    default: Default
    choices: tuple[str, ...] = ()
    quantity: Quantity | None = None
    """The range in which people mean it; None: any value that its type allows."""

    def check(self, value: object) -> Value:
        """The value in the setting's type; its bounds are the design's to check.

        Raises
        ------
        ValueError
            For a value of another type, or one that is not among the choices.
        """
        if self.choices and value not in self.choices:
            raise ValueError(f"{self.name} is {value!r}; the known ones are: {', '.join(self.choices)}")
        if isinstance(value, bool):
            if self.type is bool:
                return value
        elif self.type is float and isinstance(value, int | float):
            with contextlib.suppress(OverflowError):  # of a whole number beyond all floats
                return float(value)
        elif isinstance(value, self.type):
            return value
        kinds: dict[type, str] = {int: "a whole number", float: "a number", str: "a text", bool: "true or false"}
        raise ValueError(f"{self.name} is {value!r}; give {kinds[self.type]}")


def known_names(unknown: str, known: Iterable[str]) -> str:
    """What to say after an unknown name: the one that was probably meant, and the others unless they are many."""
    names = list(known)
    if not names:
        return "there are none"
    close = difflib.get_close_matches(unknown, names, n=1)
    if close and len(names) > MOST_NAMES_TOLD:
        return f"did you mean {close[0]!r}?"
    meant = f"did you mean {close[0]!r}? " if close else ""
    return f"{meant}the known ones are: {', '.join(names)}"
