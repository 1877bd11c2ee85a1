"""Records of people: readers that bring the files of devices, apps and simulators to one tidy table."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
