"""Metrics of a run, each a fold: regulation, glycemic risk, insulin, constraints and what the samples met."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
