"""The identified model's figures show what the records hold."""

import itertools

import jax.numpy as jnp
import numpy as np
import pytest

from glucoloop.identification import Record, design_csrs, identify_record, random_binary_sequence, validate
from glucoloop.models.step_response import StepResponseModel
from glucoloop.reporting import plot_identification, plot_validation

MEMORY = 24
TRUTH = -0.1 * np.exp(-np.arange(MEMORY) / 6.0)
MODEL = StepResponseModel.from_impulse_response(TRUTH, 5.0)
PULSES = design_csrs(MEMORY, 20.0)
INPUT = random_binary_sequence(60, 2.0, seed=1)


@pytest.fixture(scope="module")
def identified():
    noise = jnp.asarray(np.random.default_rng(0).normal(size=2 * MEMORY + 1))
    record = Record(
        insulin_mU_min=25.0 + PULSES, glucose_mg_dl=80.0 + MODEL.predict(PULSES) + noise, sample_time_min=5.0
    )
    return identify_record(record, memory=MEMORY)


@pytest.fixture(scope="module")
def validation(identified):
    return validate(identified.model, INPUT, MODEL.predict(INPUT))


def drawn(axes):
    return {tuple(np.round(line.get_ydata(), 9)) for line in axes.lines}


def curve(values):
    return tuple(np.round(values, 9))


def legend(figure):
    return [text.get_text() for text in figure.legends[0].get_texts()]


@pytest.mark.long
@pytest.mark.parametrize("width", ["single", "double"])
def test_the_response_is_shown_as_estimated_smoothed_and_true(identified, width):
    figure = plot_identification(identified, truth=TRUTH, width=width)
    (axes,) = figure.axes
    shown = drawn(axes)
    for expected in (identified.impulse_response, identified.smoothed_impulse_response, TRUTH):
        assert curve(np.asarray(expected)) in shown
    assert all(line.get_xdata()[0] == 5.0 for line in axes.lines if len(line.get_xdata()) == MEMORY)
    assert axes.get_ylabel() == "Impulse response (mg/dl per mU/min)"
    assert axes.get_xlabel() == "Time since the dose (min)"
    assert legend(figure) == ["free of noise", "estimated coefficients", "Laguerre projection"]


@pytest.mark.parametrize(("memory", "unit"), [(36, "min"), (144, "min"), (288, "h")])
def test_times_since_the_dose_can_be_read(memory, unit):
    pulses = design_csrs(memory, 20.0)
    response = StepResponseModel.from_impulse_response(-0.1 * np.exp(-np.arange(memory) / 6.0), 5.0)
    record = Record(insulin_mU_min=25.0 + pulses, glucose_mg_dl=80.0 + response.predict(pulses), sample_time_min=5.0)
    figure = plot_identification(identify_record(record, memory=memory))
    figure.canvas.draw()
    axes = figure.axes[0]
    assert axes.get_xlabel() == f"Time since the dose ({unit})"
    boxes = [label.get_window_extent() for label in axes.get_xticklabels()]
    assert 3 < len(boxes) < 16
    assert all(one.x1 < other.x0 for one, other in itertools.pairwise(boxes))


def test_an_estimate_left_as_it_is_has_no_projection():
    record = Record(insulin_mU_min=25.0 + PULSES, glucose_mg_dl=80.0 + MODEL.predict(PULSES), sample_time_min=5.0)
    raw = identify_record(record, memory=MEMORY, laguerre_functions=None)
    assert legend(plot_identification(raw)) == ["estimated coefficients"]


@pytest.mark.long
@pytest.mark.parametrize("width", ["single", "double"])
@pytest.mark.parametrize("insulin", [None, INPUT])
def test_the_validation_may_stand_beside_the_response(identified, validation, width, insulin):
    figure = plot_identification(
        identified, validation=validation, insulin_deviation_mU_min=insulin, title="Both", width=width
    )
    figure.draw_without_rendering()
    assert len(figure.axes) == (3 if insulin is None else 4)
    fit, residuals = figure.axes[1:3]
    measured = np.asarray(validation.predicted_mg_dl + validation.residuals_mg_dl)
    assert {curve(measured), curve(np.asarray(validation.predicted_mg_dl))} <= drawn(fit)
    assert curve(np.asarray(validation.residuals_mg_dl)) in drawn(residuals)
    assert figure.axes[-1].get_xlabel() == "Time (min)"


def test_a_validation_stands_alone_with_its_input(validation):
    figure = plot_validation(validation, sample_time_min=5.0, insulin_deviation_mU_min=INPUT)
    fit, residuals, insulin = figure.axes
    assert "(mg/dl)" in fit.get_ylabel()
    assert "(mg/dl)" in residuals.get_ylabel()
    assert "(mU/min)" in insulin.get_ylabel()
    (steps,) = insulin.lines
    assert steps.get_drawstyle() == "steps-post"
    np.testing.assert_array_equal(steps.get_ydata()[:-1], INPUT)
    assert fit.get_xlim() == (0.0, 300.0)
    assert legend(figure) == ["measured glucose", "predicted glucose"]


@pytest.mark.parametrize("width", ["single", "double"])
def test_panels_do_not_run_into_each_other(identified, validation, width):
    figure = plot_identification(
        identified, truth=TRUTH, validation=validation, insulin_deviation_mU_min=INPUT, width=width
    )
    figure.draw_without_rendering()
    boxes = [axes.yaxis.label.get_window_extent() for axes in figure.axes]
    assert not any(a.overlaps(b) for i, a in enumerate(boxes) for b in boxes[:i])


def test_what_does_not_belong_together_is_refused(identified, validation):
    with pytest.raises(ValueError, match=r"shape \(3,\) cannot stand beside 24 coefficients"):
        plot_identification(identified, truth=np.zeros(3))
    with pytest.raises(ValueError, match="give one value per sample, 60"):
        plot_validation(validation, sample_time_min=5.0, insulin_deviation_mU_min=np.zeros(61))
