"""Every file of its own that glucoloop reads back goes through a door that checks it, and no damage comes beyond."""

import ast
import contextlib
import copy
import dataclasses
import importlib
import io
import json
import tomllib
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import polars as pl
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

import glucoloop as gl
from glucoloop.cli import main
from glucoloop.cli.study_command import StudyOutcome, _StudyRun
from glucoloop.situations.situation import configured
from glucoloop.situations.toml import read_file
from glucoloop.snapshot import pack, unpack
from glucoloop.storage.disk import read_sums, sums_text
from glucoloop.storage.folder import SUMS
from glucoloop.storage.results import Results, parquet
from glucoloop.storage.resumable import Origin
from glucoloop.studies.catalogue import STUDIES
from glucoloop.studies.record_report.sources import _table_of
from glucoloop.studies.replay import twin_values
from glucoloop.text import is_printable
from glucoloop.trials.folder import TrialOrigin
from glucoloop.twins.extended import NOISES, WAVES
from glucoloop.twins.stored import StoredTwin

SRC = Path(gl.__file__).parent
RAW = {"read_bytes", "read_text", "read_parquet", "read_csv", "read_json", "load", "loads", "open"}
"""Methods and functions that read a file, or a text of one, without a check of ours."""
OWNERS = {"json", "tomllib", "pickle", "np", "numpy", "pl", "os", "zipfile", "gzip", "csv"}
DOORS = {
    "user_file.py": "the door itself: a regular file of a bounded size",
    "schema/values.py": "the door itself: JSON of a declared form",
    "schema/tables.py": "the door itself: Parquet of declared columns",
    "storage/disk.py": "the door itself: a file of a folder of ours",
    "storage/files.py": "the door itself: text of a bounded size",
    "situations/toml.py": "the door itself: TOML of a bounded depth",
    "records/file_text.py": "the door itself: files of strangers",
    "storage/results.py": "JSON that was just made, and CSV of the text of a door",
    "storage/resumable.py": "compared with what is expected, byte by byte",
    "trials/trace_store.py": "compared with what is expected, byte by byte, or by its digest",
    "records/user_files.py": "parts of an archive from a door, of a bounded size",
    "records/web_request.py": "answers of a site, of a bounded size and time",
    "_disk_cache.py": "a private folder, with a digest for each entry",
    "_kept_programs.py": "entries of that folder",
    "component/code.py": "digests of code",
    "trials/query.py": "a scratch folder of this process, and /proc",
    "firmware/hil/link.py": "memory of the device that the build made",
    "firmware/hil/build.py": "the image that the build made",
    "firmware/checks.py": "results of the compiler that just ran",
    "native/targets/wasm/__init__.py": "results of the compiler that just ran",
    "cli/app.py": "the null device",
    **dict.fromkeys(
        (
            "component/listing.py",
            "firmware/chips.py",
            "native/targets/c/numbers.py",
            "reporting/template.py",
            "patients/simglucose.py",
            "plugin.py",
            "lab/pack.py",
            "lab/page_data.py",
            "firmware/safety.py",
            "reproduction/parker1999/comparison.py",
            "pages/__init__.py",
        ),
        "files of the package",
    ),
}


def reads_raw(call):
    name = call.func.attr if isinstance(call.func, ast.Attribute) else getattr(call.func, "id", "")
    owner = call.func.value if isinstance(call.func, ast.Attribute) else None
    if name in ("read_bytes", "read_text"):
        return isinstance(owner, ast.Name | ast.Call | ast.BinOp | ast.Attribute)
    if name == "open":
        return True
    return name in RAW and isinstance(owner, ast.Name) and owner.id in OWNERS


def test_every_file_is_read_by_a_door():
    raw = set()
    for path in SRC.rglob("*.py"):
        calls = (node for node in ast.walk(ast.parse(path.read_text())) if isinstance(node, ast.Call))
        if any(map(reads_raw, calls)):
            raw.add(path.relative_to(SRC).as_posix())
    assert raw == {*DOORS}


