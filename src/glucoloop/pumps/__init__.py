"""Insulin pumps, each one class; all but the limited one wrap another pump, their ``inner``.

A pump joins every command by one class, entered in `limits.PUMPS` or by the entry point of another package in the group
``glucoloop.pumps``.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
