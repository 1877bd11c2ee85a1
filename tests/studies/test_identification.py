"""Sentences of an identified model."""

from types import SimpleNamespace

import numpy as np

from glucoloop.studies.identification.study import _about_meals


def test_a_response_to_meals_that_never_rises_is_said_to():
    record = SimpleNamespace(carbs_g=np.array([0.0, 50.0]), sample_time_min=5.0)

    def sentence(*response):
        return next(_about_meals(record, SimpleNamespace(meal_impulse_response=np.array(response))))

    assert sentence(0.0, 0.0).endswith("to insulin; a gram never raises glucose.")
    assert sentence(-1.0, -2.0).endswith("a gram never raises glucose.")
    assert sentence(1.0, 2.0).endswith("a gram raises glucose by 2 mg/dl at most, 10 min later.")