COORDINATES = 2 + WAVES + len(NOISES)
TWIN = {
    "verdict": "The twin predicts the 2 days held out.",
    "predicts": True,
    "patient": "hovorka-2004",
    "population": "boiroux2017",
    "filter": {
        "parameters": ["S_IT", "EGP_0"],
        "prior_mean": [0.1, -0.2],
        "prior_factor": [[0.2, 0.0], [0.01, 0.3]],
        "coordinates": [0.1] * COORDINATES,
        "covariance": (0.04 * np.eye(COORDINATES)).tolist(),
        "mean_mg_dl": 140.0,
        "steps": 2,
        "site": "interstitial",
    },
    "known": {"weight_kg": 70.0},
    "profile": {"carb_ratio_g_U": 9.0},
    "notes": ["A note."],
}
COURSE = {"t_min": [0.0, 5.0, 10.0], "glucose_mg_dl": [100.0, 101.0, 103.0]}
STATE = {"x": np.arange(3.0), "sample": np.array(4)}
ORIGIN = {"version": "0", "arithmetic": {"jax": "1"}, "config": {"seed": 1}}
TRIAL = {**ORIGIN, "fingerprint": "0" * 64, "people": 2, "shards": 1, "polars": "1"}


def twin(path):
    StoredTwin.of(twin_values(str(path.parent)))


def sums(path):
    path.with_name(SUMS).write_bytes(path.read_bytes())
    read_sums(path.parent)


READERS = {
    "twin.json": (json.dumps(TWIN).encode(), twin),
    "sums": (sums_text({"a.json": "0" * 64, "b.csv": "1" * 64}), sums),
    "trial.json": (json.dumps({"format": TrialOrigin.format, **TRIAL}).encode(), TrialOrigin.read),
    "origin.json": (json.dumps({"format": Origin.format, **ORIGIN}).encode(), Origin.read),
    "results.json": (json.dumps({"version": "0", "rows": [{"a": 1.5}], "notes": ["A note."]}).encode(), Results.read),
    "configuration.toml": (b'glucoloop = "0"\npatient = "pid"\n[used]\nseed = 3\nmeals = ["50g@1h"]\n', read_file),
    "trace.parquet": (parquet(pl.DataFrame(COURSE)), _table_of),
    "snapshot": (pack(STATE, "test"), lambda path: unpack(path.read_bytes(), STATE, "test")),
}


def refused_or_read(read, path):
    """Whether a reader takes a file; a sentence of ours that can be printed, and nothing else, refuses it."""
    told = ""
    try:
        read(path)
    except gl.Refusal as error:
        told = str(error)
    assert is_printable(told), ascii(told)
    return not told


@pytest.mark.parametrize("name", READERS)
def test_a_whole_file_is_read(tmp_path, name):
    whole, read = READERS[name]
    (tmp_path / name).write_bytes(whole)
    assert refused_or_read(read, tmp_path / name)


PIECES = [
    b"nan",
    b"-1",
    b"1e999",
    b"9" * 400,
    b"\x1b[2J",
    b"\xff",
    b"\x00",
    b"",
    b"[" * 3000,
    b"{",
    b'"',
    b"\\ud800",
    b"\\u001b",
]
quick = settings(
    max_examples=120, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture, HealthCheck.too_slow]
)


@pytest.mark.parametrize("name", READERS)
@quick
@given(data=st.data())
def test_a_damaged_file_is_refused_in_a_sentence_or_read(tmp_path, name, data):
    whole, read = READERS[name]
    changed = bytearray(whole)
    for _ in range(data.draw(st.integers(1, 3))):
        at, size = data.draw(st.integers(0, len(changed))), data.draw(st.sampled_from([0, 1, 1, 4, 12]))
        changed[at : at + size] = data.draw(st.sampled_from(PIECES) | st.binary(min_size=1, max_size=2))
    cut = len(changed) if data.draw(st.booleans()) else data.draw(st.integers(0, len(changed)))
    (tmp_path / name).write_bytes(bytes(changed[:cut]))
    refused_or_read(read, tmp_path / name)


