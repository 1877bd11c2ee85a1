"""Glucose sensors, each one class; all but the innermost wrap another one, their ``inner``.

A sensor joins every command by one class, entered in `protocol.SENSORS` or by the entry point of another package in the
group ``glucoloop.sensors``.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
