"""Profiles that are wrong: what controllers have of a person's ratios and basal rate, and what is true of the person.

A profile that a clinician sets is wrong in ratio and factor by a fifth or so, and by more after a typing error or in
another year of life. Controllers have the wrong profile; the person rests under the true basal rate.
"""

from __future__ import annotations

import dataclasses
import functools
from typing import Annotated, Any, ClassVar, Final

from glucoloop._lazy_jax import np, npt, scipy
from glucoloop.component.base import Component
from glucoloop.component.catalogue import Catalogue
from glucoloop.component.effects import PROFILE
from glucoloop.component.setting import About
from glucoloop.therapy import Profile
from glucoloop.threefry import uniforms

_known: Final = functools.partial(About, at_least=10.0, at_most=1000.0)


class ProfileErrorComponent(Component):
    """Error of the profiles that controllers have."""

    kind: ClassVar = "profile error"

    def known(self, profile: Profile, seed: int, person: npt.NDArray[np.int64]) -> Profile:
        """Profile of people ``(n,)``, or of one person, as controllers have it."""
        raise NotImplementedError


class ProfileError(ProfileErrorComponent, name="wrong"):
    """Profile that is wrong by factors, and by errors drawn for each person.

    Ratio and factor are ``ratio_pct / 100 * exp(z spread_pct / 100)`` times the person's own, with a standard normal z
    for each of the two.
    """

    ratio_pct: Annotated[
        float,
        _known("Known carbohydrate ratio and correction factor, in percent of the person's own.", needs=(PROFILE,)),
    ] = 100.0
    basal_pct: Annotated[float, _known("Known basal rate, in percent of the person's own.")] = 100.0
    spread_pct: Annotated[
        float,
        About(
            "Standard deviation of the logarithm of ratio and factor in percent, drawn for each person and each of "
            "the two.",
            at_least=0.0,
            at_most=100.0,
            needs=(PROFILE,),
        ),
    ] = 0.0

    def known(self, profile: Profile, seed: int, person: npt.NDArray[np.int64]) -> Profile:
        """Profile with wrong ratios and basal rate."""

        def wrong(value: Any, name: str) -> Any:
            z = scipy.special.ndtri(uniforms(seed, f"error of the {name}", person))
            factor = self.ratio_pct / 100.0 * np.exp(self.spread_pct / 100.0 * z)
            return np.asarray(value, float) * factor

        return dataclasses.replace(
            profile,
            basal_mU_min=self.basal_pct / 100.0 * np.asarray(profile.basal_mU_min, float),
            carb_ratio_g_U=wrong(profile.carb_ratio(), "carbohydrate ratio"),
            correction_mg_dl_U=wrong(profile.correction_factor(), "correction factor"),
        )


PROFILE_ERRORS: Final = Catalogue(
    ProfileErrorComponent,
    {"wrong": "glucoloop.situations.profile_error:ProfileError"},
    example="wrong, spread=20%",
    unnamed=True,
)
