"""Thousands of questions to ``determine_basal``, as glucoloop and as the npm package oref0 have them."""

import jax
import numpy as np

from glucoloop.control.oref0.records import DosingProfile, GlucoseStatus, InsulinOnBoard, MealData, TempBasal

TICKS = 48


def drawn(count, seed):
    """Arguments of ``determine_basal`` by their names in oref0, each ``(count,)`` or ``(48, count)``."""
    rng = np.random.default_rng(seed)
    uniform, normal, chance = rng.uniform, rng.normal, lambda part: rng.random(count) < part
    basal = np.round(uniform(0.1, 3.0, count), 3)
    glucose = np.round(np.where(chance(0.1), uniform(5.0, 60.0, count), uniform(45.0, 350.0, count)), 2)
    glucose = np.where(chance(0.3), np.round(glucose), glucose)
    glucose = np.where(chance(0.01), 38.0, glucose)
    trend = normal(0.0, 6.0, count)
    flat = chance(0.03)
    deltas = [np.where(flat, uniform(-0.9, 0.9, count), trend + normal(0.0, s, count)) for s in (3.0, 2.0, 3.0)]
    delta, short, long = (np.round(np.where(chance(0.3), np.round(d), d), 2) for d in deltas)
    on_board = np.round(normal(1.0, 2.5, count), 3)
    # activity falls from where it is, with some shape
    lasts = np.exp(-np.arange(TICKS)[:, None] * 5.0 / uniform(40.0, 150.0, count))
    bump = 1.0 + uniform(0.0, 1.0, count) * np.sin(np.linspace(0.0, np.pi, TICKS))[:, None]
    activity = np.round(on_board * uniform(0.003, 0.012, count) * lasts * bump, 4)
    less = basal / 12.0 * np.cumsum(np.linspace(0.0, 0.008, TICKS))[:, None]
    eats = chance(0.6)
    carbs = np.where(eats, np.round(uniform(1.0, 150.0, count)), 0.0)
    cob = np.where(eats & chance(0.8), np.minimum(np.round(carbs * uniform(0.0, 1.0, count)), 120.0), 0.0)
    temp_rate = np.where(chance(0.3), 0.0, np.round(basal * uniform(0.0, 4.0, count) * 20.0) / 20.0)
    temp_minutes = np.where(chance(0.3), 0.0, np.round(uniform(1.0, 125.0, count)))
    low = np.round(uniform(80.0, 160.0, count))
    return {
        "glucose": glucose,
        "delta": np.where(flat, 0.0, delta),
        "short_avgdelta": short,
        "long_avgdelta": long,
        "minutes_ago": np.where(chance(0.9), 0.0, np.round(uniform(-8.0, 16.0, count), 1)),
        "temp_rate": np.where(temp_minutes > 0.0, temp_rate, 0.0),
        "temp_minutes": temp_minutes,
        "iob": on_board,
        "activity": activity,
        "zero_activity": np.round(activity - less, 4),
        "last_bolus_age": np.round(uniform(0.0, 12.0, count), 1),
        "carbs": carbs,
        "cob": cob,
        "slope_max": -np.round(np.abs(normal(0.0, 1.0, count)) * chance(0.8), 3),
        "slope_min": np.where(chance(0.1), 999.0, np.round(np.abs(normal(0.0, 1.5, count)) * chance(0.8), 3)),
        "last_carb_age": np.round(uniform(0.0, 360.0, count)),
        "current_basal": basal,
        "max_daily_basal": np.round(basal * uniform(1.0, 1.5, count), 3),
        "max_basal": np.round(uniform(0.5, 8.0, count), 1),
        "sens": np.round(uniform(10.0, 150.0, count), rng.integers(0, 2)),
        "carb_ratio": np.round(uniform(4.0, 30.0, count), 1),
        "min_bg": low,
        "max_bg": low + np.where(chance(0.5), 0.0, np.round(uniform(0.0, 20.0, count))),
        "max_iob": np.round(uniform(0.0, 12.0, count), 1),
        "max_daily_safety_multiplier": np.round(uniform(1.0, 4.0, count), 1),
        "current_basal_safety_multiplier": np.round(uniform(1.0, 6.0, count), 1),
        "enable_uam": chance(0.7),
        "enable_smb_always": chance(0.4),
        "enable_smb_with_cob": chance(0.3),
        "enable_smb_after_carbs": chance(0.3),
        "enable_smb_high_bg": chance(0.3),
        "enable_smb_high_bg_target": np.round(uniform(100.0, 200.0, count)),
        "max_smb_basal_minutes": np.round(uniform(15.0, 120.0, count)),
        "max_uam_smb_basal_minutes": np.round(uniform(15.0, 120.0, count)),
        "smb_interval": np.round(uniform(0.5, 12.0, count), 1),
        "bolus_increment": np.where(chance(0.7), 0.1, 0.05),
        "max_delta_bg_threshold": np.round(uniform(0.05, 0.4, count), 2),
        "remaining_carbs_fraction": np.round(uniform(0.1, 1.2, count), 2),
        "remaining_carbs_cap": np.round(uniform(10.0, 120.0, count)),
        "allowed": chance(0.9),
        "temptarget": chance(0.4),
        "allow_smb_with_high_temptarget": chance(0.5),
        "enable_smb_with_temptarget": chance(0.5),
        "high_temptarget_raises_sensitivity": chance(0.5),
        "low_temptarget_lowers_sensitivity": chance(0.5),
        "half_basal_exercise_target": np.round(uniform(110.0, 200.0, count)),
        "autosens_max": np.round(uniform(1.0, 1.5, count), 2),
        "exercise_mode": chance(0.2),
    }


