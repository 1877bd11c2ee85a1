"""Accuracy of readings: zones of the error grid point by point, and the numbers of a run from its readings."""

import jax.numpy as jnp
import numpy as np
import pytest

import glucoloop as gl
from glucoloop.metrics.accuracy import ZONES, clarke_zones
from glucoloop.sensors import SENSORS
from other_programs import answer_of

# Glucose, reading and zone, on both sides of the lines that Clarke et al. draw.
POINTS = [
    *((100, 119, "a"), (100, 121, "b"), (100, 81, "a"), (100, 79, "b"), (60, 50, "a"), (69, 40, "a"), (400, 330, "a")),
    *((100, 209, "b"), (100, 211, "c"), (200, 309, "b"), (200, 311, "c"), (69, 179, "d"), (69, 181, "e")),
    *((170, 55, "c"), (170, 57, "b"), (150, 27, "c"), (150, 29, "b"), (131, 1, "c"), (125, 1, "b")),
    *(
        (239, 179, "b"),
        (241, 179, "d"),
        (241, 181, "b"),
        (300, 71, "d"),
        (300, 69, "e"),
        (181, 69, "e"),
        (179, 71, "b"),
    ),
    *((50, 69, "a"), (50, 71, "d"), (65, 77, "a"), (65, 79, "d"), (71, 84, "a"), (71, 86, "b"), (300, 420, "c")),
]


def test_points_are_in_their_zones():
    glucose, reading, _ = zip(*POINTS, strict=True)
    zones = clarke_zones(jnp.asarray(glucose, float), jnp.asarray(reading, float))
    found = [next(zone for zone in ZONES if zones[zone][i]) for i in range(len(POINTS))]
    assert found == [zone for *_, zone in POINTS]


def test_every_point_is_in_one_zone():
    glucose, reading = jnp.meshgrid(jnp.arange(20.0, 451.0), jnp.arange(20.0, 451.0))
    zones = clarke_zones(glucose, reading)
    assert list(zones) == list(ZONES)
    np.testing.assert_array_equal(sum(within.astype(int) for within in zones.values()), 1)


ZONES_OF_ERROR_GRIDS = """
import numpy as np
from error_grids import clarke_error_zone_detailed
axis = np.arange(*asked)
found = np.vectorize(clarke_error_zone_detailed)(*np.meshgrid(axis, axis))
print(json.dumps(found.tolist()))
"""


@pytest.mark.long
def test_zones_are_those_of_another_program_in_the_whole_plane_that_clarke_draws():
    within = (0.25, 400.0, 1.0)  # between the lines, on which one may count to either side
    zones = np.array(list("abbccddee"))[answer_of("error-grids", ZONES_OF_ERROR_GRIDS, within)]
    axis = np.arange(*within)
    found = clarke_zones(*map(jnp.asarray, np.meshgrid(axis, axis)))
    for zone in ZONES:
        np.testing.assert_array_equal(np.asarray(found[zone]), zones == zone, zone)


@pytest.fixture(scope="module")
def trace():
    sensor = SENSORS.choose("vettoretti-2019, worn_min=0").made(sample_time_min=5.0)
    return gl.simulate(gl.patient(), gl.design_open_loop(), sensor, scenario=gl.Scenario([gl.Meal(50.0, 60.0)]), key=3)


@pytest.mark.long
def test_numbers_of_a_run_are_those_of_its_readings(trace):
    found = gl.summarise(trace, metrics=["sensor-accuracy"])
    there = np.asarray(trace.reading_valid)
    assert there.sum() == there.size - 24  # two hours of warm-up
    glucose, reading = np.asarray(trace.glucose_mg_dl)[there], np.asarray(trace.reading_mg_dl)[there]
    assert float(found.mard_pct) == pytest.approx(100.0 * np.mean(np.abs(reading - glucose) / glucose))
    assert float(found.reading_bias_mg_dl) == pytest.approx(np.mean(reading - glucose))
    zones = clarke_zones(jnp.asarray(glucose), jnp.asarray(reading))
    shares = [float(getattr(found, f"clarke_{zone}_pct")) for zone in ZONES]
    np.testing.assert_allclose(shares, [100.0 * np.mean(np.asarray(zones[zone])) for zone in ZONES])
    assert sum(shares) == pytest.approx(100.0)
    assert float(found.mard_pct) > 1.0


@pytest.mark.long
def test_it_is_computed_where_it_is_asked_for(trace):
    assert "mard_pct" not in gl.summarise(trace).names


@pytest.mark.long
def test_without_a_reading_there_is_no_accuracy():
    sensor = SENSORS.choose("dexcom-g6, worn_min=0, warm_up_min=1d").made(sample_time_min=5.0)
    silent = gl.simulate(gl.patient(), gl.design_open_loop(), sensor, scenario=gl.Scenario(horizon_min=60.0))
    found = gl.summarise(silent, metrics=["sensor-accuracy"])
    assert np.isnan([float(found.mard_pct), float(found.clarke_a_pct)]).all()
