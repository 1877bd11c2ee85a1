"""Insulin pumps: limits of the basal rate and of boluses, delivery resolution, and faults.

What wraps an `inner` pump wraps one with the limits of the paper by default.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
