"""Reading is total: whatever stands in the place of a value, the outcome is a record or a refusal."""

import copy
import json

import hypothesis.strategies as st
import pytest
from hypothesis import HealthCheck, given, settings

import glucoloop as gl
from device_files import FILES, every, nightscout_entries, nightscout_treatments
from glucoloop.text import is_printable

TEMPORARY = [
    (time, {"eventType": "Temp Basal", "absolute": 0.5, "duration": 30, "percent": -50}) for time in every(6, 10)
]
SWITCHES = [
    (
        time,
        {
            "eventType": "Profile Switch",
            "profile": "Night",
            "duration": 60,
            "percentage": 90,
            "timeshift": 3_600_000,
            "profileJson": '{"basal": [{"time": "00:00", "value": 0.7}], "timezone": "Europe/Berlin"}',
        },
    )
    for time in every(3, 20)
]
MEALS = [(time, {"eventType": "Meal Bolus", "insulin": 2.5, "carbs": 30, "notes": "x"}) for time in every(3, 15)]
PROFILE = [
    {
        "defaultProfile": "Day",
        "startDate": "2024-03-01T00:00:00Z",
        "mills": 1709251200000,
        "store": {
            name: {"timezone": "Europe/Berlin", "basal": [{"time": "06:30", "value": 0.8, "timeAsSeconds": 23400}]}
            for name in ("Day", "Night")
        },
    }
]
SETTINGS = settings(
    max_examples=60, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture, HealthCheck.too_slow]
)
JSON = {
    "entries": [nightscout_entries(8)],
    "treatments and a profile": [nightscout_treatments(*TEMPORARY, *SWITCHES, *MEALS), json.dumps(PROFILE)],
    "tidepool": [json.dumps(json.loads(FILES["tidepool"])[:20])],
}
TEXTS = st.one_of(
    st.text(st.characters(), max_size=6),
    st.sampled_from(
        [
            "\ud800",
            "\udfff\ud800",
            "\x1b[31m",
            "2024-02-30T00:00:00Z",
            "9999-12-31T23:59:59+14:00",
            "0001-01-01T00:00:00Z",
            "1e999",
            "nan",
            "-0",
            "Infinity",
            "\u00b2",
            "24:60",
            "99:99",
            "\u0666:\u0666",
            "Etc/GMT+99",
            "../../etc/passwd",
            "Temp Basal",
            "Profile Switch",
            "Combo Bolus",
            "suspend",
            "[",
            '{"basal": [[]]}',
            "x" * 5000,
        ]
    ),
)
NUMBERS = st.one_of(
    st.integers(),
    st.floats(),
    st.sampled_from([1e300, -1e300, 2**63, -(2**63) - 1, 10**400, 1e14, 253402300800000, -62135596800001, 5e-324]),
)
VALUES = st.recursive(
    st.one_of(st.none(), st.booleans(), NUMBERS, TEXTS),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(TEXTS, inner, max_size=3),
    max_leaves=5,
)


def places_of(value, path=()):
    """Path of each value within a value of JSON."""
    yield path
    inside = value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else ()
    for key, inner in inside:
        yield from places_of(inner, (*path, key))


def with_value(whole, path, value):
    if not path:
        return value
    whole = copy.copy(whole)
    whole[path[0]] = with_value(whole[path[0]], path[1:], value)
    return whole


def read_or_refused(folder, texts, **answers):
    paths = []
    for number, text in enumerate(texts):
        paths.append(folder / f"file-{number}")
        paths[-1].write_bytes(text if isinstance(text, bytes) else text.encode())
    try:
        record = gl.read_record(*paths, **answers)
    except gl.Refusal:
        return
    assert record.rows == record.rows_used + sum(record.left_out.values())
    assert record.frame["time"].is_sorted()
    assert all(map(is_printable, record.notes))
    (folder / "record").write_bytes(record.parquet())
    assert gl.read_record(folder / "record").frame.equals(record.frame)


@pytest.mark.long
@pytest.mark.parametrize("zone", [None, "Europe/Berlin"])
@pytest.mark.parametrize("name", JSON)
@SETTINGS
@given(data=st.data())
def test_any_value_in_the_place_of_any_value(tmp_path, name, zone, data):
    texts = list(JSON[name])
    at = data.draw(st.integers(0, len(texts) - 1))
    whole = json.loads(texts[at])
    places = list(places_of(whole))
    for path in data.draw(st.lists(st.sampled_from(places), min_size=1, max_size=4)):
        try:
            whole = with_value(whole, path, data.draw(VALUES))
        except (TypeError, KeyError, IndexError):  # an earlier one took the place away
            continue
    texts[at] = json.dumps(whole)
    read_or_refused(tmp_path, texts, time_zone=zone)