def arguments(of):
    """The same as the records of glucoloop."""
    profile = DosingProfile(
        current_basal_U_h=of["current_basal"],
        max_daily_basal_U_h=of["max_daily_basal"],
        max_basal_U_h=of["max_basal"],
        sens_mg_dl_U=of["sens"],
        carb_ratio_g_U=of["carb_ratio"],
        min_bg_mg_dl=of["min_bg"],
        max_bg_mg_dl=of["max_bg"],
        max_iob_U=of["max_iob"],
        max_daily_safety_multiplier=of["max_daily_safety_multiplier"],
        current_basal_safety_multiplier=of["current_basal_safety_multiplier"],
        enable_uam=of["enable_uam"],
        enable_smb_always=of["enable_smb_always"],
        enable_smb_with_cob=of["enable_smb_with_cob"],
        enable_smb_after_carbs=of["enable_smb_after_carbs"],
        enable_smb_high_bg=of["enable_smb_high_bg"],
        enable_smb_high_bg_target_mg_dl=of["enable_smb_high_bg_target"],
        max_smb_basal_min=of["max_smb_basal_minutes"],
        max_uam_smb_basal_min=of["max_uam_smb_basal_minutes"],
        smb_interval_min=of["smb_interval"],
        bolus_increment_U=of["bolus_increment"],
        max_delta_bg_threshold=of["max_delta_bg_threshold"],
        remaining_carbs_fraction=of["remaining_carbs_fraction"],
        remaining_carbs_cap_g=of["remaining_carbs_cap"],
        temptarget_set=of["temptarget"],
        allow_smb_with_high_temptarget=of["allow_smb_with_high_temptarget"],
        enable_smb_with_temptarget=of["enable_smb_with_temptarget"],
        high_temptarget_raises_sensitivity=of["high_temptarget_raises_sensitivity"],
        low_temptarget_lowers_sensitivity=of["low_temptarget_lowers_sensitivity"],
        half_basal_exercise_target_mg_dl=of["half_basal_exercise_target"],
        autosens_max=of["autosens_max"],
        exercise_mode=of["exercise_mode"],
    )
    records = (
        GlucoseStatus(
            glucose_mg_dl=of["glucose"],
            delta=of["delta"],
            short_avgdelta=of["short_avgdelta"],
            long_avgdelta=of["long_avgdelta"],
            minutes_ago=of["minutes_ago"],
        ),
        TempBasal(rate_U_h=of["temp_rate"], duration_min=of["temp_minutes"]),
        InsulinOnBoard(
            iob_U=of["iob"],
            activity_U_min=of["activity"][0],
            ahead_U_min=of["activity"],
            zero_temp_ahead_U_min=of["zero_activity"],
            last_bolus_age_min=of["last_bolus_age"],
        ),
        MealData(
            carbs_g=of["carbs"],
            meal_cob_g=of["cob"],
            slope_from_max_deviation=of["slope_max"],
            slope_from_min_deviation=of["slope_min"],
            last_carb_age_min=of["last_carb_age"],
        ),
        profile,
    )
    count = of["glucose"].shape[-1]
    return jax.tree.map(lambda a: np.asarray(a) if np.ndim(a) else np.full(count, a), (records, of["allowed"]))


