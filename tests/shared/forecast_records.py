"""Records of readings, insulin and carbohydrate for forecasts: by hand, and drawn from the model of the filter."""

import datetime as dt

import numpy as np
import polars as pl

from glucoloop.forecasts.grid import SAMPLES_PER_DAY, GriddedRecord, UsualDay
from glucoloop.forecasts.kalman import FittedKalman, unexplained_system
from glucoloop.records import DeviceRecord
from glucoloop.records.record import SCHEMA

PARAMETERS = np.array([120.0, 50.0, 30.0, 10.0, 0.5, 15.0, 800.0, 2.0])
COEFFICIENTS = np.array([-25.0, 3.0, 150.0, 10.0, -5.0, 4.0, 2.0, 1.0, -2.0, 0.5, 1.0, 0.0])


def gridded(readings, *, basal_U=None, bolus_U=None, carbs_g=None, automatic_U=None):
    """A record of whole days from its arrays; what is not given is 0."""
    readings = np.asarray(readings, float)
    zeros = np.zeros(readings.size)
    return GriddedRecord(
        first=dt.datetime(2026, 3, 2),
        reading_mg_dl=readings,
        basal_U=zeros if basal_U is None else basal_U,
        user_bolus_U=zeros if bolus_U is None else bolus_U,
        automatic_bolus_U=zeros if automatic_U is None else automatic_U,
        carbs_g=zeros if carbs_g is None else carbs_g,
        basal_off_schedule_pct=0.0,
    )


def device_record(record):
    """The record as a device would have it, at the ends of the samples."""
    readings = np.clip(record.reading_mg_dl, 40.0, 400.0)
    rows = {"glucose_mg_dl": readings, "bolus_U": record.user_bolus_U, "carbs_g": record.carbs_g}
    times = [record.first + dt.timedelta(minutes=5.0 * (sample + 1.0)) for sample in range(record.reading_mg_dl.size)]
    columns = {name: pl.Series([None if not value > 0.0 else value for value in of]) for name, of in rows.items()}
    frame = pl.DataFrame({"time": times, **columns, "basal_U_h": 12.0 * record.basal_U})
    missing = (pl.lit(None).alias(name) for name in SCHEMA if name not in frame.columns)
    frame = frame.with_columns(missing).select(pl.col(name).cast(kind) for name, kind in SCHEMA.items())
    return DeviceRecord(frame=frame, rows=frame.height)


def own_model(parameters=PARAMETERS, coefficients=COEFFICIENTS):
    """The filter with parameters that are known, and no usual insulin or meals."""
    nothing = np.zeros(SAMPLES_PER_DAY)
    return FittedKalman(parameters, coefficients, UsualDay(nothing, nothing, nothing, nothing))


def drawn_record(days, seed, *, missing=0.03):
    """A record drawn from the model of the filter, with three meals and boluses a day at times that differ."""
    random = np.random.default_rng(seed)
    samples = days * SAMPLES_PER_DAY
    bolus_U, carbs_g = np.zeros((2, samples))
    for day in range(days):
        for hour in (7, 13, 19):
            at = day * SAMPLES_PER_DAY + 12 * hour + int(random.integers(-12, 13))
            carbs_g[at] = random.uniform(20.0, 90.0)
            bolus_U[at] = carbs_g[at] / 10.0 * random.uniform(0.6, 1.4)
    basal_U = np.full(samples, 1.0 / 12.0)
    inputs = gridded(np.zeros(samples), basal_U=basal_U, bolus_U=bolus_U, carbs_g=carbs_g)
    glucose = explained_mg_dl(inputs) + unexplained_mg_dl(samples, random)
    readings = np.where(random.random(samples) < missing, np.nan, glucose)
    return gridded(readings, basal_U=basal_U, bolus_U=bolus_U, carbs_g=carbs_g)


def unexplained_mg_dl(samples, random):
    """The unexplained part of the readings, with their noise."""
    system = unexplained_system(PARAMETERS[None])
    root = np.linalg.cholesky(system.process_noise[0] + 1e-12 * np.eye(4))
    state, values = np.zeros(4), np.empty(samples)
    for sample in range(-SAMPLES_PER_DAY, samples):
        state = system.transition[0] @ state + root @ random.standard_normal(4)
        if sample >= 0:
            values[sample] = system.readout @ state
    return values + np.sqrt(system.reading_variance[0]) * random.standard_normal(samples)


def explained_mg_dl(record, parameters=PARAMETERS, coefficients=COEFFICIENTS, *, step_min=0.5):
    """The explained part of the readings, by a convolution of quadratures of the response of two compartments."""
    glucose_min, insulin_min, carbs_min = parameters[:3]
    samples = record.reading_mg_dl.size
    t_min = np.arange(0.0, 5.0 * samples, step_min)
    total = np.full(samples, coefficients[2])
    for amounts, tau, size in zip(
        (record.insulin_U, record.carbs_g), (insulin_min, carbs_min), coefficients[:2], strict=True
    ):
        flow = t_min / tau**2 * np.exp(-t_min / tau)
        response = _returning(flow, glucose_min, step_min)[:: round(5.0 / step_min)]
        total += size * np.convolve(amounts, response / response.max())[:samples]
    phase = 2.0 * np.pi * (np.arange(samples) % SAMPLES_PER_DAY) / SAMPLES_PER_DAY
    for order in range(1, 5):
        total += coefficients[1 + 2 * order] * np.sin(order * phase) + coefficients[2 + 2 * order] * np.cos(
            order * phase
        )
    return total


def _returning(flow, glucose_min, step_min):
    """Glucose by an inflow and a return to its level, by the trapezoidal rule."""
    glucose, values = 0.0, np.empty(flow.size)
    values[0] = 0.0
    half = 0.5 * step_min / glucose_min
    for place in range(1, flow.size):
        inflow = 0.5 * step_min * (flow[place - 1] + flow[place])
        glucose = ((1.0 - half) * glucose + inflow) / (1.0 + half)
        values[place] = glucose
    return values
