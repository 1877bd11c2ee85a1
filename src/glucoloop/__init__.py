"""glucoloop: an open laboratory for automatic insulin dosing. Research software, not a medical device.

``dir(glucoloop)`` has the everyday interface; each name is imported when it is first used, so that `import glucoloop`
and ``glucoloop --help`` answer at once. `glucoloop.plugin` has what components of one's own import. Both are stable;
what else the modules hold may change, see the page "Versions and formats".

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
