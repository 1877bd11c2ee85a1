"""The closed loop: a patient, a controller, a sensor, a pump and a scenario make a trace."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator
from typing import TYPE_CHECKING, Any, Final

import jax
import jax.numpy as jnp
import numpy as np
import numpy.typing as npt

from glucoloop._kept_programs import kept_jit
from glucoloop._pytree import pytree, static
from glucoloop._representation import represented
from glucoloop.arguments import ArgumentTypeError, checked, is_traced, random_key
from glucoloop.component.effects import (
    AHEAD,
    ANNOUNCEMENTS,
    CHANCE,
    MEALS,
    MEALS_ANNOUNCED,
    OF_CONTROLLERS,
    RHYTHMS,
    TIME_OF_DAY,
    Need,
    warn_without_effect,
)
from glucoloop.component.routes import SUBCUTANEOUS
from glucoloop.control.protocol import (
    Controller,
    DoseForecast,
    Observation,
    Status,
    draws,
    gives_boluses,
    gives_glucagon,
    uses_of,
)
from glucoloop.meals.models import meal_model_of
from glucoloop.meals.scenario import Scenario, announced_g, announced_min
from glucoloop.patients.capabilities import insulin_route, lowest_valid_glucose_mg_dl, refuse_glucagon, usual_pump
from glucoloop.patients.protocol import Patient
from glucoloop.pumps import DoseLimits, GlucagonLimits, LimitedPump, Pump
from glucoloop.refusal import Refusal
from glucoloop.sensors import DeadTime, IdealSensor, Lag, Sensor
from glucoloop.simulation.integrators import default_integrator
from glucoloop.simulation.loop import Loop, LoopState, Sampled, begin, sample
from glucoloop.simulation.minute_inputs import minute_inputs_of
from glucoloop.simulation.plant import Integrator, MinuteInputs, SampleGrid
from glucoloop.simulation.user_objects import Fixed, apart, sample_time_of, wrong_with
from glucoloop.units import MIN_PER_DAY, MU_PER_U

if TYPE_CHECKING:
    import polars as pl

Values = jax.Array | npt.NDArray[np.float64]


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
        """(samples, ...) insulin on board at each sample, above the basal rate; see `control.on_board`."""
        insulin, _ = self._curves
        return _on_board(self.warm_up_dose_mU, self._dose_mU, insulin) / MU_PER_U

    @property
    def carbs_on_board_g(self) -> npt.NDArray[np.float64]:
        """(samples, ...) carbohydrate on board at each sample, of meals and against low glucose."""
        _, carbs = self._curves
        return _on_board(self.warm_up_carbs_g, self._eaten_g, carbs)

    @property
    def _curves(self) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.float64]]:
        from glucoloop.control.on_board import curves

        return curves(float(self._sample_time_min))

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
        `control.on_board`; insulin counts above the basal rate.

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
    from glucoloop.control.on_board import on_board

    if before is None:
        return on_board(amounts, curve)
    return on_board(np.concatenate([np.asarray(before), np.asarray(amounts)]), curve)[len(before) :]


_OF_SAMPLES: Final = (
    *("glucose_mg_dl", "reading_mg_dl", "reading_valid", "command_mU_min", "insulin_mU_min", "reported_mU_min"),
    *("status", "carbs_g", "states", "command_bolus_mU", "bolus_mU", "reported_bolus_mU", "announced_carbs_g"),
    *("exercise_pct", "rescue_g", "glucagon_ug", "command_glucagon_ug"),
)
"""Fields of a trace with an entry for each sample, the first one first."""


@pytree
class Start:
    """State and rate at which the loop begins."""

    x: jax.Array
    insulin_mU_min: jax.Array
    setpoint_mg_dl: jax.Array


@pytree
class OnGrid:
    """Meals on the grid of samples, and the grid."""

    t_min: Values
    fine_t_min: Values
    carbs_g: Values
    announced_g: Values
    time_of_day_min: Values | None
    """Time of day at each sample, or None if the controller does not get it."""


def on_the_grid(scenario: Scenario, grid: SampleGrid) -> OnGrid:
    """Meals of a scenario on a grid of samples, from the beginning of its warm-up on."""
    meals = scenario.eaten()

    def at_samples(t_min: Any, sizes_g: Any) -> Values:
        if is_traced(t_min, sizes_g):
            return jnp.zeros(grid.samples).at[jnp.floor(t_min / grid.sample_time_min).astype(int)].add(sizes_g)
        # an announcement may come before the start, which is then the time at which it is heard, or after the end
        sample = np.maximum(np.floor(np.asarray(t_min) / grid.sample_time_min), 0.0).astype(int)
        heard = sample < grid.samples
        return np.bincount(sample[heard], np.asarray(sizes_g)[heard], grid.samples).astype(float)

    carbs_g = at_samples(meals.t_min, meals.carbs_g)
    announced = 0.0 * carbs_g
    if scenario.announced:
        announced_at_min = scenario.warm_up_min + announced_min(scenario.meals, scenario.announced_before_min)
        announced = at_samples(announced_at_min, announced_g(scenario.meals))
    return OnGrid(
        t_min=grid.t_min,
        fine_t_min=grid.fine_t_min,
        carbs_g=carbs_g,
        announced_g=announced,
        time_of_day_min=None if scenario.start_min is None else (grid.start_min + grid.t_min) % MIN_PER_DAY,
    )


@kept_jit(static_argnums=1)
def _run(numbers: list[Any], fixed: Fixed, start: Start, exogenous: Any, on_grid: OnGrid, key: jax.Array) -> Trace:
    """Scan of the closed loop over samples."""
    loop: Loop = fixed.joined(numbers)
    patient = loop.plant.patient
    announced, times = on_grid.announced_g, on_grid.time_of_day_min
    first_time = None if times is None else times[0]
    state, reading_key = begin(loop, start.x, start.insulin_mU_min, announced[0], key, first_time)

    def one(state: LoopState, entry: Any) -> tuple[LoopState, Sampled]:
        index, outside, announced_g, time_of_day_min = entry
        return sample(loop, state, outside, announced_g, reading_key, index, time_of_day_min)

    index = jnp.arange(on_grid.carbs_g.shape[0])
    last, happened = jax.lax.scan(one, state, (index, exogenous, announced, times))
    return trace_of(patient, start, on_grid, happened, last.x)


def trace_of(patient: Patient, start: Start, on_grid: OnGrid, happened: Sampled, x_end: jax.Array) -> Trace:
    """Trace of a run from the events of its samples, which are stacked on the leading axis, and its last state."""
    glucose = patient.glucose_mg_dl(start.x)
    return Trace(
        t_min=jnp.asarray(on_grid.t_min),
        glucose_mg_dl=happened.glucose_mg_dl,
        reading_mg_dl=happened.reading.glucose_mg_dl,
        reading_valid=happened.reading.valid,
        command_mU_min=happened.decision.insulin_mU_min,
        insulin_mU_min=happened.delivery.insulin_mU_min,
        reported_mU_min=happened.delivery.reported_mU_min,
        status=happened.decision.status,
        carbs_g=jnp.asarray(on_grid.carbs_g),
        states=jnp.concatenate([happened.x, x_end[None]]),
        fine_t_min=jnp.asarray(on_grid.fine_t_min),
        fine_glucose_mg_dl=jnp.concatenate([glucose[None], happened.inside_mg_dl.reshape(-1, *glucose.shape)]),
        setpoint_mg_dl=start.setpoint_mg_dl,
        basal_insulin_mU_min=start.insulin_mU_min,
        lowest_valid_mg_dl=jnp.broadcast_to(lowest_valid_glucose_mg_dl(patient), glucose.shape),
        command_bolus_mU=happened.decision.bolus_mU,
        bolus_mU=happened.delivery.bolus_mU,
        reported_bolus_mU=happened.delivery.reported_bolus_mU,
        command_glucagon_ug=happened.decision.glucagon_ug,
        glucagon_ug=happened.delivery.glucagon_ug,
        rescue_g=happened.rescue_g,
        forecast=happened.forecast,
        subcutaneous=insulin_route(patient) == SUBCUTANEOUS,
    )


def usual_limits(patient: Patient) -> DoseLimits:
    """Limits of the pump that is usual for a patient, or for the route by which it has insulin.

    Designs, `summarise` and `LimitedPump` see no patient and take the limits of 1999; for subcutaneous insulin those
    keep a controller far within what the pump can give.

    Examples
    --------
    >>> import glucoloop as gl
    >>> gl.usual_limits(gl.patient()).max_mU_min
    66.9
    """
    usual = usual_pump(patient)
    return DoseLimits(
        max_change_mU_min=usual.max_change_mU_min, min_mU_min=usual.min_mU_min, max_mU_min=usual.max_mU_min
    )


def default_pump(limits: DoseLimits, controller: Controller) -> Pump:
    """Pump with these limits, and a second route where a controller gives glucagon."""
    return LimitedPump(limits=limits, glucagon=GlucagonLimits() if gives_glucagon(controller) else None)


def sample_grid(
    horizon_min: float, sample_time_min: float, start_min: float | None = None, warm_up_min: float = 0.0
) -> SampleGrid:
    """Samples of a run from a time of day, midnight by default; horizon and warm-up are whole numbers of them."""

    def whole(what: str, minutes: float, least: int) -> int:
        samples = round(minutes / sample_time_min)
        if samples < least or abs(samples * sample_time_min - minutes) > 1e-9 * minutes:
            raise Refusal(
                f"a {what} of {minutes:g} min is not a whole number of samples of {sample_time_min:g} min; "
                f"{max(1, samples) * sample_time_min:g} min would be"
            )
        return samples

    return SampleGrid(
        sample_time_min=sample_time_min,
        samples=whole("horizon", horizon_min, 1),
        start_min=start_min or 0.0,
        warm_up=whole("warm-up", warm_up_min, 0),
    )


def start_of(patient: Patient, scenario: Scenario) -> Start:
    """The patient at steady state, at the initial glucose of the scenario."""
    insulin = patient.basal_insulin_mU_min
    if scenario.initial_glucose_mg_dl is not None:
        insulin = patient.insulin_for(scenario.initial_glucose_mg_dl)
    setpoint = (
        patient.setpoint_mg_dl if scenario.setpoint_mg_dl is None else jnp.asarray(scenario.setpoint_mg_dl, float)
    )
    return Start(x=patient.steady_state(insulin), insulin_mU_min=insulin, setpoint_mg_dl=setpoint)


@checked
def simulate(
    patient: Patient,
    controller: Controller,
    sensor: Sensor | None = None,
    pump: Pump | None = None,
    scenario: Scenario | None = None,
    key: jax.Array | int | None = None,
    *,
    integrator: Integrator | None = None,
    forecasts: bool = False,
) -> Trace:
    """Simulate the closed loop of one patient or of several.

    At each sample the sensor reads, the controller decides, and the pump delivers until the next one. The patient
    starts at steady state, before the warm-up of the scenario if it has one; the trace begins at the end of that.

    Parameters
    ----------
    sensor : Sensor, optional
        Sensor; an ideal one by default.
    pump : Pump, optional
        Pump; by default one with the default limits of the patient, see `simulation.usual_limits`.
    scenario : Scenario, optional
        The 50 g oral glucose test at 50 min over 600 min by default.
    key : JAX key or int, optional
        Source of all randomness: the same key gives the same trace. By default 0.
    integrator : Integrator, optional
        Integrator; by default `Exponential` if the patient has the parts for it, else `Explicit`, as for one whose
        constants follow the clock, and in a scenario with exercise or rhythms.
    forecasts : bool
        Whether the trace has the forecast on which each decision rests, see `Trace.forecasts_to_polars`.

    Warns
    -----
    NoEffectWarning
        For what the scenario has and the controller has no use for, such as announced meals, for a key where nothing is
        drawn at random, and for forecasts of a controller that makes none.

    Raises
    ------
    ValueError
        If the horizon is not a whole number of the controller's samples, the patient cannot rest at the initial
        glucose, or it does not take the exercise or the rhythms of the scenario.
    """
    if scenario is not None:
        warn_without_effect(scenario_without_effect(scenario, controller, patient), stacklevel=3)
    seed = random_key(0 if key is None else key)
    if key is not None and not (draws(controller) or _draw(sensor, pump)):
        warn_without_effect([f"key has no effect: {CHANCE.reason}."], stacklevel=3)
    trace = closed_loop(patient, controller, sensor, pump, scenario, seed, integrator=integrator, forecasts=forecasts)
    if forecasts and trace.forecast is None:
        warn_without_effect([f"forecasts has no effect: the controller {type(controller).__name__} makes none."], 3)
    return trace


def _draw(sensor: Sensor | None, pump: Pump | None) -> bool:
    """Whether a sensor or a pump may draw random numbers; those that nobody here knows may."""
    while isinstance(sensor, DeadTime | Lag):
        sensor = sensor.inner
    return not (sensor is None or type(sensor) is IdealSensor) or not (pump is None or type(pump) is LimitedPump)


def scenario_without_effect(scenario: Scenario, controller: Controller, patient: Patient) -> Iterator[str]:
    """Notes on what a scenario has, and neither controller nor patient nor the scenario itself has a use for."""
    uses = uses_of(controller) | ({MEALS} if len(scenario.meals) else frozenset())
    uses |= {MEALS_ANNOUNCED} if scenario.announced else frozenset()
    uses |= {TIME_OF_DAY} if scenario.rhythms or not getattr(patient, "timeless", False) else frozenset()
    uses |= {RHYTHMS} if scenario.rhythms else frozenset()
    uses |= {MEALS} if scenario.rescue is not None else frozenset()
    for name, needs in _SCENARIO_NEEDS.items():
        value, default = getattr(scenario, name), getattr(Scenario, name)
        lacking = next((need for need in needs if need not in uses), None)
        if lacking is not None and (value is not None if default is None else is_traced(value) or value != default):
            of_controller = f"the controller {type(controller).__name__} does not use {lacking.noun}"
            yield f"{name} has no effect: {of_controller if lacking in OF_CONTROLLERS else lacking.reason}."


_SCENARIO_NEEDS: Final[dict[str, tuple[Need, ...]]] = {
    "announced": (MEALS, ANNOUNCEMENTS),
    "announced_before_min": (MEALS_ANNOUNCED, MEALS, ANNOUNCEMENTS, AHEAD),
    "meal_model": (MEALS,),
    "start_min": (TIME_OF_DAY,),
    "rhythm_seed": (RHYTHMS,),
    "rhythm_person": (RHYTHMS,),
}
"""Settings of a scenario without which it can be the same, with what each needs to have an effect."""


def closed_loop(
    patient: Patient,
    controller: Controller,
    sensor: Sensor | None = None,
    pump: Pump | None = None,
    scenario: Scenario | None = None,
    key: jax.Array | int = 0,
    *,
    integrator: Integrator | None = None,
    forecasts: bool = False,
) -> Trace:
    """Simulate as `simulate` does, of arguments that were checked before."""
    sensor = IdealSensor() if sensor is None else sensor
    dual = gives_glucagon(controller)
    pump = default_pump(usual_limits(patient), controller) if pump is None else pump
    scenario = Scenario() if scenario is None else scenario
    key = random_key(key)

    counted = sample_grid(scenario.horizon_min, sample_time_of(controller), scenario.start_min, scenario.warm_up_min)
    grid = counted.whole
    minute_inputs = minute_inputs_of(patient, scenario, grid)
    if dual:
        refuse_glucagon(patient)
    if integrator is None:
        integrator = default_integrator(patient, minute_inputs=bool(minute_inputs.names) or dual)
    plant, exogenous = integrator.prepare(patient, scenario.absorbed_by(patient), grid)
    exogenous = dataclasses.replace(exogenous, minute_inputs=minute_inputs)
    start = start_of(patient, scenario)
    rescue = scenario.rescue and scenario.rescue.for_gut(meal_model_of(patient, scenario.meal_model))
    loop = Loop(
        plant=plant,
        controller=controller,
        sensor=sensor,
        pump=pump,
        setpoint_mg_dl=start.setpoint_mg_dl,
        rescue=rescue,
        announced_in_min=None if scenario.announced_in_min is None else jnp.asarray(scenario.announced_in_min, float),
        forecasts=forecasts,
    )
    numbers, fixed = apart(loop)
    try:
        on_grid = on_the_grid(scenario, grid)
        trace: Trace = _run(numbers, fixed, start, exogenous, on_grid, key)
    except (AttributeError, TypeError, ValueError):
        wrong = wrong_with(controller, _first_observation(start, controller, scenario))
        if wrong is None:
            raise
        raise ArgumentTypeError(wrong) from None
    return with_minute_inputs(trace, scenario, on_grid, minute_inputs).after(counted.warm_up)


def with_minute_inputs(trace: Trace, scenario: Scenario, on_grid: OnGrid, minute_inputs: MinuteInputs) -> Trace:
    """A trace with what was announced, and the exercise of its scenario."""
    announced_g = jnp.asarray(on_grid.announced_g) if scenario.announced else None
    exercise = None if minute_inputs.exercise_pct is None else jnp.mean(jnp.asarray(minute_inputs.exercise_pct), axis=1)
    return dataclasses.replace(trace, announced_carbs_g=announced_g, exercise_pct=exercise)


def _first_observation(start: Start, controller: Controller, scenario: Scenario) -> Observation:
    zero = jnp.zeros(())
    return Observation(
        glucose_mg_dl=start.setpoint_mg_dl,
        valid=jnp.ones((), bool),
        setpoint_mg_dl=start.setpoint_mg_dl,
        delivered_mU_min=start.insulin_mU_min,
        announced_carbs_g=zero,
        delivered_bolus_mU=zero if gives_boluses(controller) else None,
        time_of_day_min=None if scenario.start_min is None else jnp.asarray(scenario.start_min, float),
        announced_in_min=None if scenario.announced_in_min is None else zero,
        key=jax.random.key(0) if draws(controller) else None,
    )