@pytest.mark.parametrize(
    "damaged",
    [
        '[{"type":"sgv","date":1767225600000,"sgv":100,"device":"\\ud800"}]',
        '[{"type":"\\udfff","date":1767225600000,"sgv":"\\ud800","dateString":"\\ud800"}]',
        '[{"type":"cbg","time":"2024-01-01T00:00:00Z","value":5.5,"deviceId":"\\ud800","deviceTime":"\\ud800"}]',
        '[{"type":"cbg","time":"2024-01-01T00:00:00Z","value":5.5,"units":"\\ud800"}]',
        '[{"type":"sgv","date":1767225600000,"sgv":1' + "0" * 5000 + "}]",
        '[{"eventType":"\\ud800","created_at":"2024-01-01T00:00:00Z","insulin":1,"enteredBy":"\\ud800"}]',
    ],
)
def test_half_of_a_pair_in_a_text_is_read(tmp_path, damaged):
    read_or_refused(tmp_path, [damaged])


def test_whole_pairs_and_backslashes_are_as_they_were():
    from glucoloop.records.file_text import json_of

    text = r'["\ud83d\ude00", "\\ud800", "\ud800", "\ud800\ud83d\ude00", "\\\ud800x", "\udc00\ud800"]'
    assert json_of(text) == ["\U0001f600", r"\ud800", "\ufffd", "\ufffd\U0001f600", "\\\ufffdx", "\ufffd\ufffd"]


@pytest.mark.parametrize("odd", ["[]", "{}", "1", "null", '"x"', "[[]]", "1e999", '"\\ud800"', '{"a": []}'])
@pytest.mark.parametrize("key", ["defaultProfile", "store", "startDate", "mills"])
def test_odd_profiles_beside_treatments(tmp_path, key, odd):
    profile = json.dumps(PROFILE).replace(f'"{key}": ', f'"{key}": {odd}, "was": ', 1)
    read_or_refused(tmp_path, [JSON["treatments and a profile"][0], profile])


@pytest.mark.parametrize("depth", [100, 500, 900, 990, 1_000, 5_000, 100_000])
@pytest.mark.parametrize(("begin", "end"), [("[", "]"), ('{"a":', "}")])
def test_deep_nesting(tmp_path, begin, end, depth):
    deep = begin * depth + "1" + end * depth
    read_or_refused(tmp_path, [f'[{{"sgv": 100, "date": 1767225600000, "device": {deep}, "x": {deep}}}]'])
    read_or_refused(tmp_path, [f'[{{"type": "cbg", "time": "2024-01-01T00:00:00Z", "value": 5.5, "x": {deep}}}]'])
    read_or_refused(tmp_path, [deep])


TABLES = [name for name in FILES if not FILES[name].lstrip().startswith("[")]


@pytest.mark.long
@pytest.mark.parametrize("name", TABLES)
@SETTINGS
@given(data=st.data())
def test_any_text_in_the_place_of_any_cell(tmp_path, name, data):
    lines = FILES[name].splitlines()
    sign = '"' if name == "ohio" else ","
    for _ in range(data.draw(st.integers(1, 4))):
        row = data.draw(st.integers(0, len(lines) - 1))
        cells = lines[row].split(sign)
        cells[data.draw(st.integers(0, len(cells) - 1))] = data.draw(
            st.one_of(TEXTS, NUMBERS.map(lambda n: "9" * 400 if isinstance(n, int) and abs(n) > 2**70 else str(n)))
        )
        lines[row] = sign.join(cells)
    read_or_refused(tmp_path, ["\n".join(lines).encode(errors="replace")])


@pytest.mark.long
@pytest.mark.parametrize("name", FILES)
@SETTINGS
@given(data=st.data())
def test_any_bytes_in_the_place_of_any_bytes(tmp_path, name, data):
    whole = bytearray(FILES[name].encode())
    for _ in range(data.draw(st.integers(1, 5))):
        at = data.draw(st.integers(0, len(whole) - 1))
        whole[at : at + data.draw(st.integers(0, 30))] = data.draw(st.binary(max_size=12))
    read_or_refused(tmp_path, [bytes(whole)])
