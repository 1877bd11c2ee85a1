"""Files of glucoloop's own and of its users that were damaged are read or refused by each command that reads them."""

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from glucoloop.situations.run import Run
from glucoloop.situations.situation import configured
from glucoloop.situations.toml import toml_text
from glucoloop.studies.run import Comparison
from glucoloop.text import is_printable
from glucoloop.trials.trial import Trial

PEOPLE_CSV = """name,weight_kg,S_IT,carb_ratio_g_U,meals
anna,61,40e-4,9.5,45g@7h 60g@12h
ben,82,50e-4,,80g@12h/20min
"""
PEOPLE_TOML = """draw = "with-replacement"

[[person]]
name = "anna"
weight_kg = 61
S_IT = 40e-4
meals = ["45g@7h"]

[[vary]]
parameter = "EGP_0"
distribution = "uniform"
spread_pct = 10

[[joint]]
parameters = ["k_e", "V_I"]
covariance = [[0.04, 0.01], [0.01, 0.01]]
scale = "log"
"""
PIECES = [
    b"nan", b"inf", b"-1", b"1e999", b"9" * 400, b"\x1b[2J", b"\xe2\x80\xae", b"\xff", b"\x00", b"", b"[" * 200, b"{",
    b'"', b"\n", b",", b"=", b"true", b"[]", b"{a=1}", b"1979-05-27", b"'", b"anna", b"0x10", b"-0", b"1e-320",
]  # fmt: skip
"""What stands in the place of a piece of a file."""


@st.composite
def damaged(draw, whole):
    """A copy in which a few pieces were replaced, or the end is missing."""
    data = bytearray(whole.encode())
    for _ in range(draw(st.integers(1, 3))):
        at, size = draw(st.integers(0, len(data))), draw(st.sampled_from([0, 1, 1, 4, 12]))
        data[at : at + size] = draw(st.sampled_from(PIECES) | st.binary(min_size=1, max_size=2))
    return bytes(data[: draw(st.integers(0, len(data)))] if draw(st.booleans()) and draw(st.booleans()) else data)


def whole(request, command):
    return toml_text(request.tree(whole=True), command, request.tree())


CONFIGURATIONS = {
    "run": lambda: configured(Run, {"patient": "hovorka-2004", "meals": ["50g@1h"], "sensor": ["lag, lag_min=8"]}),
    "compare": lambda: configured(Comparison, {"controller": ["pid", "mpc, move_horizon=2"], "faults": ["missing"]}),
    "trial": lambda: configured(Trial, {"people": 3, "controller": ["pid"], "scenario": "week, days=2"}),
}


@pytest.fixture(scope="module")
def place(tmp_path_factory):
    return tmp_path_factory.mktemp("damaged")


def assert_shown_in_plain_text(answer):
    assert all(map(is_printable, (answer.out + answer.err).split("\n"))), answer


@pytest.mark.long
@pytest.mark.parametrize("command", CONFIGURATIONS)
def test_configurations(asked, place, command):
    text, file = whole(CONFIGURATIONS[command](), command), place / f"{command}.toml"
    file.write_text(text)
    assert asked(command, "--config", str(file), "--out", "out").code == 130

    @settings(max_examples=60)
    @given(damaged(text))
    def harmless(data):
        file.write_bytes(data)
        assert_shown_in_plain_text(asked(command, "--config", str(file), "--out", "out"))

    harmless()


@pytest.mark.long
@pytest.mark.parametrize("name", ["people.csv", "people.toml"])
def test_tables_of_people(asked, place, name):
    file, text = place / name, PEOPLE_CSV if name.endswith("csv") else PEOPLE_TOML
    arguments = (
        "--patient",
        "hovorka-2004",
        "--population",
        str(file),
        "--meal",
        "own",
        "--controller",
        "pid",
        "--out",
        "out",
    )
    file.write_text(text)
    assert asked("trial", *arguments).code == 130

    @settings(max_examples=60)
    @given(damaged(text))
    def harmless(data):
        file.write_bytes(data)
        assert_shown_in_plain_text(asked("trial", *arguments))

    harmless()
