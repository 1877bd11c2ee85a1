"""Faults of sensors and pumps, each one class around a sensor or a pump.

A fault joins every command, the stress test and the random faults of ``glucoloop verify`` by one class, entered in
`fault.FAULTS`; one of another package, by an entry point in the group ``glucoloop.faults``, joins all but the last.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
