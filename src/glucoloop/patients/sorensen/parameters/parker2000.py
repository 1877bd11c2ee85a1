"""The eight uncertain parameters of Parker, Doyle, Ward and Peppas (2000).

They characterise the uncertainty of the patient by a variation of up to 40 % in eight parameters: two fractions of
insulin clearance, and scale and inflection of three effects of insulin on glucose. Effects are written there as
``E (A - B tanh(C (x - D)))``. The scale E multiplies the whole effect, here ``strength``; were B alone varied, uptake
would turn negative. The inflection is D.

The printed inflection of the effect on hepatic uptake is 0, of which 40 % is nothing. Here it is moved by up to 0.4 of
the healthy basal concentration, by which these effects are normalised. That is a reading, as is the uniform
distribution: the abstract gives bounds only.
"""

from __future__ import annotations

from typing import Final, NamedTuple

SOURCE: Final = "Parker, Doyle, Ward, Peppas 2000, AIChE J. 46(12)"
LARGEST_VARIATION_PCT: Final = 40.0


class _Uncertain(NamedTuple):
    """A parameter that the paper varies."""

    parameter: str
    """A constant of the patient, or ``strength``, the factor on a whole effect."""
    half_width: float | None
    """Largest change in the unit of the parameter, or None for 40 % of its nominal value."""
    meaning: str
    source: str


# fmt: off
# ruff: noqa: E501 (a table reads best with one value on each line)
UNCERTAIN: Final = (
    _Uncertain("F_LC", None, "fraction of insulin cleared by the liver", SOURCE),
    _Uncertain("F_PC", None, "fraction of insulin cleared by the periphery", SOURCE),
    _Uncertain("M_IHGP.strength", None, "insulin on hepatic production: scale E of the whole effect", SOURCE),
    _Uncertain("M_IHGP.inflection", None, "insulin on hepatic production: inflection D", SOURCE),
    _Uncertain("M_IHGU.strength", None, "insulin on hepatic uptake: scale E of the whole effect", SOURCE),
    _Uncertain("M_IHGU.inflection", 0.4, "insulin on hepatic uptake: inflection D; printed as 0, moved by 0.4 of the healthy basal concentration", f"reading of {SOURCE}"),
    _Uncertain("M_IPGU.strength", None, "insulin on peripheral uptake: scale E of the whole effect", SOURCE),
    _Uncertain("M_IPGU.inflection", None, "insulin on peripheral uptake: inflection D", SOURCE),
)
# fmt: on
