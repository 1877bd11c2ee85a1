"""Values of a file are of the form that is declared, or refused with their place."""

import json
from dataclasses import dataclass
from typing import Annotated, Any, Literal

import pytest
from hypothesis import given
from hypothesis import strategies as st

from glucoloop import Refusal
from glucoloop.schema.values import ValueBounds, checked, json_value


@dataclass(frozen=True)
class Inner:
    texts: tuple[str, ...]
    share: Annotated[float, ValueBounds(at_least=0.0, at_most=1.0)] | None = None


@dataclass(frozen=True)
class Form:
    kind: Literal["a", "b"]
    count: Annotated[int, ValueBounds(at_least=1)]
    inner: Inner
    curve: Annotated[list[float], ValueBounds(shortest=1, longest=3)]
    table: dict[str, bool]
    anything: Any = None

    def __post_init__(self):
        if len(self.curve) > self.count:
            raise Refusal("a curve longer than its count")


GOOD = {"kind": "a", "count": 3, "inner": {"texts": ["x"]}, "curve": [1, 2.5], "table": {"yes": True}}


def test_a_right_file_is_read():
    found = checked(Form, GOOD)
    assert found == Form("a", 3, Inner(("x",)), [1.0, 2.5], {"yes": True})
    assert type(found.curve[0]) is float


@pytest.mark.parametrize(
    ("changed", "told"),
    [
        ({"kind": "c"}, "kind is 'c'; it should be 'a' or 'b'"),
        ({"count": 0}, "count is 0; it should be at least 1"),
        ({"count": True}, "count is True; it should be a whole number"),
        ({"count": 2.0}, "count is 2; it should be a whole number"),
        ({"count": 2**63}, "it should be a whole number"),
        ({"inner": []}, r"inner is \[\]; it should be an object"),
        ({"inner": {}}, r"inner\.texts is missing"),
        ({"inner": {"texts": [1]}}, r"inner\.texts\.0 is 1; it should be a text"),
        ({"inner": {"texts": ["\x1b[2J"]}}, r"inner\.texts\.0 is '\\x1b\[2J'; it should have no control characters"),
        ({"inner": {"texts": ["\ud800"]}}, "no control characters"),
        ({"inner": {"texts": [], "share": 1.5}}, r"inner\.share is 1\.5; it should be at least 0 and at most 1"),
        ({"curve": []}, "curve has 0 items; it should have at least 1 and at most 3"),
        ({"curve": [1.0, "x"]}, r"curve\.1 is 'x'; it should be a finite number"),
        ({"curve": [1.0, 1e999]}, r"curve\.1 is inf"),
        ({"curve": [1.0, None]}, r"curve\.1 is None"),
        ({"table": {"no": 0}}, r"table\.no is 0; it should be true or false"),
        ({"table": {"\x9b": True}}, "a key of table"),
        ({"count": 1, "curve": [1.0, 2.0]}, "a curve longer than its count"),
        ({"more\x1b": 1}, r"'more\\x1b' is not a known key; leave it out"),
        ({"anything": {"deep": json.loads("[" * 40 + "]" * 40)}}, "nested more than 10 times"),
        ({"anything": ["\ud800"]}, r"anything\.0 .* no halves of characters"),
        ({"anything": {"a": [float("inf")]}}, r"anything\.a\.0 is inf"),
    ],
)
def test_a_wrong_value_is_refused_with_its_place(changed, told):
    with pytest.raises(Refusal, match=told) as refused:
        checked(Form, {**GOOD, **changed})
    assert str(refused.value).isprintable()


@pytest.mark.parametrize(
    "text", ["", "[", '{"a": NaN}', '{"a": -Infinity}', '{"a": 1, "a": 2}', "[" * 100_000, b"\xff", "9" * 5000]
)
def test_what_is_no_json_is_refused(text):
    with pytest.raises(Refusal):
        json_value(text)


JSON = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=4),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=3), inner, max_size=3),
)


@pytest.mark.long
@given(st.sampled_from([*GOOD, "anything"]), JSON)
def test_any_value_is_read_as_it_is_or_refused(key, value):
    try:
        found = checked(Form, {**GOOD, key: value})
    except Refusal:
        return
    if key not in ("inner", "curve"):
        assert getattr(found, key) == value
