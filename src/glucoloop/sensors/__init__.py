"""Glucose sensors and their faults: small objects that wrap an `inner` sensor, an ideal one by default."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
