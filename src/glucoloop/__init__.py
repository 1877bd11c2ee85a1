"""glucoloop: an open laboratory for automatic insulin dosing. Research software, not a medical device."""

import os
import sys

__version__ = "0.1.0"

# Glucose control is designed in float64. JAX reads the variable when it is first imported.
os.environ.setdefault("JAX_ENABLE_X64", "true")
if "jax" in sys.modules:
    sys.modules["jax"].config.update("jax_enable_x64", True)
