"""What the figure and the table of a bound show, and that they can be read."""

import dataclasses

import numpy as np
import pytest
from rich.console import Console

from glucoloop.bounds import HedgedDoses, OptimalDoses
from glucoloop.meals import Meal
from glucoloop.situations.situation import configured
from glucoloop.studies.bound import BoundRequest, study
from glucoloop.studies.bound.study import _plot_bound


def plan(size, **more):
    fine = np.arange(101.0)
    return OptimalDoses(
        t_min=np.arange(0.0, 100.0, 5.0),
        insulin_mU_min=25.0 + size * np.sin(np.arange(20.0)),
        fine_t_min=fine,
        glucose_mg_dl=81.1 + size * np.sin(fine / 20.0),
        setpoint_mg_dl=81.1,
        basal_insulin_mU_min=25.6,
        known_after_min=10.0,
        objective="deviation",
        bound=size,
        deviation_mg_dl=size,
        undershoot_mg_dl=size / 2.0,
        peak_mg_dl=81.1 + size,
        settling_min=33.0,
        settled=False,
        converged=True,
        iterations=9,
        optimality=0.0,
    )


@pytest.fixture
def plans():
    return {"known at once": plan(0.5), "known $late$": dataclasses.replace(plan(3.0), converged=False)}


@pytest.fixture
def hedged():
    def told(after_min, size):
        return HedgedDoses(
            question="begins",
            error=0.05,
            distinguished_after_min=after_min,
            deviation_mg_dl=1.5 * size,
            meal=dataclasses.replace(plan(size), fine_t_min=np.arange(101.0) / 2.0, t_min=np.arange(0.0, 50.0, 2.5)),
            other=plan(1.5 * size),
        )

    return {"told, error 5%": told(30.0, 4.0), "never told": told(np.inf, 5.0)}


def texts(figure):
    from matplotlib.text import Text

    return [text for text in figure.findobj(Text) if text.get_visible() and text.get_text().strip()]


def test_plans_stand_over_each_other(plans):
    figure = _plot_bound(plans, [Meal(50.0, 20.0)])
    above, below = figure.axes
    for of in plans.values():
        assert any(np.array_equal(line.get_ydata(), of.glucose_mg_dl) for line in above.lines)
        assert any(np.array_equal(line.get_ydata()[:-1], of.insulin_mU_min) for line in below.lines)
    assert {"50 g", "setpoint 81.1 mg/dl", "basal 25.6 mU/min"} <= {text.get_text() for text in texts(figure)}


def test_plans_for_two_worlds_end_where_they_are_followed_to(plans, hedged):
    above, below = _plot_bound(study._Bounds(plans, hedged).curves).axes
    for of in hedged.values():
        assert any(np.array_equal(line.get_ydata(), of.meal.glucose_mg_dl) for line in above.lines)
        [line] = [line for line in below.lines if np.array_equal(line.get_ydata()[:-1], of.meal.insulin_mU_min)]
        assert line.get_xdata()[-1] == 50.0
    assert above.get_xlim()[1] == 100.0


@pytest.mark.parametrize("noise", [False, True])
def test_nothing_is_clipped(plans, hedged, noise):
    curves = study._Bounds(plans, hedged if noise else {}).curves
    figure = _plot_bound(curves, [Meal(50.0, 20.0)], title="Bound $x$")
    figure.draw_without_rendering()
    drawn = figure.get_tightbbox()
    assert drawn.x0 >= 0.0
    assert drawn.y0 >= 0.0
    assert drawn.x1 <= figure.get_figwidth()
    assert drawn.y1 <= figure.get_figheight()
    assert all(text.get_fontsize() >= 7.0 for text in texts(figure))


def test_table(plans, hedged, monkeypatch):
    monkeypatch.setattr(study, "_bounds", lambda *_: study._Bounds(plans, hedged))
    asked = configured(BoundRequest)
    console = Console(width=200, record=True)
    with console.capture() as captured:
        console.print(*study.tables(asked, study.results_of(asked, print)))
    lines = captured.get().splitlines()

    def row(start):
        return next(line for line in lines if line.strip().startswith(start)).split()

    assert row("known at once")[3:] == ["0.50", "0.25", "81.60", "33+", "10"]
    assert "(not converged)" in " ".join(row("known $late$"))
    assert row("told, error 5%")[3:] == ["6.00", "2.00", "85.10", "30"]
    assert row("never told")[2:] == ["7.50", "2.50", "86.10", "never"]
