"""Metrics of a record of a continuous glucose monitor, as the consensus defines them: of readings with gaps, by NumPy.

`Readings` holds what was read, or a simulated trajectory; `catalogue.MEASURES` lists every metric once.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
