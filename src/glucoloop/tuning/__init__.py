"""Searches for tunings: every combination of a grid in one batch, and samplers that propose points round by round.

`search` tries a grid. `samplers` draws at random or uses Optuna, and `evolution` is CMA-ES; both are asked for points
and given their results in turns, so that a study can resume.
"""

from glucoloop.tuning.samplers import SAMPLERS, SamplerComponent

__all__ = ["SAMPLERS", "SamplerComponent"]
