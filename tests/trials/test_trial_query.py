"""Questions to a trial: answered from its files, and unable to do anything else."""

import json
import os
import signal
import subprocess
import sys
import time

import polars as pl
import pytest

import glucoloop as gl
from glucoloop.trials.computing import run_here
from glucoloop.trials.folder import trial_folder
from glucoloop.trials.query import trial_tables
from glucoloop.trials.shard import compute_shard
from peak_memory import command_and_peak_mib, needs_peak

SUMMARY = {
    "controllers": {"mpc": {"metrics": {"gri": {"mean": 1.5, "p95": None}, "settled_2pct": {"share_pct": 50.0}}}}
}


@pytest.fixture
def finished(tmp_path, make_trial, pretend):
    trial = make_trial(traces=3)
    bands = tmp_path / "bands.parquet"
    pl.DataFrame({"t_min": [0.0], "q50": [81.1]}).write_parquet(bands)
    with trial_folder(tmp_path / "it's", trial) as folder:
        run_here(folder, pretend(trial))
        folder.finish({"bands.parquet": bands.read_bytes(), "summary.json": json.dumps(SUMMARY).encode()})
    return tmp_path / "it's"


def ask(folder, sql):
    with trial_tables(folder) as tables:
        answer = tables.query(sql)
        return answer.columns, list(answer.rows)


QUESTIONS = {
    "select controller, count(*), sum(able::int) > 280 from people group by all order by 1": [
        ("mpc", 300, True),
        ("pid", 300, True),
    ],
    "from bands": [(0.0, 81.1)],
    "select controller, metric, mean, p95, share_pct from summary order by metric": [
        ("mpc", "gri", 1.5, None, None),
        ("mpc", "settled_2pct", None, None, 50.0),
    ],
    "select count(distinct person) from traces": [(3,)],
    "select sum(count) from counts where quantity = 'glucose' and t_min = 5 and controller = 'mpc'": [(297,)],
    "with a as (select 1 as one) select one from a;": [(1,)],
    "select count(*) from (describe people) where column_name in ('person', 'controller')": [(2,)],
    "select count(*) / 2 from people where not able": [(3.0,)],
    "pivot people on controller using count(able) group by able order by able -- sorted": [
        (False, 3, 3),
        (True, 297, 297),
    ],
    "pivot people on controller in ('pid') using count(*) group by able order by able;": [(False, 3), (True, 297)],
    "with p as (pivot people on controller using count(*) group by able) select sum(mpc) from p": [(300,)],
}


@pytest.mark.long
@pytest.mark.parametrize(("sql", "rows"), QUESTIONS.items())
def test_answers(finished, sql, rows):
    assert ask(finished, sql)[1] == rows


@pytest.mark.long
def test_many_rows_come_in_parts(finished):
    columns, rows = ask(finished, "select range as n from range(25000)")
    assert columns == ["n"]
    assert rows == [(n,) for n in range(25000)]


@pytest.mark.long
@pytest.mark.parametrize(
    ("sql", "told"),
    [
        ("selct 1", "Parser Error: syntax error"),
        ("select foo from people", '"foo" not found in FROM clause! Candidate bindings'),
        ("select * from persons", "Table with name persons does not exist! Did you mean"),
        ("select 1/", "Parser Error"),
        ("", "is not one question"),
        ("select 1; select 2", "is not one question"),
        ("drop view people", "is not one question"),
        ("create table x as select 1", "is not one question"),
        ("copy people to 'x.csv'", "is not one question"),
        ("copy (pivot people on controller using count(*)) to 'shards/x.csv'", "is not one question"),
        ("create table x as pivot people on controller using count(*)", "is not one question"),
        ("pivot people on controller using count(*); drop view people", "is not one question"),
        ("pivot people on controller using count(*)) ; drop view people; from (people", "Parser Error"),
        ("call duckdb_tables()", "is not one question"),
        ("explain analyze copy people to 'x.csv'", "is not one question"),
        ("attach 'x.db'", "is not one question"),
        ("install httpfs", "is not one question"),
        ("set enable_external_access = true", "is not one question"),
        ("select * from read_csv('/etc/passwd')", "Permission Error"),
        ("from '/etc/passwd.csv'", "Permission Error"),
        ("select * from read_text('/etc/hostname')", "Permission Error"),
        ("select * from glob('/etc/*')", "Permission Error"),
        ("select 'x'::int", "Conversion Error"),
        ("select case when n = 24000 then error('late') end from range(25000) of(n)", "late"),
    ],
)
def test_refusals(finished, sql, told):
    before = sorted(finished.rglob("*"))
    with pytest.raises(ValueError, match=r".") as refused:
        ask(finished, sql)
    assert told in str(refused.value)
    assert "\n" not in str(refused.value)
    assert sorted(finished.rglob("*")) == before


