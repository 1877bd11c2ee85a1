"""Records of simulated people whose parameters are known: days with meals, boluses by a person's ratio, a sensor."""

import datetime as dt

import numpy as np
import polars as pl

from glucoloop.component.request import configuration_from
from glucoloop.patients.population import population, virtual_people
from glucoloop.records import DeviceRecord
from glucoloop.records.record import SCHEMA
from glucoloop.situations.run import Run
from glucoloop.studies.closed_loop import close_the_loop

FIRST = dt.datetime(2026, 3, 2)


def lived(
    patient,
    people,
    person,
    *,
    days=7,
    sensor=("dexcom-g6",),
    controller="basal-bolus",
    time_spread_min=30.0,
    carb_error_pct=0.0,
    **settings,
):
    """Record of a person of a population, and the true parameters by name; `settings` of the run beside these."""
    run = configuration_from(
        Run,
        {
            "patient": {"name": patient, "person": str(person)},
            "controller": [{"name": controller}],
            "announce_meals": True,
            "days": days,
            "meals": ["45g@7h", "75g@12h", "85g@18.5h", "15g@21h"],
            "meal_size_spread_pct": 25.0,
            "meal_time_spread_min": time_spread_min,
            "carb_error_pct": carb_error_pct,
            "sensor": [{"name": "ideal", "site": "interstitial"}, *({"name": name} for name in sensor)],
            "seed": person,
            "start": "00:00",
            **settings,
        },
    )
    trace = close_the_loop(run, run.case).trace.to_polars()
    drawn = virtual_people(population(people, patient=patient), person, [person]).draw.values
    return record_of(trace), {name: float(value[0]) for name, value in drawn.items()}


def record_of(trace):
    """Record of a trace, as devices would keep it: the announced carbohydrate, not the eaten one."""
    t_min = trace["t_min"].to_numpy()
    bolus_U = trace["bolus_mU"].to_numpy() / 1000.0 if "bolus_mU" in trace.columns else np.zeros(t_min.size)
    carbs = trace["announced_carbs_g" if "announced_carbs_g" in trace.columns else "carbs_g"]
    frame = pl.DataFrame(
        {
            "time": [FIRST + dt.timedelta(minutes=float(t)) for t in t_min],
            "glucose_mg_dl": trace["reading_mg_dl"],
            "carbs_g": carbs,
            "bolus_U": bolus_U,
            "basal_U_h": trace["insulin_mU_min"] * 0.06,
        }
    ).with_columns(
        pl.when(pl.col("carbs_g") > 0).then("carbs_g"),
        pl.when(pl.col("bolus_U") > 0).then("bolus_U"),
    )
    missing = (pl.lit(None).alias(name) for name in SCHEMA if name not in frame.columns)
    frame = frame.with_columns(missing).select(pl.col(name).cast(kind) for name, kind in SCHEMA.items())
    return DeviceRecord(frame=frame, rows=frame.height)
