"""``glucoloop trial``."""

import json
import re
import subprocess
import sys

import polars as pl
import pytest
from matplotlib.figure import Figure

from glucoloop.cli import progress

SHORT = ("--duration", 300, "--meal", "50g@50min")
SMALL = ("--people", 40, "--controller", "basal", *SHORT)
TWO = (*SMALL, "--controller", "pid", "--seed", 3, "--shard-people", 15)
FILES = {
    "SHA256SUMS",
    "tables.tex",
    "bands.parquet",
    "figure.png",
    "figure.svg",
    "figure.pdf",
    "report.html",
    "summary.json",
    "trial.json",
    "trial.toml",
}


@pytest.fixture
def _plain(monkeypatch):
    """A page without pictures, which take longer than the trial."""
    monkeypatch.setattr("glucoloop.studies.trial.study.trial_page", lambda report: report.title)
    monkeypatch.setattr("glucoloop.studies.trial.study.plot_trial", lambda report: Figure())


def sums(folder):
    return (folder / "SHA256SUMS").read_text()


@pytest.mark.long
@pytest.mark.usefixtures("_plain")
def test_how_many_were_ever_low_stands_beside_the_time(glucoloop, tmp_path):
    told = glucoloop("trial", *SMALL, "--pump", "max_insulin_mU_min=66", "--out", "a", "--population", "lognormal")
    summary = json.loads((tmp_path / "a/summary.json").read_text())["controllers"]["basal"]
    for limit in (70, 54):
        people = summary["ever_below"][f"{limit}_mg_dl"]["people"]
        line = next(line for line in told.out.splitlines() if line.startswith(f" People ever below {limit} mg/dl"))
        assert line.split()[5:7] == ["number", str(people)]
        assert f" Time below {limit} mg/dl " in told.out
        assert f"time_below_{limit}_pct" in summary["metrics"]


