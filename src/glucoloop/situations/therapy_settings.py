"""Therapy of a situation: profile, targets, overrides in some hours, and errors of the profile that controllers have.

A profile that a clinician sets is wrong in ratio and factor by a fifth or so, and by more after a typing error or in
another year of life. Controllers have the wrong profile; the person rests under the true basal rate.

An override is of a target or of the need of insulin, as for sport or illness. One of p percent multiplies the basal
rate by p / 100 and divides carbohydrate ratio and correction factor by it, as overrides of Loop and profile switches of
AndroidAPS do. Hours are those of every day of a run.
"""

from __future__ import annotations

import dataclasses
import functools
from typing import Annotated, Any, ClassVar, Final, Literal

from glucoloop._lazy_jax import np, npt, scipy
from glucoloop.component.base import Component
from glucoloop.component.catalogue import Catalogue
from glucoloop.component.effects import PROFILE
from glucoloop.component.setting import PATIENT_PANEL, About, Option
from glucoloop.refusal import Refusal
from glucoloop.situations.therapy_text import profile_texts, target_texts
from glucoloop.therapy import TARGET, Profile, TherapyChange
from glucoloop.threefry import uniforms
from glucoloop.unit_guess import SETPOINT
from glucoloop.units import MIN_PER_DAY

_ALL: Final = 100.0


class OverrideComponent(Component):
    """Declaration of an override: its hours, its target and the need of insulin in them."""

    kind: ClassVar = "override"

    from_min: Annotated[float, About("Time of day at which it begins, like 17h.", at_least=0.0, below=MIN_PER_DAY)] = (
        0.0
    )
    to_min: Annotated[
        float,
        About("Time of day at which it ends, on the next day if that is earlier.", at_least=0.0, at_most=MIN_PER_DAY),
    ] = MIN_PER_DAY
    target_mg_dl: Annotated[
        float | None, About("Target; that without it by default.", at_least=60.0, at_most=300.0, quantity=SETPOINT)
    ] = None
    insulin_pct: Annotated[
        float,
        About(
            "Basal rate, and insulin for meals and corrections, in percent.",
            at_least=10.0,
            at_most=1000.0,
            needs=(PROFILE,),
        ),
    ] = _ALL

    def __post_init__(self) -> None:
        if self.from_min == self.to_min:
            raise Refusal(
                f"the override {self.name} begins and ends at {self.from_min:g} min; give two different times"
            )

    def changes(self) -> tuple[TherapyChange, ...]:
        """Changes of a therapy that it stands for."""
        hours, share = (self.from_min, self.to_min), self.insulin_pct / _ALL
        result = (
            []
            if self.target_mg_dl is None
            else [TherapyChange(TARGET, *hours, value=self.target_mg_dl, temporary=True)]
        )
        if share != 1.0:
            result.append(TherapyChange("basal_mU_min", *hours, factor=share))
            result += [
                TherapyChange(field, *hours, factor=1.0 / share) for field in ("carb_ratio_g_U", "correction_mg_dl_U")
            ]
        return tuple(result)


class Override(OverrideComponent, name="override"):
    """Another target or need of insulin for any reason."""


class ExerciseOverride(OverrideComponent, name="exercise"):
    """Exercise, with a target of 150 mg/dl until another one is given."""

    target_mg_dl: float | None = 150.0


class IllnessOverride(OverrideComponent, name="illness"):
    """Illness, with 20 % more insulin until another number is given."""

    insulin_pct: float = 120.0


OVERRIDES: Final = Catalogue(
    OverrideComponent,
    {
        "override": "glucoloop.situations.therapy_settings:Override",
        "exercise": "glucoloop.situations.therapy_settings:ExerciseOverride",
        "illness": "glucoloop.situations.therapy_settings:IllnessOverride",
    },
    example="exercise, from=17h, to=19h",
    unnamed=True,
)


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
    {"wrong": "glucoloop.situations.therapy_settings:ProfileError"},
    example="wrong, spread=20%",
    unnamed=True,
)

_patient = functools.partial(Option, panel=PATIENT_PANEL)
ProfileBy = Annotated[
    Literal["table", "titration"],
    _patient(
        "Carbohydrate ratio and correction factor of each person: of the table of people where it has them, or "
        "titrated on each person, see the guide to populations.",
        rare=True,
        needs=(PROFILE,),
    ),
]
TherapyProfile = Annotated[
    tuple[str, ...],
    _patient(
        "Therapy by the time of day: a file like profile.toml or Nightscout's profile.json, or 'basal, 0.9, 0h-6h'; "
        "repeat it for more. What it leaves out is the person's own.",
        flag="--profile",
        metavar="FILE|TEXT",
        rare=True,
        needs=(PROFILE,),
        reads=profile_texts,
    ),
]
Targets = Annotated[
    tuple[str, ...],
    _patient(
        "Target in some hours of each day, like 110@22h until midnight or 120@22h-6h; repeat it for more.",
        flag="--target-at",
        metavar="MG/DL@HOURS",
        rare=True,
        reads=target_texts,
    ),
]
Overrides = Annotated[
    tuple[OverrideComponent, ...],
    _patient(
        "Hours of each day with another target or need of insulin, like 'exercise, from=17h, to=19h, target=150, "
        "insulin=70%' or 'illness'; repeat it for more.",
        flag="--override",
        rare=True,
    ),
]
WrongProfile = Annotated[
    ProfileErrorComponent | None,
    _patient(
        "Error of the profiles that controllers have, like 'ratio_pct=50' or 'spread_pct=20'; right by default.",
        flag="--profile-error",
        rare=True,
    ),
]
