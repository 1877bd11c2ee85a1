"""The error of a value that cannot be used, which is the user's mistake and no bug."""

from __future__ import annotations


class Refusal(ValueError):  # noqa: N818 (it is no failure of the program)
    """A given value that is refused, in a sentence that names the value, the bound and the remedy.

    The command line prints the sentence and exits with code 2; any other error is a bug. Code of your own that checks
    the settings of a patient or a controller raises it too.
    """
