"""Records of a glucose monitor for tests: generated, with gaps, and with many readings on the bounds of ranges."""

import numpy as np

EDGES_MG_DL = (53.0, 54.0, 55.0, 62.0, 63.0, 69.0, 70.0, 71.0, 140.0, 141.0, 180.0, 181.0, 250.0, 251.0)


def on_edges(days, seed):
    """Readings every 5 min that stay at a value on or beside a bound for up to an hour; no gaps."""
    rng = np.random.default_rng(seed)
    steps = rng.integers(1, 13, 288 * days)
    glucose = np.repeat(rng.choice(EDGES_MG_DL, steps.size), steps)[: 288 * days]
    return 5.0 * np.arange(glucose.size), glucose


def with_gaps(days, seed, interval_min=5.0):
    """A course over days with meals, noise and gaps, some short and some of hours."""
    rng = np.random.default_rng(seed)
    t_min = interval_min * np.arange(int(1440 * days / interval_min))
    meals = sum(70.0 * rng.uniform(0.4, 1.4) * np.exp(-(((t_min - at) / 70.0) ** 2)) for at in _meals(days, rng))
    glucose = np.round(
        np.clip(115.0 + meals + 18.0 * np.sin(t_min / 371.0) + 4.0 * rng.normal(size=t_min.size), 40, 400)
    )
    there = rng.random(t_min.size) > 0.03
    for begin in rng.uniform(0.0, t_min[-1], 2 * days):
        there &= (t_min < begin) | (t_min > begin + rng.choice([20.0, 50.0, 200.0]))
    return t_min[there], glucose[there]


def _meals(days, rng):
    return [1440.0 * day + at + 30.0 * rng.normal() for day in range(days) for at in (480.0, 780.0, 1140.0)]
