"""Trace: the course of a run, sample by sample, and its tables."""

from __future__ import annotations

import dataclasses
from typing import TYPE_CHECKING, Any, Final

import jax
import jax.numpy as jnp
import numpy as np
import numpy.typing as npt

from glucoloop._pytree import pytree, static
from glucoloop._representation import represented
from glucoloop.control.protocol import (
    DoseForecast,
    Status,
)
from glucoloop.refusal import Refusal
from glucoloop.units import MU_PER_U

if TYPE_CHECKING:
    import polars as pl


@represented
@pytree
class Trace:
    """Course of a run, sample by sample; time on the leading axis, people trailing."""

    t_min: jax.Array
    """(samples,) times of the samples."""
    glucose_mg_dl: jax.Array
    """(samples, ...) the patient's glucose, free of noise, at each sample."""
    reading_mg_dl: jax.Array
    """(samples, ...) readings of the sensor."""
    reading_valid: jax.Array
    """(samples, ...) whether each reading is valid."""
    command_mU_min: jax.Array
    """(samples, ...) rates that the controller commands."""
    insulin_mU_min: jax.Array
    """(samples, ...) rates that the pump delivers from this sample to the next."""
    reported_mU_min: jax.Array
    """(samples, ...) rates that the pump reports, equal to the delivered ones unless it errs."""
    status: jax.Array
    """(samples, ...) `control.protocol.Status` of each decision."""
    carbs_g: jax.Array
    """(samples,) carbohydrate of the meals that begin between this sample and the next."""
    states: jax.Array
    """(samples + 1, states, ...) states of the patient, from the start to the horizon."""
    fine_t_min: jax.Array
    """(points,) a grid of one minute, from 0 to the horizon."""
    fine_glucose_mg_dl: jax.Array
    """(points, ...) glucose free of noise on the fine grid."""
    setpoint_mg_dl: jax.Array
    basal_insulin_mU_min: jax.Array
    lowest_valid_mg_dl: jax.Array | float = 0.0
    """Lower end of the valid range of the patient's model; lower glucose means only that it is very low."""
    command_bolus_mU: jax.Array | None = None
    """(samples, ...) bolus that the controller commands; None, like the next two, where it gives no boluses."""
    bolus_mU: jax.Array | None = None
    """(samples, ...) bolus that the pump delivered from this sample to the next, beside the basal rate."""
    reported_bolus_mU: jax.Array | None = None
    """(samples, ...) bolus that the pump reports."""
    announced_carbs_g: jax.Array | None = None
    """(samples,) announced carbohydrate; None where meals were not announced."""
    command_glucagon_ug: jax.Array | None = None
    """(samples, ...) glucagon that the controller commands; None, like the next one, where it gives none."""
    glucagon_ug: jax.Array | None = None
    """(samples, ...) glucagon that the pump delivered from this sample to the next."""
    exercise_pct: jax.Array | None = None
    """(samples,) mean intensity of exercise from each sample to the next; None where there was none."""
    rescue_g: jax.Array | None = None
    """(samples, ...) carbohydrate that the person eats at each sample against low glucose; None where there is none."""
    subcutaneous: bool = static(default=False)
    """Whether insulin is given subcutaneously."""
    warm_up_dose_mU: jax.Array | None = None
    """(samples before, ...) insulin above the basal rate at each sample of a warm-up; None without one."""
    warm_up_carbs_g: jax.Array | None = None
    """(samples before, ...) carbohydrate that was eaten at each sample of a warm-up; None without one."""
    rate_before_mU_min: jax.Array | None = None
    """Rate until the first sample; None for the rate at steady state, where the run has no warm-up."""
    forecast: DoseForecast | None = None
    """Forecasts at the samples ``(samples, points, ...)``; None where they were not asked for or none were made."""

    def after(self, samples: int) -> Trace:
        """The trace without its first samples, which were a warm-up; time counts from the end of them."""
        if not samples:
            return self
        inside = (self.fine_t_min.shape[0] - 1) // self.t_min.shape[0] * samples
        of_samples: dict[str, Any] = {
            name: None if values is None else values[samples:]
            for name, values in vars(self).items()
            if name in _OF_SAMPLES
        }
        return dataclasses.replace(
            self,
            **of_samples,
            forecast=jax.tree.map(lambda values: values[samples:], self.forecast),
            t_min=self.t_min[:-samples],
            fine_t_min=self.fine_t_min[: self.fine_t_min.shape[0] - inside],
            fine_glucose_mg_dl=self.fine_glucose_mg_dl[inside:],
            rate_before_mU_min=self.insulin_mU_min[samples - 1],
            warm_up_dose_mU=self._dose_mU[:samples],
            warm_up_carbs_g=self._eaten_g[:samples],
        )

    @property
    def _sample_time_min(self) -> jax.Array:
        return self.fine_t_min[-1] / self.t_min.shape[0]

    @property
    def _dose_mU(self) -> jax.Array:
        """(samples, ...) insulin above the basal rate that was delivered from each sample to the next."""
        dose_mU = (self.insulin_mU_min - self.basal_insulin_mU_min) * self._sample_time_min
        return dose_mU if self.bolus_mU is None else dose_mU + self.bolus_mU

    @property
    def _eaten_g(self) -> jax.Array:
        """(samples, ...) carbohydrate of meals and against low glucose."""
        if self.rescue_g is None:
            return self.carbs_g
        return self.rescue_g + self.carbs_g.reshape(-1, *(1,) * (jnp.ndim(self.rescue_g) - 1))

    @property
    def insulin_on_board_U(self) -> npt.NDArray[np.float64]:
        """(samples, ...) insulin on board at each sample, above the basal rate; see `control.loop_like.on_board`."""
        insulin, _ = self._curves
        return _on_board(self.warm_up_dose_mU, self._dose_mU, insulin) / MU_PER_U

    @property
    def carbs_on_board_g(self) -> npt.NDArray[np.float64]:
        """(samples, ...) carbohydrate on board at each sample, of meals and against low glucose."""
        _, carbs = self._curves
        return _on_board(self.warm_up_carbs_g, self._eaten_g, carbs)

    @property
    def _curves(self) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.float64]]:
        from glucoloop.control.loop_like import on_board_curves

        return on_board_curves(float(self._sample_time_min))

    @property
    def glucose_valid(self) -> jax.Array:
        """(samples, ...) whether glucose at each sample is in the valid range of the patient's model.

        Lower glucose, which may even be below zero, means only that it is very low, and what is not a number nothing.
        """
        return jnp.asarray(self.glucose_mg_dl) >= self.lowest_valid_mg_dl

    @property
    def fine_glucose_valid(self) -> jax.Array:
        """(points, ...) the same on the fine grid."""
        return jnp.asarray(self.fine_glucose_mg_dl) >= self.lowest_valid_mg_dl

    def to_polars(self) -> pl.DataFrame:
        """One row per sample, as a data frame of Polars.

        Columns: ``t_min``; ``glucose_mg_dl``, free of noise; ``reading_mg_dl``, null where there was none;
        ``insulin_mU_min``, delivered from this sample to the next; ``command_mU_min``, what the controller asked for,
        null where that was no number; ``reported_mU_min``, what the pump said it delivered, null where it said nothing;
        ``status``, how the decision came about; ``carbs_g`` of the meals that begin before the next sample. Where meals
        are announced, ``announced_carbs_g`` tells what the controller was told; ``exercise_pct`` is there where there
        was exercise, its mean intensity until the next sample; ``rescue_g`` where the person eats against low glucose;
        where the controller gives boluses, ``bolus_mU``, ``command_bolus_mU`` and ``reported_bolus_mU`` tell
        of them what the rates tell of the basal rate; where it gives glucagon, ``glucagon_ug`` was delivered and
        ``command_glucagon_ug`` commanded. ``carbs_on_board_g`` and, with subcutaneous insulin,
        ``insulin_on_board_U`` are what is on board at the sample before its own dose and meal, by the curves of
        `control.loop_like`; insulin counts above the basal rate.

        Raises
        ------
        ValueError
            For a trace of more than one person.
        """
        import polars as pl

        self._refuse_people()
        reading = np.where(np.asarray(self.reading_valid), np.asarray(self.reading_mg_dl), np.nan)
        others = (
            *("announced_carbs_g", "exercise_pct", "rescue_g", "bolus_mU", "command_bolus_mU", "reported_bolus_mU"),
            *("glucagon_ug", "command_glucagon_ug"),
        )
        return pl.DataFrame(
            {
                "t_min": np.asarray(self.t_min),
                "glucose_mg_dl": np.asarray(self.glucose_mg_dl),
                "reading_mg_dl": pl.Series(reading).fill_nan(None),
                "insulin_mU_min": np.asarray(self.insulin_mU_min),
                "command_mU_min": pl.Series(np.asarray(self.command_mU_min)).fill_nan(None),
                "reported_mU_min": pl.Series(np.asarray(self.reported_mU_min)).fill_nan(None),
                "status": [Status(code).name.lower().replace("_", " ") for code in np.asarray(self.status).tolist()],
                "carbs_g": np.asarray(self.carbs_g),
                **{
                    name: pl.Series(np.asarray(getattr(self, name))).fill_nan(None)
                    for name in others
                    if getattr(self, name) is not None
                },
                **(
                    {"insulin_on_board_U": pl.Series(self.insulin_on_board_U).fill_nan(None)}
                    if self.subcutaneous
                    else {}
                ),
                "carbs_on_board_g": self.carbs_on_board_g,
            }
        )

    def forecasts_to_polars(self) -> pl.DataFrame:
        """One row per sample and time ahead of it, as a data frame of Polars; without forecasts it has no rows.

        Columns: ``t_min`` of the sample; ``ahead_min``, time ahead of it; ``glucose_mg_dl`` that the controller expects
        then; further forecasts of the controller, such as ``cautious_mg_dl``, null where there is none; and
        ``insulin_mU_min``, the rate from then to the next row under which it expects so: its plan, a bolus included, or
        the basal rate for a controller that plans no doses.

        Raises
        ------
        ValueError
            For a trace of more than one person.
        """
        import polars as pl

        self._refuse_people()
        of = self.forecast
        if of is None:
            names = ("t_min", "ahead_min", "glucose_mg_dl", "insulin_mU_min")
            return pl.DataFrame(schema=dict.fromkeys(names, pl.Float64))
        points = of.ahead_min.shape[1]
        columns = {
            "t_min": np.repeat(np.asarray(self.t_min), points),
            "ahead_min": of.ahead_min,
            "glucose_mg_dl": of.glucose_mg_dl,
            **{f"{name}_mg_dl": values for name, values in (of.others_mg_dl or {}).items()},
            "insulin_mU_min": of.insulin_mU_min,
        }
        table = pl.DataFrame({name: np.ravel(np.asarray(values, float)) for name, values in columns.items()})
        return table.fill_nan(None).drop_nulls("ahead_min")

    def _refuse_people(self) -> None:
        """Refuse the trace of more than one person."""
        if np.ndim(self.glucose_mg_dl) != 1:
            raise Refusal(
                f"this trace is of people of shape {np.shape(self.glucose_mg_dl)[1:]}, not of one; "
                "pick one, as with jax.tree.map(lambda values: values[i], traces) after jax.vmap"
            )


def _on_board(before: jax.Array | None, amounts: jax.Array, curve: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
    """Amount on board at each sample, with what was given before the first of them."""
    from glucoloop.control.loop_like import on_board

    if before is None:
        return on_board(amounts, curve)
    return on_board(np.concatenate([np.asarray(before), np.asarray(amounts)]), curve)[len(before) :]


_OF_SAMPLES: Final = (
    *("glucose_mg_dl", "reading_mg_dl", "reading_valid", "command_mU_min", "insulin_mU_min", "reported_mU_min"),
    *("status", "carbs_g", "states", "command_bolus_mU", "bolus_mU", "reported_bolus_mU", "announced_carbs_g"),
    *("exercise_pct", "rescue_g", "glucagon_ug", "command_glucagon_ug"),
)
"""Fields of a trace with an entry for each sample, the first one first."""
