"""Rhythms: sensitivity to insulin and production of glucose that follow the time of day and differ from day to day."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
