"""Twins: the parameters of one person, found from a record of ordinary life on any family of patients."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