VALUES = st.sampled_from(
    [None, True, -1, 0, 1e300, -1e300, 2**70, 1.5, "", "x", "\x1b[2J", "\u202e", "a\nb", [], [1], {}, {"a": 1}, [[[]]]]
)


@st.composite
def with_other_values(draw, whole):
    """A copy of plain values in which some have others in their place, or are gone."""
    plain = copy.deepcopy(whole)
    for _ in range(draw(st.integers(1, 3))):
        place, key = plain, None
        while isinstance(place, dict | list) and place:
            keys = sorted(place) if isinstance(place, dict) else range(len(place))
            parent, key = place, draw(st.sampled_from(keys))
            place = place[key]
            if draw(st.integers(0, 3)) == 0:
                break
        if key is None:
            continue
        if isinstance(parent, dict) and draw(st.integers(0, 4)) == 0:
            del parent[key]
        else:
            parent[key] = copy.deepcopy(draw(VALUES))
    return plain


@pytest.mark.parametrize("name", [name for name in READERS if name.endswith(".json")])
@quick
@given(data=st.data())
def test_other_values_are_refused_in_a_sentence_or_read(tmp_path, name, data):
    whole, read = READERS[name]
    (tmp_path / name).write_text(json.dumps(data.draw(with_other_values(json.loads(whole)))))
    refused_or_read(read, tmp_path / name)


COMMANDS = {
    "trial": ("trial", "--people", "2", "--controller", "pid", "--duration", "60"),
    "stress": ("stress", "--people", "2", "--controller", "pid", "--fault", "missing", "--duration", "60"),
    "verify": ("verify", "--loops", "4", "--controller", "pid"),
    "adversary": (
        *(
            "adversary",
            "--controller",
            "pid",
            "--guards",
            "without",
            "--error",
            "30",
            "--duration",
            "120",
            "--people",
            "3",
        ),
        *("--generations", "3", "--starts", "1", "--sequences", "4"),
    ),
}
"""Studies whose folders are read back when the same command is given again."""


@pytest.mark.long
@pytest.mark.parametrize("name", COMMANDS)
def test_results_of_a_study_with_other_values_are_shown_or_refused(tmp_path, monkeypatch, name):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("GLUCOLOOP_CACHE_DIR", "off")
    with contextlib.redirect_stdout(io.StringIO()), pytest.raises(SystemExit) as left:
        main([*COMMANDS[name], "--out", "out"])
    assert not left.value.code
    module, _, attribute = STUDIES[name].place.partition(":")
    study = getattr(importlib.import_module(module), attribute)
    keys = tomllib.loads((tmp_path / "out" / f"{name}.toml").read_text())
    config = configured(study.request, {key: value for key, value in keys.items() if key not in ("glucoloop", "used")})
    output = SimpleNamespace(json=False, out=None)
    run = _StudyRun(study, output, importlib.import_module(study.module), config, ())
    whole, place = json.loads((tmp_path / "out" / study.summary).read_text()), tmp_path / "changed.json"

    def shown(path):
        printed = io.StringIO()
        with contextlib.redirect_stdout(printed):
            for json_too in (False, True):
                again = dataclasses.replace(run, output=SimpleNamespace(json=json_too, out=None))
                StudyOutcome(again, Results.read(path), {}, "").print()
        assert all(map(is_printable, printed.getvalue().split("\n")))

    place.write_text(json.dumps(whole))
    assert refused_or_read(shown, place)

    @quick
    @given(with_other_values(whole))
    def harmless(changed):
        place.write_text(json.dumps(changed))
        refused_or_read(shown, place)

    harmless()