@pytest.mark.long
@pytest.mark.parametrize(
    "value",
    [
        "now()",
        "[now()]",
        "{'a': now()}",
        "last_modified from read_text('SHARD')",
        "case when n > 20000 then now() end from range(25000) of(n)",
    ],
)
def test_time_with_a_time_zone_is_told_in_a_sentence(finished, monkeypatch, value):
    monkeypatch.setitem(sys.modules, "pytz", None)
    value = value.replace("SHARD", str(finished / "shards/00000/SHA256SUMS").replace("'", "''"))
    told = r"^the answer holds a time with a time zone, for which pytz is missing; cast it to varchar$"
    with pytest.raises(ValueError, match=told):
        ask(finished, f"select {value}")
    assert len(ask(finished, "select now()::varchar")[1]) == 1


@pytest.mark.long
def test_tables_are_described_and_summarised(finished):
    columns, rows = ask(finished, "describe people")
    assert columns[:2] == ["column_name", "column_type"]
    assert ("controller", "VARCHAR") in [row[:2] for row in rows]
    columns, rows = ask(finished, "summarize select minimum_mg_dl from people")
    assert dict(zip(columns, rows[0], strict=True))["count"] == 600


@pytest.mark.long
@pytest.mark.skipif(os.name == "nt", reason="another system of signals")
def test_ctrl_c_ends_a_question_that_listens_to_nobody(finished):
    # DuckDB looks for an interrupt between chunks of rows
    deaf = "select levenshtein(repeat('a', 5000 + range), repeat('b', 5000)) from range(2000)"
    imported = "import sys, glucoloop.trials.query; from glucoloop.cli import main; "
    ask = imported + "print('begun', flush=True); main(sys.argv[1:])"
    with subprocess.Popen([sys.executable, "-c", ask, "query", finished, deaf], stdout=subprocess.PIPE) as running:
        assert running.stdout.readline()
        time.sleep(3.0)
        running.send_signal(signal.SIGINT)
        assert running.wait(timeout=5.0) in (-signal.SIGINT, 130)  # or it had not begun


LARGE = (
    "select * from range(20000000) order by hash(range) limit 19999999",
    "select repeat(chr(65), 2000000000)",
    "select length(repeat(chr(65), 2000000000))",
    "select list(range) from range(300000000)",
    "select range, repeat('ab', 100000) from range(20000)",
    "select repeat('ab', 1000000) from range(100)",
)


@pytest.mark.long
@pytest.mark.parametrize("sql", LARGE)
def test_what_does_not_fit_in_memory_is_refused(finished, sql):
    with (
        pytest.raises(gl.Refusal, match="needs more than 50 MB of memory; ask for fewer rows"),
        trial_tables(finished, memory_mb=50) as tables,
    ):
        list(tables.query(sql).rows)


@pytest.mark.long
@needs_peak
def test_the_process_of_a_question_stays_within_the_memory_that_is_promised(finished):
    _, smallest = command_and_peak_mib("query", finished, "select 1")
    done, peak = command_and_peak_mib("query", finished, "select repeat(chr(65), 2000000000)")
    assert "needs more than 1000 MB of memory" in done.stderr
    assert done.returncode == 2
    assert peak < smallest + 1000.0


def test_the_limit_of_memory_ends_with_the_block(finished):
    with trial_tables(finished, memory_mb=50):
        pass
    assert len(bytearray(200_000_000)) == 200_000_000


def test_trial_that_is_not_finished_answers_about_what_is_done(tmp_path, make_trial, pretend):
    trial = make_trial()
    with trial_folder(tmp_path / "out", trial) as folder:
        for index in (0, 3):
            folder.put(index, compute_shard(trial, index, pretend(trial)))
    with trial_tables(tmp_path / "out") as tables:
        assert (tables.done, tables.shards) == (2, 5)
        assert set(tables.views) == {"people", "counts"}
        assert tables.views["people"][:4] == ["person", "controller", "able", "basal_insulin_mU_min"]
        assert list(tables.query("select count(distinct person) from people").rows) == [(128,)]


def test_folder_that_is_no_trial_or_has_no_shard_is_refused(tmp_path, make_trial):
    for place, told in (("absent", "is not a folder"), (".", "holds no trial")):
        with pytest.raises(ValueError, match=told), trial_tables(tmp_path / place):
            pass
    with trial_folder(tmp_path / "out", make_trial()):
        pass
    with pytest.raises(ValueError, match=r"no shard of .* is done yet"), trial_tables(tmp_path / "out"):
        pass


def test_damaged_shard_is_told(finished):
    place = finished / "shards/00001/people.parquet"
    place.write_bytes(b"PAR1" + place.read_bytes()[4:-8] + b"\0" * 8)
    with pytest.raises(ValueError, match=r"shard 00001 .* is damaged: people\.parquet"):
        ask(finished, "select avg(gri) from people")


@pytest.mark.parametrize("name", ["bands.parquet", "summary.json"])
@pytest.mark.parametrize("change", ["edit", "link", "remove"])
def test_what_is_said_about_the_whole_trial_is_not_taken_from_elsewhere(finished, tmp_path, name, change):
    place = finished / name
    (tmp_path / "elsewhere").write_bytes(place.read_bytes())
    if change == "edit":
        place.write_bytes(place.read_bytes() + b" ")
    else:
        place.unlink()
    if change == "link":
        place.symlink_to(tmp_path / "elsewhere")
    with pytest.raises(ValueError, match=rf"{name} is (gone or was changed|a symbolic link)"):
        ask(finished, "select 1")
