"""A rhythm of your own: people who are less sensitive to insulin at night, each from a time of their own.

Try it with ``glucoloop run --patient hovorka-2004 --rhythm 'your_own_rhythm:Night, factor=0.6' --duration 24h``.
"""

from typing import Annotated

import numpy as np

from glucoloop.plugin import About, Changes, RhythmComponent


class Night(RhythmComponent, name="night"):
    """Sensitivity to insulin that is lower for eight hours of each night."""

    factor: Annotated[float, About("Factor on sensitivity at night.", above=0.0, at_most=1.0)] = 0.7
    from_min: Annotated[float, About("Earliest time of day at which it falls.", at_least=0.0, below=1440.0)] = 1260.0

    def changes(self, clock_min, seed, person):
        """Factor on sensitivity ``(n, people)`` at minutes ``(n,)``; a person's numbers follow from seed and number."""
        later_min = np.array([np.random.default_rng([seed, number]).uniform(0.0, 120.0) for number in person])
        since_min = (clock_min[:, None] - self.from_min - later_min) % 1440.0
        return Changes(sensitivity=np.where(since_min < 480.0, self.factor, 1.0))


if __name__ == "__main__":
    day = Night(0.6).changes(np.arange(1440.0), seed=1, person=np.arange(3)).sensitivity
    print("minutes of less sensitivity:", ", ".join(f"{minutes}" for minutes in (day < 1.0).sum(axis=0)))
