"""Physiology that follows the clock or an event: rhythms of sensitivity and glucose production, and exercise."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
