"""Insulin on board of oref0: the numbers of the npm package, and its own curve as an integral."""

import numpy as np
import pytest
from scipy.integrate import quad

from glucoloop.control.oref0.inputs import SAMPLE_MIN, TICKS, exercise_share, insulin_curve, iob_total, treatments
from glucoloop.control.oref0.records import DosingProfile
from oref0_package import answers_of, as_written, needs_oref0

AHEAD = SAMPLE_MIN * np.arange(TICKS)
CURVES = [(dia, kind, peak) for dia in (5.0, 6.5, 8.0) for kind, peak in (("rapid-acting", 75), ("ultra-rapid", 55))]
COUNT = 50


def total(insulin, basal, dia, peak):
    given = as_written(lambda u, b: iob_total(u, b, np.zeros(u.shape[1]), dia_h=dia, peak_min=peak))
    return given(insulin, basal)


def drawn(dia, seed):
    """Insulin of the samples of 50 people, of which a part had boluses, and their basal rates [U/h]."""
    rng = np.random.default_rng(seed)
    shape = (treatments(dia), COUNT)
    basal = np.round(rng.uniform(0.1, 2.5, COUNT), 2)
    temps = np.repeat(rng.uniform(-1.0, 3.0, shape)[::6], 6, axis=0)[: shape[0]] * basal * SAMPLE_MIN / 60.0
    boluses = np.where(rng.random(shape) < 0.05, rng.uniform(0.1, 8.0, shape), 0.0)
    return np.round(temps + boluses, 4), basal


@pytest.mark.long
@needs_oref0
@pytest.mark.parametrize(("dia", "kind", "peak"), CURVES)
def test_insulin_on_board_and_activity_are_those_of_the_package(dia, kind, peak):
    insulin, basal = drawn(dia, seed=round(dia * 10) + peak)
    found = total(insulin, basal, dia, float(peak))
    calls, missing = [], []
    for i in range(COUNT):
        given = [[SAMPLE_MIN * k, u] for k, u in enumerate(insulin[:, i].tolist()) if u != 0.0]
        profile = {"dia": dia, "curve": kind}
        calls.append({"treatments": given, "profile": profile, "ahead": AHEAD.tolist()})
        without = [[-int(t), -basal[i] * SAMPLE_MIN / 60.0] for t in AHEAD]
        missing.append({"treatments": [*given, *without], "profile": profile, "ahead": AHEAD.tolist()})
    iob, activity = np.moveaxis(np.asarray(answers_of("iob", calls)), -1, 0)
    np.testing.assert_array_equal(found.iob_U, iob[:, 0])
    np.testing.assert_array_equal(found.ahead_U_min, activity.T)
    np.testing.assert_array_equal(found.activity_U_min, activity[:, 0])
    zero_temp = np.asarray(answers_of("iob", missing))[..., 1]
    np.testing.assert_array_equal(found.zero_temp_ahead_U_min, zero_temp.T)


