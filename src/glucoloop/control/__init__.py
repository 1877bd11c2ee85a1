"""Controllers: pure functions from observations to doses, designed once and without access to a patient."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
