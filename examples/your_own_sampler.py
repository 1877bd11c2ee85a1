"""A sampler of tunings from outside: points that fill the ranges evenly.

glucoloop robust --sampler 'your_own_sampler:Sobol, seed=2' --out robust
"""

from collections.abc import Sequence
from typing import ClassVar

from scipy.stats import qmc

from glucoloop.plugin import SamplerComponent, Tuned


class Sobol(SamplerComponent):
    """A scrambled Sobol sequence, which fills the ranges more evenly than random draws."""

    make: ClassVar = "your_own_sampler:Points"


class Points:
    """The sampler; it is asked for tunings and told their results, in turns."""

    def __init__(self, space: Sequence[Tuned], seed: int) -> None:
        self.space = space
        self.points = qmc.Sobol(len(space), seed=seed)

    def ask(self, number: int) -> list[dict[str, float]]:
        """The next tunings."""
        shares = self.points.random(number)
        return [{of.name: of.at(float(share)) for of, share in zip(self.space, row, strict=True)} for row in shares]

    def tell(self, results: object) -> None:
        """Nothing is learned from results."""


if __name__ == "__main__":
    made = Sobol(seed=2).made(space=[Tuned("x", 0.0, 1.0, log=False)])
    print("tried: " + ", ".join(f"{point['x']:.2f}" for point in made.ask(4)))
