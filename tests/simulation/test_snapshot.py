"""A snapshot is read to the bit, and one that was made by somebody else is refused in a sentence."""

import hashlib
import json

import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from glucoloop import Refusal
from glucoloop.snapshot import pack, unpack

STATE = {"a": jnp.arange(3.0), "b": jnp.asarray(7)}
WHOLE = pack(STATE, "me")


def sealed(header, rest=b"\0" * 32):
    """A snapshot with a right digest, as anybody can make it."""
    text = header if isinstance(header, bytes) else json.dumps(header).encode()
    data = b"glucoloop snapshot 1\n" + text + b"\n" + rest
    return data + hashlib.sha256(data).digest()


def test_a_state_comes_back():
    found = unpack(WHOLE, STATE, "me")
    np.testing.assert_array_equal(found["a"], STATE["a"])


ARRAYS = [["<f8", [3]], ["<i8", []]]


@pytest.mark.parametrize(
    "header",
    [
        b"[",
        b"[]",
        b"\xff",
        {},
        {"of": "me"},
        {"of": 1, "arrays": ARRAYS},
        {"of": "me", "arrays": 1},
        {"of": "me", "arrays": [1, 2]},
        {"of": "me", "arrays": [["<f8"], ["<i8", []]]},
        *({"of": "me", "arrays": [["<f8", shape], ["<i8", []]]} for shape in ([-1], ["3"], [2**62], [4], 3, [1.5])),
        {"of": "me", "arrays": [["<U99999999", [3]], ["<i8", []]]},
        {"of": "me", "arrays": [[[], [3]], ["<i8", []]]},
    ],
)
def test_a_header_that_is_none_is_refused(header):
    with pytest.raises(Refusal):
        unpack(sealed(header), STATE, "me")


@given(st.lists(st.tuples(st.integers(0, len(WHOLE) - 33), st.integers(0, 255)), max_size=3))
@settings(max_examples=100, deadline=None)
def test_other_bytes_with_a_right_digest_are_read_or_refused(changes):
    data = bytearray(WHOLE[:-32])
    for place, byte in changes:
        data[place] = byte
    try:
        unpack(bytes(data) + hashlib.sha256(data).digest(), STATE, "me")
    except Refusal as error:
        told = str(error)
    else:
        told = ""
    assert told.isprintable()
