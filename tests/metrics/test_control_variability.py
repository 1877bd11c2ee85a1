"""The control-variability grid: who stands where, on its limits and beyond it."""

import numpy as np
import pytest

from glucoloop.metrics.control_variability import (
    MAXIMUM_EDGES_MG_DL,
    MINIMUM_EDGES_MG_DL,
    ZONES,
    grid_counts,
    region_pct,
    zone_pct,
    zones,
)


@pytest.mark.parametrize(
    ("minimum", "maximum", "zone"),
    [
        (100.0, 150.0, "A"),
        (100.0, 250.0, "B"),  # upper
        (80.0, 250.0, "B"),
        (80.0, 150.0, "B"),  # lower
        (100.0, 350.0, "C"),  # upper
        (60.0, 150.0, "C"),  # lower
        (80.0, 350.0, "D"),  # upper
        (60.0, 250.0, "D"),  # lower
        (60.0, 350.0, "E"),
        (20.0, 900.0, "E"),
        (120.0, 105.0, "A"),
        (90.0, 179.999, "A"),
        (89.999, 180.0, "B"),
        (70.0, 300.0, "D"),
        (np.nan, 150.0, ""),
        (80.0, np.inf, ""),
    ],
)
def test_the_zones_are_those_of_the_nine_regions(minimum, maximum, zone):
    assert zones([minimum], [maximum]).tolist() == [zone]
    counts = grid_counts([minimum], [maximum])
    assert counts.sum() == (zone != "")
    if zone:
        assert zone_pct(counts) == {name: 100.0 * (name == zone) for name in ZONES}


def test_counts_agree_with_a_two_dimensional_histogram():
    rng = np.random.default_rng(5)
    minimum, maximum = rng.uniform(30.0, 130.0, 5000), rng.uniform(90.0, 500.0, 5000)
    counted, _, _ = np.histogram2d(
        np.clip(minimum, 50.0, 110.0),
        np.clip(maximum, 110.0, 400.0),
        [MINIMUM_EDGES_MG_DL, MAXIMUM_EDGES_MG_DL],
    )
    np.testing.assert_array_equal(grid_counts(minimum, maximum), counted)


def test_counts_of_parts_add_up_and_give_the_zones_of_the_people():
    rng = np.random.default_rng(6)
    minimum, maximum = rng.normal(80.0, 15.0, 3000), rng.normal(200.0, 80.0, 3000)
    whole = grid_counts(minimum, maximum)
    np.testing.assert_array_equal(
        whole, grid_counts(minimum[:700], maximum[:700]) + grid_counts(minimum[700:], maximum[700:])
    )
    of_people = zones(minimum, maximum)
    for zone, share in zone_pct(whole).items():
        assert share == pytest.approx(100.0 * np.mean(of_people == zone))
    regions = region_pct(whole)
    assert sum(regions.values()) == pytest.approx(100.0)
    assert regions["lower B"] == pytest.approx(
        100.0 * np.mean((minimum >= 70.0) & (minimum < 90.0) & (maximum < 180.0))
    )


def test_nobody_is_in_no_zone():
    counts = grid_counts([], [])
    assert counts.shape == (60, 60)
    assert all(np.isnan(share) for share in zone_pct(counts).values())


def test_a_maximum_without_a_minimum_is_refused():
    with pytest.raises(ValueError, match="one of each per person"):
        grid_counts([80.0, 90.0], [120.0])


def test_counts_of_another_shape_are_refused():
    with pytest.raises(ValueError, match=r"shape \(3, 3\).*grid_counts"):
        zone_pct(np.ones((3, 3)))
