"""JSON without NaN."""

import json

from glucoloop.storage.files import json_text


def test_what_is_not_finite_is_null():
    value = {"a": float("nan"), "b": [float("inf"), 1.5, (float("-inf"), "x")], "c": {"d": None, 3: True}}
    assert json.loads(json_text(value)) == {"a": None, "b": [None, 1.5, [None, "x"]], "c": {"d": None, "3": True}}