OF_OREF0 = {
    "current_basal": "current_basal",
    "max_daily_basal": "max_daily_basal",
    "max_basal": "max_basal",
    "sens": "sens",
    "carb_ratio": "carb_ratio",
    "min_bg": "min_bg",
    "max_bg": "max_bg",
    "max_iob": "max_iob",
    "max_daily_safety_multiplier": "max_daily_safety_multiplier",
    "current_basal_safety_multiplier": "current_basal_safety_multiplier",
    "enableUAM": "enable_uam",
    "enableSMB_always": "enable_smb_always",
    "enableSMB_with_COB": "enable_smb_with_cob",
    "enableSMB_after_carbs": "enable_smb_after_carbs",
    "enableSMB_high_bg": "enable_smb_high_bg",
    "enableSMB_high_bg_target": "enable_smb_high_bg_target",
    "maxSMBBasalMinutes": "max_smb_basal_minutes",
    "maxUAMSMBBasalMinutes": "max_uam_smb_basal_minutes",
    "SMBInterval": "smb_interval",
    "bolus_increment": "bolus_increment",
    "maxDelta_bg_threshold": "max_delta_bg_threshold",
    "remainingCarbsFraction": "remaining_carbs_fraction",
    "remainingCarbsCap": "remaining_carbs_cap",
    "temptargetSet": "temptarget",
    "allowSMB_with_high_temptarget": "allow_smb_with_high_temptarget",
    "enableSMB_with_temptarget": "enable_smb_with_temptarget",
    "high_temptarget_raises_sensitivity": "high_temptarget_raises_sensitivity",
    "low_temptarget_lowers_sensitivity": "low_temptarget_lowers_sensitivity",
    "half_basal_exercise_target": "half_basal_exercise_target",
    "autosens_max": "autosens_max",
    "exercise_mode": "exercise_mode",
}


def call(of, i):
    """The same as the package is called."""
    one = {name: np.asarray(value)[..., i].tolist() for name, value in of.items()}
    pairs = zip(one["activity"], one["zero_activity"], strict=True)
    ticks = [{"activity": a, "iobWithZeroTemp": {"activity": z}} for a, z in pairs]
    ticks[0] |= {"iob": one["iob"], "last_bolus_age": one["last_bolus_age"]}
    return {
        "glucose": {n: one[n] for n in ("glucose", "delta", "short_avgdelta", "long_avgdelta", "minutes_ago")},
        "temp": {"rate": one["temp_rate"], "duration": one["temp_minutes"], "temp": "absolute"},
        "iob": ticks,
        "profile": {name: one[ours] for name, ours in OF_OREF0.items()},
        "meal": {
            "carbs": one["carbs"],
            "mealCOB": one["cob"],
            "slopeFromMaxDeviation": one["slope_max"],
            "slopeFromMinDeviation": one["slope_min"],
            "last_carb_age": one["last_carb_age"],
        },
        "allowed": one["allowed"],
    }


def answered(told, answers):
    """Calls in which the dose is another one than that of the package: its number, ours, theirs and their reason."""
    ours = np.asarray([told.sets_temp, told.temp.rate_U_h, told.temp.duration_min, told.units_U]).T
    for i, (mine, theirs) in enumerate(zip(ours.tolist(), answers, strict=True)):
        assert "error" not in theirs, theirs
        sets = "rate" in theirs
        expected = [float(sets), theirs.get("rate"), theirs.get("duration"), theirs.get("units", 0.0)]
        found = [mine[0], *(mine[1:3] if sets else (None, None)), mine[3]]
        if found != expected:
            yield i, found, expected, theirs["reason"]
