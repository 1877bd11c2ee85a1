"""Environments for Gymnasium: an agent doses one virtual person, or thousands side by side.

Importing this package registers them under the name `ENVIRONMENT`, for `gymnasium.make` and `gymnasium.make_vec`.
"""

from typing import Final

from glucoloop._extras import needed_for

with needed_for("an environment"):
    import gymnasium

ENVIRONMENT: Final = "glucoloop/Glucose-v0"
"""Name of the environment in Gymnasium."""

gymnasium.register(
    ENVIRONMENT,
    entry_point="glucoloop.gym.environment:GlucoseEnv",
    vector_entry_point="glucoloop.gym.environment:GlucoseVectorEnv",
)
