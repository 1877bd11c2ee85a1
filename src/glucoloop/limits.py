"""Largest numbers that several layers share. Nothing is imported here, so that help is shown at once."""

from __future__ import annotations

from typing import Final

LARGEST_COUNTER: Final = 2**32 - 1
"""Largest seed of people, number of a person, or index."""
LARGEST_SEED: Final = 2**32 - 1
"""Largest seed of a sensor."""
MAX_PEOPLE: Final = 1_000_000_000
MAX_DAYS: Final = 366
LONGEST_RUN_MIN: Final = 366 * 1440.0
LARGEST_MEAL_G: Final = 1000.0
LONGEST_AHEAD_MIN: Final = 180.0
"""Longest time before eating at which a meal may be announced."""