@pytest.mark.long
def test_a_long_trial_is_told_by_week_and_by_the_time_of_day(glucoloop, tmp_path):
    asked = ("--people", 3, "--days", 30, "--meal", "45g@7h", "--controller", "basal")
    told = glucoloop("trial", *asked, "--traces", "all", "--out", "a")
    assert told.code == 0, told.err
    traces = pl.read_parquet(tmp_path / "a/shards/00000/traces.parquet").filter(pl.col("t_min") < 30 * 1440.0)
    weeks = json.loads((tmp_path / "a/summary.json").read_text())["controllers"]["basal"]["weeks"]
    assert [week["week"] for week in weeks] == [1, 2, 3, 4, 5]
    for week in weeks:
        glucose = traces.filter((pl.col("t_min") // 10_080.0) == week["week"] - 1)["glucose_mg_dl"]
        assert week["p50"] == pytest.approx(glucose.median(), abs=1.0)
        assert week["time_70_180_pct"] == pytest.approx(100.0 * glucose.is_between(70.0, 180.0).mean(), abs=0.02)
    bands = pl.read_parquet(tmp_path / "a/bands.parquet").group_by("quantity").agg(pl.col("t_min").sort())
    times = {quantity: t_min for quantity, t_min in bands.rows()}
    assert {quantity: len(t_min) for quantity, t_min in times.items()} == {
        "glucose": 289, "insulin": 288, "glucose_by_week": 5,
    }  # fmt: skip
    page = (tmp_path / "a/report.html").read_text()
    assert "Week by week" in page
    assert re.search(r"week [1-5]; ", page)


@pytest.mark.long
def test_folder_holds_everybody_and_repeats_itself(glucoloop, tmp_path):
    first = glucoloop("trial", *TWO, "--traces", 4, "--out", "a")
    assert first.code == 0
    assert {entry.name for entry in (tmp_path / "a").iterdir()} == FILES | {"shards"}
    for part in ("Undershoot", "basal", "pid", "Time above 250 mg/dl", "Wrote bands.parquet", "3 shards to a."):
        assert part in first.out
    people = pl.read_parquet(tmp_path / "a/shards/*/people.parquet")
    assert people.group_by("controller").agg(pl.col("person").n_unique()).sort("controller").rows() == [
        ("basal", 40),
        ("pid", 40),
    ]
    assert people["minimum_mg_dl"].is_finite().all()
    summary = json.loads((tmp_path / "a/summary.json").read_text())
    pid = people.filter(pl.col("controller") == "pid")
    of_pid = summary["controllers"]["pid"]
    assert of_pid["metrics"]["undershoot_mg_dl"]["max"] == pid["undershoot_mg_dl"].max()
    assert of_pid["metrics"]["mean_mg_dl"]["median"] == pytest.approx(pid["mean_mg_dl"].median())
    assert of_pid["worst"][0]["metrics"]["minimum_mg_dl"] == pid["minimum_mg_dl"].min()
    traces = pl.read_parquet(tmp_path / "a/shards/00000/traces.parquet")
    assert traces["person"].unique().to_list() == [0, 1, 2, 3]
    bands = pl.read_parquet(tmp_path / "a/bands.parquet")
    median = bands.filter(controller="pid", quantity="glucose", t_min=0.0)["q50"].item()
    assert median == pytest.approx(81.1, abs=1.0)
    assert glucoloop("trial", "--config", "a/trial.toml", "--out", "b").code == 0
    assert sums(tmp_path / "a") == sums(tmp_path / "b")


@pytest.mark.long
def test_page_shows_the_worst_people_as_they_are_in_the_tables(glucoloop, tmp_path, monkeypatch):
    reports = []
    monkeypatch.setattr("glucoloop.studies.trial.study.trial_page", lambda report: reports.append(report) or "")
    monkeypatch.setattr("glucoloop.studies.trial.study.plot_trial", lambda report: Figure())
    glucoloop("trial", *TWO, "--traces", "all", "--out", "a")
    [report] = reports
    assert (report.people, report.infeasible, report.setpoint_mg_dl) == (40, 0, pytest.approx(81.1))
    assert report.facts["Seed"] == "3"
    people = pl.read_parquet(tmp_path / "a/shards/*/people.parquet").filter(controller="pid")
    traces = pl.read_parquet(tmp_path / "a/shards/*/traces.parquet").filter(controller="pid")
    worst = report.cases["pid"].worst
    assert [one.person for one in worst] == people.sort("minimum_mg_dl")["person"].head(10).to_list()
    for one in worst:
        kept = traces.filter(person=one.person).sort("t_min")
        assert one.glucose_mg_dl.tolist() == kept["glucose_mg_dl"].to_list()
        assert one.insulin_mU_min.tolist() == kept["insulin_mU_min"].to_list()[:-1]
        assert one.minimum_mg_dl <= kept["glucose_mg_dl"].min() + 1e-4
    at_100 = traces.filter(t_min=100.0)["glucose_mg_dl"]
    assert report.cases["pid"].glucose_quantiles[0.5][20] == pytest.approx(at_100.median(), abs=1.0)
    assert report.cases["pid"].insulin_quantiles[0.95].shape == (60,)
    shares = report.cases["pid"].time_in_range_pct
    assert sum(shares.values()) == pytest.approx(100.0)


def test_help_of_trials_imports_nothing_heavy():
    heavy = ("jax", "numpy", "polars", "duckdb", "distributed", "llvmlite", "matplotlib", "glucoloop.build")
    for command in ("trial", "query"):
        code = (
            "import sys\n"
            "from glucoloop.cli import main\n"
            f"try: main([{command!r}, '--help'])\n"
            f"except SystemExit: print([name for name in {heavy} if name in sys.modules], file=sys.stderr)"
        )
        done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
        assert done.stderr.strip() == "[]"
        assert "Usage: glucoloop" in done.stdout


@pytest.mark.long
@pytest.mark.usefixtures("_plain")
def test_shards_and_threads_change_nothing_about_a_person(glucoloop, tmp_path):
    glucoloop("trial", *SMALL, "--shard-people", 40, "--workers", 1, "--out", "one")
    glucoloop("trial", *SMALL, "--shard-people", 7, "--workers", 2, "--out", "many")
    glucoloop("trial", "--people", 1, *SMALL[2:], "--first-person", 33, "--out", "alone")
    one, many, alone = (
        pl.read_parquet(tmp_path / place / "shards/*/people.parquet") for place in ("one", "many", "alone")
    )
    assert one.equals(many)
    assert one.filter(person=33).equals(alone)


@pytest.mark.long
@pytest.mark.usefixtures("_plain")
def test_json_is_the_summary_and_a_finished_trial_is_told_again(glucoloop, tmp_path):
    first = glucoloop("trial", *SMALL, "--out", "a", "--json")
    found = first.json
    assert found["config"]["people"] == 40
    assert found["able"] == 40
    assert found["files"]["summary.json"] == "a/summary.json"
    written = json.loads((tmp_path / "a/summary.json").read_text())
    assert {key: value for key, value in found.items() if key != "files"} == written
    assert re.search(r"^40 people in [\d.]+ s\.$", first.err, re.M)
    again = glucoloop("trial", *SMALL, "--out", "a", "--json")
    assert again.json == found
    assert again.err == "a was finished before; nothing is computed again.\n"
    assert "overwrite" in glucoloop("trial", *SMALL, "--seed", 1, "--out", "a").err
    assert glucoloop("trial", *SMALL, "--seed", 1, "--out", "a", "--overwrite", "--json").json["config"]["seed"] == 1


@pytest.mark.long
@pytest.mark.usefixtures("_plain")
def test_people_without_a_basal_rate_are_counted_and_named(glucoloop, tmp_path):
    answer = glucoloop("trial", *SMALL, "--setpoint", 180, "--out", "a", "--units", "mmol/l")
    summary = json.loads((tmp_path / "a/summary.json").read_text())
    infeasible = summary["unable"]["person"]
    assert 0 < len(infeasible) < 40
    assert f"Of 40 people {len(infeasible)} have no basal rate for 10.0 mmol/l: person {infeasible[0]}, " in answer.out
    assert "mg/dl" not in answer.out.replace("(mg/dl)²", "")
    people = pl.read_parquet(tmp_path / "a/shards/*/people.parquet")
    assert people.filter(~pl.col("able"))["person"].to_list() == infeasible


def test_what_is_computed_is_told_before_anything_is_designed(glucoloop, monkeypatch):
    def stop(trial):
        raise KeyboardInterrupt

    monkeypatch.setattr("glucoloop.trials.engine.prepare", stop)
    answer = glucoloop("trial", "--people", 2000, "--days", 2, "--controller", "mpc", "--controller", "meal-mpc",
                       "--out", "a")  # fmt: skip
    assert answer.err.startswith(
        "Designing and compiling for 2000 people under mpc, meal-mpc; compiling meal-mpc takes up to half a minute.\n"
    )
    assert "0 of 8 shards are kept" in answer.err


@pytest.mark.long
@pytest.mark.usefixtures("_plain")
def test_interrupt_tells_how_far_it_is_and_the_same_command_goes_on(glucoloop, tmp_path, monkeypatch):
    from glucoloop.trials import engine

    run_people, calls = engine.run_people, []

    def interrupted(*arguments, **options):
        calls.append(arguments)
        if len(calls) == 4:
            raise KeyboardInterrupt
        return run_people(*arguments, **options)

    monkeypatch.setattr(engine, "run_people", interrupted)
    answer = glucoloop("trial", *TWO, "--out", "a")
    assert answer.code == 130
    assert answer.err.endswith("\nglucoloop: interrupted; 1 of 3 shards are kept, the same command goes on.\n")
    monkeypatch.undo()
    monkeypatch.chdir(tmp_path)
    answer = glucoloop("trial", *TWO, "--out", "a")
    assert answer.err.startswith(
        "1 of 3 shards of a are there already; going on.\nDesigning and compiling for 40 people"
    )
    glucoloop("trial", *TWO, "--out", "b")
    assert sums(tmp_path / "a") == sums(tmp_path / "b")


@pytest.mark.long
@pytest.mark.usefixtures("_plain")
def test_design_that_fails_changes_nothing(glucoloop, refused, tmp_path):
    wrong = ("trial", "--people", 40, "--controller", "mpc, prediction_horizon=1", *SHORT, "--out", "a/b")
    assert "prediction horizon of 1" in refused(*wrong)
    assert not (tmp_path / "a/b").exists()
    glucoloop("trial", *SMALL, "--out", "a/b")
    before = sums(tmp_path / "a/b")
    assert "prediction horizon of 1" in refused(*wrong, "--overwrite")
    assert sums(tmp_path / "a/b") == before


@pytest.mark.long
@pytest.mark.usefixtures("_plain")
def test_population_file_beside_a_configuration(glucoloop, tmp_path):
    (tmp_path / "in").mkdir()
    (tmp_path / "in/people.toml").write_text(
        "[[vary]]\nparameter = 'weight_kg'\ndistribution = 'lognormal'\nspread_pct = 15\n"
    )
    (tmp_path / "in/t.toml").write_text(
        "population = 'people.toml'\npeople = 20\ndays = 2\n[[controller]]\nlabel = 'rest'\nname = 'basal'\n"
    )
    answer = glucoloop("trial", "--config", "in/t.toml", *SHORT, "--out", "a", "--json")
    assert answer.json["config"]["duration_min"] == 300.0
    assert answer.json["config"]["population"]["name"] == "people"
    assert list(answer.json["controllers"]) == ["rest"]
    assert "weight_kg" in pl.read_parquet(tmp_path / "a/shards/*/people.parquet").columns


MISTAKES = {
    "trial": ["--out is missing", "like --out trial"],
    "trial --out=": ["--out is empty"],
    "trial --out a --people 0": ["--people is 0", "from 1 to 1000000000"],
    "trial --out a --people many": ["--people is 'many'", "a whole number"],
    "trial --out a --population here": ["unknown population 'here'"],
    "trial --out a --population absent.toml": ["absent.toml", "No such file"],
    "trial --out a --days 0": ["--days is 0"],
    "trial --out a --days 2 --duration 600": ["days and duration_min both tell the length", "leave one out"],
    "trial --out a --meal 50@25h": ["1500 min", "move the meal"],
    "trial --out a --meal 50@1h --no-meal": ["there is no option --no-meal; write --meal none"],
    "trial --out a --meal 50@1h --meal none": ["--meal none leaves all of them out; give it alone"],
    "trial --out a --meal-size-spread 100": ["--meal-size-spread is 100", "below 100"],
    "trial --out a --meal-time-spread 500": ["can begin at -80 min", "at most 420 min"],
    "trial --out a --controller mpx": ["--controller: unknown controller 'mpx'", "did you mean 'mpc'"],
    "trial --out a --controller mpc --controller mpc": ["two cases are called 'mpc'"],
    "trial --out a --controller mpc,people=3": ["--controller: the controller mpc has no setting 'people'"],
    "trial --out a --case a:mpc": ["there is no option --case"],
    "trial --out a --design own": ["--design is 'own'", "give nominal or individual"],
    "trial --out a --precision double": ["--precision is 'double'"],
    "trial --out a --traces some": ["--traces is 'some'", "none, all"],
    "trial --out a --shard-people 0": ["--shard-people is 0"],
    "trial --out a --workers 0": ["--workers is 0"],
    "trial --out a --dask here": ["no address of a scheduler", "tcp://10.0.0.1:8786"],
    "trial --out a --dask tcp://10.0.0.1:1 --workers 3": ["--workers is 3", "leave it out"],
    "trial --out a --traces all --traces-at bucket": ["no address of a store", "s3://bucket/folder"],
    "trial --out a --traces-at file:///t": [
        "no traces are kept for file:///t",
        "add --traces all, or leave --traces-at out",
    ],
    "trial --out a --integrator fast": ["--integrator", "glucoloop trial --help"],
    "query": ["DIR", "glucoloop query --help"],
    "query absent": ["absent is not a folder"],
    "query . x": ["holds no trial"],
    "query . x --json --csv": ["--json and --csv"],
}


@pytest.mark.parametrize("line", MISTAKES)
def test_mistake_is_told_in_a_sentence(refused, tmp_path, line):
    told = refused(*line.split(" "))
    for part in MISTAKES[line]:
        assert part in told
    assert list(tmp_path.iterdir()) == []


@pytest.mark.long
@pytest.mark.usefixtures("_plain")
def test_questions(glucoloop, refused, monkeypatch):
    monkeypatch.setenv("COLUMNS", "200")
    assert glucoloop("trial", *TWO, "--out", "a").code == 0
    question = "select controller, count(*) as n, null as nothing from people group by all order by 1"
    assert [line.split() for line in glucoloop("query", "a", question).out.splitlines() if "40" in line] == [
        ["basal", "40"],
        ["pid", "40"],
    ]
    assert glucoloop("query", "a", question, "--json").json == {
        "columns": ["controller", "n", "nothing"],
        "rows": [["basal", 40, None], ["pid", 40, None]],
    }
    assert glucoloop("query", "a", question, "--csv").out == "controller,n,nothing\nbasal,40,\npid,40,\n"
    exact = glucoloop(
        "query", "a", "select sum(minimum_mg_dl), 1::decimal(4,2), [1.5, null] from people", "--json"
    ).json
    assert exact["rows"][0][1:] == [1.0, [1.5, None]]
    listed = glucoloop("query", "a")
    assert {"people", "counts", "bands", "summary"} <= {
        line.split()[0] for line in listed.out.splitlines() if line.strip()
    }
    assert set(glucoloop("query", "a", "--json").json) == {"people", "counts", "bands", "summary"}
    assert "Did you mean" in refused("query", "a", "select * from persons")
    many = glucoloop("query", "a", "select range from range(1500)")
    assert many.err == "The first 1000 rows; --csv prints all.\n"
    assert "999" in many.out
    assert "1000" not in many.out
    text = glucoloop("query", "a", "select repeat('a', 20000) || chr(27) as x, chr(27) as y")
    assert text.err == "The first 10000 letters of a longer text; --csv prints it whole.\n"
    assert "\x1b" not in text.out
    wide = glucoloop("query", "a", "select * from people order by person, controller")
    assert "columns are left out on the right" in wide.out
    assert "…" not in wide.out
    assert glucoloop("query", "a", "select * from people where false").err == "No row answers the question.\n"
    assert [line.split()[:2] for line in wide.out.splitlines()[3:5]] == [["0", "basal"], ["0", "pid"]]


@pytest.mark.long
@pytest.mark.usefixtures("_plain")
def test_question_to_a_trial_that_is_not_finished(glucoloop, tmp_path):
    import shutil

    glucoloop("trial", *TWO, "--out", "a")
    shutil.rmtree(tmp_path / "a/shards/00001")
    answer = glucoloop("query", "a", "select count(*) from people", "--csv")
    assert answer.out.splitlines()[1] == "50"
    assert answer.err == "2 of 3 shards are done; the answer is about these.\n"


def test_progress_is_told_in_lines(capsys, monkeypatch):
    monkeypatch.setattr(progress, "BETWEEN_LINES_S", 0.0)
    with progress.counted(1000, 200, "people") as done:
        done(200)
        done(200)
    first, second = capsys.readouterr().err.splitlines()
    assert re.fullmatch(r"400 of 1000 people, [\d.e+]+ people/s, 0:00:00 left", first)
    assert second.startswith("600 of 1000 people")


@pytest.mark.parametrize(
    ("rate", "text"), [(0.0125, "one in 80 s"), (0.5, "one in 2 s"), (1.0, "1 people/s"), (12_345.6, "12346 people/s")]
)
def test_slow_work_has_the_time_of_one(rate, text):
    assert progress._pace(rate, "people") == text


def test_of_long_work_it_is_said_once_how_long_the_rest_takes(capsys, monkeypatch):
    clock = [0.0]
    monkeypatch.setattr(progress.time, "monotonic", lambda: clock[0])
    with progress.counted(100_000, 0, "people") as done:
        clock[0] += 50.0  # compiling does not count
        for _ in range(4):
            done(30)
            clock[0] += 4.0
    sentence = "The rest takes about 3.7 hours, as measured: 60 of 100000 people took 8 s."
    assert [line for line in capsys.readouterr().err.splitlines() if "rest" in line] == [sentence]


def test_progress_is_a_bar_where_somebody_watches(capsys, monkeypatch):
    monkeypatch.setattr(sys.stderr, "isatty", lambda: True)
    with progress.counted(1000, 200, "people") as done:
        done(800)
    assert "1000 of 1000 people" in capsys.readouterr().err


def test_people_below_the_validity_of_their_model_are_told():
    from glucoloop.situations.situation import configured
    from glucoloop.studies.trial.study import _notes
    from glucoloop.trials.trial import Trial

    nobody = {"count": 0, "person": []}
    told = {"people": 9, "setpoint_mg_dl": 81.1, "unable": nobody, "basal_beyond_pump": nobody}
    of = {
        "mpc": {"not_finite": nobody, "below_validity": {"count": 2, "person": [3, 7]}},
        "imc": {"not_finite": nobody, "below_validity": nobody},
    }
    assert list(_notes(configured(Trial), {**told, "controllers": of})) == [
        "mpc: glucose of 2 people was lower than the model is valid for: person 3, 7. Read it as severe hypoglycemia; "
        "its depth means nothing."
    ]
