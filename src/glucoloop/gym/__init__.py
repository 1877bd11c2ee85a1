"""Environments for Gymnasium: an agent doses one virtual person, or thousands side by side.

Importing this package registers them under the name `ENVIRONMENT`, for `gymnasium.make` and `gymnasium.make_vec`.
"""

from typing import Any, Final

from glucoloop.refusal import needed_for

with needed_for("an environment"):
    import gymnasium

ENVIRONMENT: Final = "glucoloop/Glucose-v0"
"""Name of the environment in Gymnasium."""

gymnasium.register(
    ENVIRONMENT,
    entry_point="glucoloop.gym.environment:GlucoseEnv",
    vector_entry_point="glucoloop.gym.environment:GlucoseVectorEnv",
)


def __getattr__(name: str) -> Any:
    """`StableBaselinesEnv`, whose library is imported with it and is in no listing."""
    if name != "StableBaselinesEnv":
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    from glucoloop.gym.stable_baselines import StableBaselinesEnv

    return StableBaselinesEnv
