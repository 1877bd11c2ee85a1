"""Estimation of meals that are not announced, from glucose and insulin alone.

An estimator joins the meal-aware controller and `glucoloop detect` by one class, entered in `protocol.ESTIMATORS` or by
the entry point of another package in the group ``glucoloop.estimators``.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