@needs_oref0
@pytest.mark.parametrize(("target", "half"), [(None, 160.0), (104.0, 160.0), (110.0, 140.0), (150.0, 160.0)])
def test_a_history_of_temporary_rates_counts_as_in_the_package_but_for_its_pulses(target, half):
    """The package gives 0.05 U at a time and forgets what is less, for each half hour of a temporary rate."""
    dia, basal, rng = 6.0, 1.1, np.random.default_rng(5)
    rates = np.round(rng.uniform(0.0, 4.0, 12) * 20.0) / 20.0
    temps = [[30.0 * (12 - i), rate, 30.0] for i, rate in enumerate(rates.tolist())]
    boluses = [[45.0, 3.2], [180.0, 1.5]]
    profile = {"dia": dia, "curve": "rapid-acting", "current_basal": basal, "basalprofile": [], "min_bg": 100}
    if target is not None:
        profile |= {"min_bg": target, "max_bg": target, "temptargetSet": True, "exercise_mode": True}
        profile["half_basal_exercise_target"] = half
    (ticks,) = answers_of("history", [{"temps": temps, "boluses": boluses, "profile": profile}])
    ours = DosingProfile(
        current_basal_U_h=basal,
        max_daily_basal_U_h=basal,
        max_basal_U_h=4.0,
        sens_mg_dl_U=40.0,
        carb_ratio_g_U=10.0,
        min_bg_mg_dl=target or 100.0,
        max_bg_mg_dl=target or 100.0,
        temptarget_set=target is not None,
        exercise_mode=target is not None,
        half_basal_exercise_target_mg_dl=half,
    )
    counted = basal * float(exercise_share(ours))
    insulin = np.zeros((treatments(dia), 1))
    for i, rate in enumerate(rates):
        first = 6 * (12 - i)  # samples ago at which the rate began
        insulin[first - 5 : first + 1, 0] += (rate - counted) * SAMPLE_MIN / 60.0 if first < len(insulin) else 0.0
    for ago, bolus in boluses:
        insulin[round(ago / SAMPLE_MIN), 0] += bolus
    found = total(insulin, np.array([counted]), dia, 75.0)
    theirs = np.asarray(ticks)
    assert abs(found.iob_U[0] - theirs[0, 0]) < 12 * 0.05
    np.testing.assert_allclose(found.ahead_U_min[:, 0], theirs[:, 1], atol=12 * 0.05 * 0.006)
    np.testing.assert_allclose(found.zero_temp_ahead_U_min[:, 0], theirs[:, 2], atol=20 * 0.05 * 0.006)


@needs_oref0
def test_in_exercise_mode_one_long_rate_has_as_many_pulses_as_in_the_package():
    """A rate of 30 min at a target is whole pulses of 0.05 U, so that insulin on board is the package's to a digit."""
    of, rng = {"dia": 6.0, "curve": "rapid-acting", "basalprofile": []}, np.random.default_rng(9)
    for target in (105.0, 120.0, 140.0, 160.0, 200.0):
        half, basal = float(rng.choice([140.0, 160.0, 180.0])), 2.0
        share = (half - 100.0) / (half - 100.0 + target - 100.0)
        profile = of | {"current_basal": basal, "min_bg": target, "max_bg": target, "temptargetSet": True}
        profile |= {"exercise_mode": True, "half_basal_exercise_target": half}
        (ticks,) = answers_of("history", [{"temps": [[30.0, 6.0, 30.0]], "boluses": [], "profile": profile}])
        pulses = round((6.0 - basal * share) * 0.5 / 0.05)
        given = [[30.0 * (1.0 - j / pulses), 0.05] for j in range(pulses)]
        (expected,) = answers_of("iob", [{"treatments": given, "profile": of, "ahead": [0.0]}])
        assert ticks[0][0] == pytest.approx(expected[0][0], abs=1e-3)
        ours = DosingProfile(
            **dict.fromkeys(("current_basal_U_h", "max_daily_basal_U_h", "max_basal_U_h"), basal),
            sens_mg_dl_U=40.0,
            carb_ratio_g_U=10.0,
            min_bg_mg_dl=target,
            max_bg_mg_dl=target,
            temptarget_set=True,
            exercise_mode=True,
            half_basal_exercise_target_mg_dl=half,
        )
        assert float(exercise_share(ours)) == pytest.approx(share, rel=1e-12)


@pytest.mark.parametrize(("dia", "kind", "peak"), CURVES)
def test_activity_is_what_leaves_insulin_on_board_and_peaks_where_it_is_said(dia, kind, peak):
    del kind
    minutes = np.linspace(0.0, 60.0 * dia, 241)
    on_board, activity = insulin_curve(minutes, dia, float(peak))
    assert on_board[0] == pytest.approx(1.0)
    assert on_board[-1] == activity[-1] == 0.0

    def rate(t):
        return insulin_curve(np.asarray(t), dia, float(peak))[1]

    for t, left in zip(minutes[::40], on_board[::40], strict=True):
        assert 1.0 - quad(rate, 0.0, t)[0] == pytest.approx(left, abs=1e-8)
    fine = np.linspace(1.0, 200.0, 1991)
    assert fine[np.argmax(insulin_curve(fine, dia, float(peak))[1])] == pytest.approx(peak, abs=0.1)
