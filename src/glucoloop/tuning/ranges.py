"""Usual ranges of a search of a grid. Nothing is imported here, so that help is shown at once."""

from __future__ import annotations

from typing import Final

REFERENCE_FILTERS: Final = {"mpc-se": ".3:.8:.05", "nlqdmc-se": ".3:.5:.1,.57,.7,.8"}
"""Values of phi_r that are tried, the printed ones among them; about half as many for NLQDMC/SE, whose loops take a
hundred times as long.
"""
