"""Components: everything that a user names, with settings, in one grammar for command line, files and Python.

Here is what a component is; the components themselves are declared beside what they make, and `catalogue.HOMES` says
where.
"""

from glucoloop.component.pytree_component import DATA, HOST, STATIC, derived, derived_static, wired
from glucoloop.component.setting import About, Default, Tuned, default_by_noise

__all__ = [
    "DATA",
    "HOST",
    "STATIC",
    "About",
    "Default",
    "Tuned",
    "default_by_noise",
    "derived",
    "derived_static",
    "wired",
]
