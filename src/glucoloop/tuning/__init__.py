"""Searches for tunings: every combination of a grid in one batch, and samplers that propose points round by round.

`search` tries a grid. `samplers` draws by chance or asks Optuna, and `evolution` is CMA-ES; both are asked for points
and told of their results by turns, so that a study can resume.
"""
