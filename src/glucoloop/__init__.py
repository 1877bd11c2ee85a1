"""glucoloop: an open laboratory for automatic insulin dosing. Research software, not a medical device.

The names below are the everyday interface; they are imported when first used, so that `import glucoloop` and
``glucoloop --help`` answer at once. Everything else lives in the layers, which are imported in the same way:
`glucoloop.patients`, `glucoloop.control` and so on.

Importing glucoloop switches JAX to float64 for the whole process, for controllers are designed in it; nothing else of
JAX changes. See `glucoloop.arithmetic`.
"""

from importlib.util import find_spec

import lazy_loader

from glucoloop.arithmetic import use_float64

__version__ = "0.1.0"

use_float64()

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)

# What an extra installs is listed where it is installed. Without it `glucoloop.gym` names the extra, and `help`,
# `inspect` and `import *`, which ask for all that is listed, have nothing to trip over.
if find_spec("gymnasium") is None:
    __all__.remove("gym")
    __dir__ = __all__.copy
