"""The command that reports records, from files and folders to the page and the numbers."""

import csv
import datetime as dt

import numpy as np
import polars as pl
import pytest

import device_files
from glucoloop.metrics.readings.catalogue import numbers_of
from glucoloop.metrics.readings.series import Readings
from monitor_records import with_gaps

FILES = {
    *(
        "figure.pdf",
        "figure.png",
        "figure.svg",
        "SHA256SUMS",
        "tables.tex",
        "days.csv",
        "episodes.csv",
        "metrics.csv",
        "metrics.parquet",
        "profile.csv",
        "report.html",
    ),
    *("report.json", "report.toml"),
}


@pytest.fixture
def record(tmp_path):
    """Write a record as a table, and give its readings."""

    def write(name="Doe_Jane_export.csv", days=14, seed=2):
        t_min, glucose = with_gaps(days, seed)
        times = [dt.datetime(2025, 1, 6) + dt.timedelta(minutes=t) for t in t_min.tolist()]
        pl.DataFrame({"time": times, "glucose_mg_dl": glucose}).write_csv(tmp_path / name)
        return Readings.of(t_min, glucose, dt.date(2025, 1, 6))

    return write


def test_a_report_holds_the_numbers_of_the_readings(glucoloop, record, tmp_path):
    readings = record()
    answer = glucoloop("report", "Doe_Jane_export.csv", "--out", "out", "--json")
    assert answer.code == 0, answer.err
    [found] = answer.json["records"]
    numbers = numbers_of(readings)
    assert {name: found[name] for name in numbers} == pytest.approx(numbers)
    assert (found["days_reported"], found["sufficient"]) == ("2025-01-06 to 2025-01-19", True)
    assert {place.name for place in (tmp_path / "out").iterdir()} == FILES
    metrics = pl.read_parquet(tmp_path / "out" / "metrics.parquet").to_dicts()[0]
    assert {name: metrics[name] for name in numbers} == pytest.approx(numbers)
    with open(tmp_path / "out" / "days.csv") as file:
        assert [row["day"] for row in csv.DictReader(file)][-1] == "2025-01-19"


@pytest.mark.long
def test_no_result_has_the_name_of_the_file(glucoloop, record, tmp_path):
    record()
    answer = glucoloop("report", tmp_path / "Doe_Jane_export.csv", "--out", "out", "--json")
    assert "Doe" not in answer.out
    assert not [place for place in (tmp_path / "out").iterdir() if b"Doe" in place.read_bytes()]


@pytest.mark.long
def test_no_result_has_a_name_or_a_serial_number_of_the_file(glucoloop, tmp_path):
    (tmp_path / "export.csv").write_text(device_files.clarity(600), encoding="utf-8")
    answer = glucoloop("report", "export.csv", "--out", "out", "--json")
    assert answer.code == 0, answer.err
    written = b"".join(place.read_bytes() for place in (tmp_path / "out").iterdir()) + answer.out.encode()
    for hidden in (device_files.NAME, device_files.SURNAME, device_files.SERIAL):
        assert hidden in (tmp_path / "export.csv").read_text(encoding="utf-8")
        assert hidden.encode() not in written


def test_periods_stand_side_by_side(glucoloop, record):
    record("a.csv")
    periods = ("--period", "2025-01-06/2025-01-08", "--period", "last-2")
    answer = glucoloop("report", "a.csv", *periods, "--json")
    assert [one["label"] for one in answer.json["records"]] == [
        "Record 1: 2025-01-06 to 2025-01-08",
        "Record 1: last-2",
    ]
    assert [round(one["days"]) for one in answer.json["records"]] == [3, 2]
    assert not any(one["sufficient"] for one in answer.json["records"])
    assert "The consensus asks for at least 14 days with 70 % of the readings" in answer.err


@pytest.mark.long
def test_insulin_and_carbohydrate_are_told_by_the_day_where_a_record_has_any(glucoloop, record, tmp_path):
    record()
    record("other.csv", seed=3)
    table = pl.read_csv("Doe_Jane_export.csv", try_parse_dates=True)
    breakfasts = [dt.datetime(2025, 1, 6, 7, 30) + dt.timedelta(days=day) for day in range(14)]
    rates = pl.DataFrame({"time": [dt.datetime(2025, 1, 5, 12)], "basal_U_h": [0.75]})
    doses = pl.DataFrame({"time": breakfasts, "bolus_U": [4.0] * 14, "carbs_g": [50.0] * 14})
    pl.concat([table, rates, doses], how="diagonal").write_csv("given.csv")
    answer = glucoloop("report", "given.csv", "other.csv", "--out", "out", "--json")
    assert answer.code == 0, answer.err
    with_doses, without = answer.json["records"]
    assert with_doses["insulin_U_day"] == pytest.approx(22.0)
    assert with_doses["basal_pct"] == pytest.approx(100.0 * 18.0 / 22.0)
    assert (with_doses["carbs_g_day"], with_doses["boluses_day"]) == (50.0, 1.0)
    assert without["insulin_U_day"] is None
    assert (
        with_doses["mean_mg_dl"]
        == glucoloop("report", "Doe_Jane_export.csv", "--json").json["records"][0]["mean_mg_dl"]
    )
    days = pl.read_csv("out/days.csv")
    assert days.filter(pl.col("record") == "Record 1")["bolus_U"].to_list()[1:-1] == [4.0] * 12
    assert days.filter(pl.col("record") == "Record 2")["bolus_U"].null_count() == 14
    page = (tmp_path / "out" / "report.html").read_text()
    assert page.count("Means of the whole days of which the record tells it") == 1
    assert "22.0 U" in page
    assert "Insulin" not in glucoloop("report", "other.csv", "--out", "alone").out
    assert "Insulin and carbohydrate" not in (tmp_path / "alone" / "report.html").read_text()


@pytest.mark.long
def test_the_insulin_of_a_run_is_told(glucoloop):
    meals = ("--announce-meals", "--meal", "60g@8h", "--days", 2)
    assert (
        glucoloop("run", "--patient", "hovorka-2004", "--controller", "basal-bolus", *meals, "--out", "run").code == 0
    )
    [found] = glucoloop("report", "run", "--json").json["records"]
    trace = pl.read_parquet("run/trace.parquet")
    total_mU = 5.0 * trace["insulin_mU_min"].sum() + trace["bolus_mU"].sum()
    assert found["insulin_U_day"] == pytest.approx(total_mU / 2000.0)
    assert (found["carbs_g_day"], found["boluses_day"]) == (60.0, 1.0)


@pytest.mark.long
def test_glucagon_is_told_by_the_day_where_a_record_has_any(glucoloop, record, tmp_path):
    readings = record()
    record("other.csv", seed=3)
    table = pl.read_csv("Doe_Jane_export.csv", try_parse_dates=True)
    noon = dt.datetime(2025, 1, 7, 12, 5, 30)
    times = [noon, noon + dt.timedelta(hours=10), noon + dt.timedelta(days=7), noon + dt.timedelta(days=20)]
    doses = pl.DataFrame({"time": times, "glucagon_ug": [100.0, 50.0, 60.0, 900.0]})
    pl.concat([table, doses], how="diagonal").write_csv("given.csv")
    first = ("--period", "2025-01-06/2025-01-12", "--period", "2025-01-13/2025-01-19")
    answer = glucoloop("report", "given.csv", "other.csv", *first, "--out", "out", "--json")
    assert answer.code == 0, answer.err
    days = [one["days"] for one in answer.json["records"]]
    of_a_day = [one["glucagon_ug_day"] for one in answer.json["records"]]
    assert of_a_day == pytest.approx([150.0 / days[0], 60.0 / days[1], 0.0, 0.0])
    by_day = pl.read_csv("out/days.csv").filter(pl.col("glucagon_ug") > 0)
    assert by_day.select("day", "glucagon_ug").rows() == [("2025-01-07", 150.0), ("2025-01-14", 60.0)]
    page = (tmp_path / "out" / "report.html").read_text()
    assert "150 ug of glucagon" in page
    assert "M120.9 0v9M220.9 0v9" in page  # 12:05:30 and 22:05:30 of a day that is 240 wide
    assert "mean glucagon of each hour" in page
    answer = glucoloop("report", "other.csv", "--out", "without", "--json")
    assert "glucagon" not in answer.out + (tmp_path / "without" / "report.html").read_text().replace("glucagon-", "")
    assert readings.day_0 == dt.date(2025, 1, 6)


@pytest.mark.long
def test_the_glucagon_of_a_run_and_of_each_case_is_told(glucoloop):
    meals = ("--announce-meals", "--carb-bias", 60, "--meal", "60g@1h", "--duration", "8h")
    wanted = ("--patient", "wilinska-2010-glucagon", *meals, "--glucagon")
    assert glucoloop("run", *wanted, "threshold", "--controller", "basal-bolus", "--out", "run").code == 0
    total = pl.read_parquet("run/trace.parquet")["glucagon_ug"].sum()
    [found] = glucoloop("report", "run", "--json").json["records"]
    assert total > 0.0
    assert found["glucagon_ug_day"] * found["days"] == pytest.approx(total)
    both = ("--controller", "basal-bolus", "--controller", "pid")
    assert glucoloop("compare", *wanted, "threshold", *both, "--out", "both").code == 0
    cases = pl.read_parquet("both/trace.parquet").group_by("case", maintain_order=True).agg(pl.sum("glucagon_ug"))
    told = {
        one["label"]: one["glucagon_ug_day"] * one["days"]
        for one in glucoloop("report", "both", "--json").json["records"]
    }
    assert told == pytest.approx(dict(cases.iter_rows()))


@pytest.mark.long
def test_many_files_have_a_row_each(glucoloop, record):
    for number in range(7):
        record(f"{number}.csv", days=2, seed=number)
    answer = glucoloop("report", *(f"{number}.csv" for number in range(7)), "--out", "out")
    assert answer.code == 0, answer.err
    assert [line.split()[:2] for line in answer.out.splitlines() if line.startswith(" Record ")][1:][-1] == [
        "Record",
        "7",
    ]
    assert pl.read_csv("out/metrics.csv")["record"].to_list() == [f"Record {number + 1}" for number in range(7)]


@pytest.fixture
def groups(record, tmp_path):
    """Two folders of people, one of whom has two files and one a file that cannot be read."""
    for place, name in enumerate(("Mustermann_a.csv", "b.csv", "c.csv", "d.csv")):
        folder = tmp_path / ("before" if place < 3 else "after")
        folder.mkdir(exist_ok=True)
        record(folder / name, days=3, seed=place)
    (tmp_path / "before" / "b.csv").write_bytes(b"PAR1 and nothing more")
    (tmp_path / "before" / ".DS_Store").write_bytes(b"hidden")
    person = tmp_path / "after" / "e"
    person.mkdir()
    start = device_files.START
    (person / "entries.json").write_text(device_files.nightscout_entries(600))
    (person / "treatments.json").write_text(
        device_files.nightscout_treatments((start, {"eventType": "Bolus", "insulin": 1.0}))
    )


@pytest.mark.long
def test_folders_are_groups_of_people_and_what_cannot_be_read_is_named(glucoloop, groups, tmp_path):
    answer = glucoloop("report", "before", "after", "--label", "before", "--label", "after", "--out", "out")
    assert answer.code == 1, answer.err
    assert "before: person 2 was not read: before/b.csv: it is a Parquet file" in answer.out
    metrics = pl.read_csv(tmp_path / "out" / "metrics.csv")
    assert metrics["record"].to_list() == ["before: person 1", "before: person 3", "after: person 1", "after: person 2"]
    assert metrics["group"].to_list() == ["before"] * 2 + ["after"] * 2
    found = pl.read_csv(tmp_path / "out" / "groups.csv").filter(group="before", metric="time_70_180_pct").to_dicts()[0]
    values = metrics.filter(group="before")["time_70_180_pct"].to_numpy()
    assert (found["people"], found["goal_reached_pct"]) == (2, 100.0)
    assert [found["mean"], found["sd"], found["median"]] == pytest.approx(
        [values.mean(), values.std(ddof=1), np.median(values)]
    )
    curves = pl.read_csv(tmp_path / "out" / "profile.csv")
    assert set(curves["record"]) == {*metrics["record"], "before", "after"}
    written = b"".join(place.read_bytes() for place in (tmp_path / "out").iterdir())
    assert b"Mustermann" not in written
    assert b"b.csv" not in written
    page = (tmp_path / "out" / "report.html").read_text()
    assert "1 record could not be read and is in no number: before: person 2." in page
    assert "before: person 2: it is a Parquet file, but no whole record" in page


def test_a_folder_is_a_group_whose_people_may_have_the_names_of_files(glucoloop, groups):
    answer = glucoloop("report", "before", "--json")
    assert (answer.code, [one["label"] for one in answer.json["records"]]) == (1, ["Person 1", "Person 3"])
    assert answer.json["not_read"] == [
        {
            "label": "Person 2",
            "why": "it is a Parquet file, but no whole record that glucoloop wrote: "
            "it is not a Parquet file; read the first file again",
        }
    ]
    assert [(one["label"], one["people"], one["sufficient"]) for one in answer.json["groups"]] == [("People", 2, 0)]
    named = glucoloop("report", "after", "--file-names", "--period", "last-1", "--period", "last-2", "--json").json
    assert [one["label"] for one in named["records"]] == [
        *("d.csv: last-1", "d.csv: last-2", "e: last-1", "e: last-2"),
    ]
    assert [one["label"] for one in named["groups"]] == ["after: last-1", "after: last-2"]


def test_units_are_those_asked_for(glucoloop, record):
    record("a.csv", days=2)
    assert "mmol/l" in glucoloop("report", "a.csv", "--units", "mmol/l").out


@pytest.mark.long
def test_a_file_that_was_written_repeats_the_report(glucoloop, record):
    record("a.csv", days=2)
    first = glucoloop("report", "a.csv", "--goals", "older", "--period", "last-1", "--out", "out", "--json")
    again = glucoloop("report", "a.csv", "--config", "out/report.toml", "--json")
    assert {**again.json, "files": {}} == {**first.json, "files": {}}


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        ((), "FILE... is missing"),
        (("none.csv",), "none.csv: it cannot be read"),
        (("a.csv", "--period", "soon"), "--period 'soon' is no period; give two dates"),
        (("a.csv", "--period", "last-0"), "give last-1 to last-3660"),
        (("a.csv", "--period", "2025-02-01/2025-01-01"), "ends before it begins"),
        (("a.csv", "--period", "2024-02-01/2024-02-02"), "its readings are from 2025-01-06 to 2025-01-07"),
        (("a.csv", "--label", "x", "--label", "y"), "--label is given 2 times for 1 file; give one for each"),
        (("a.csv", "--goals", "young"), "--goals is 'young'"),
        (("empty.csv",), "readings"),
        (("trial",), "trial holds no course of glucose; run it by `glucoloop trial --traces`"),
        (("damaged",), "damaged/a.csv: it is not text; give the file as it was exported, unzipped (and 1 more)"),
        (("a.csv", "--label", "x", "--file-names"), "--label and --file-names both name the records"),
        (("folder",), "folder is empty; give a folder with a file for each person"),
    ],
)
def test_what_cannot_be_reported_is_refused(refused, record, tmp_path, arguments, sentence):
    record("a.csv", days=2)
    (tmp_path / "empty.csv").write_text("time,glucose_mg_dl\n2025-01-06T00:00:00,100\n")
    (tmp_path / "folder").mkdir()
    (tmp_path / "trial" / "shards").mkdir(parents=True)
    (tmp_path / "damaged").mkdir()
    for name in ("a.csv", "b.csv"):
        (tmp_path / "damaged" / name).write_bytes(b"\0\1")
    assert sentence in refused("report", *arguments)


def test_each_traced_person_of_a_trial_is_a_record(glucoloop, tmp_path):
    t_min = [5.0 * sample for sample in range(289)]
    for shard, person in enumerate((3, 8)):
        (tmp_path / "trial" / "shards" / f"0000{shard}").mkdir(parents=True)
        table = {
            "person": [person] * 289,
            "controller": ["mpc"] * 289,
            "t_min": t_min,
            "glucose_mg_dl": [100.0 + person] * 289,
            "insulin_mU_min": [20.0 + person] * 288 + [None],
        }
        frame = pl.DataFrame(table, schema_overrides={"glucose_mg_dl": pl.Float32, "insulin_mU_min": pl.Float32})
        frame.write_parquet(tmp_path / "trial" / "shards" / f"0000{shard}" / "traces.parquet")
    records = glucoloop("report", "trial", "--json").json["records"]
    assert [(one["label"], one["mean_mg_dl"]) for one in records] == [("mpc person 3", 103.0), ("mpc person 8", 108.0)]
    insulin = [(one["insulin_U_day"], one.get("basal_pct")) for one in records]
    assert insulin == [(pytest.approx(23.0 * 1.44), None), (pytest.approx(28.0 * 1.44), None)]
    [group] = glucoloop("report", "trial", "--json").json["groups"]
    assert (group["label"], group["people"], group["mean_mg_dl"]["mean"]) == ("mpc", 2, 105.5)


def test_a_damaged_folder_is_refused(refused, tmp_path):
    (tmp_path / "run").mkdir()
    (tmp_path / "run" / "glucose_1min.parquet").write_bytes(b"PAR1 and nothing more")
    assert "run/glucose_1min.parquet is damaged" in refused("report", "run")


def test_a_simulated_course_is_reported_from_its_folder(glucoloop, tmp_path):
    (tmp_path / "run").mkdir()
    t_min = [float(minute) for minute in range(2881)]
    table = pl.DataFrame(
        {"case": ["a"] * 2881 + ["b"] * 2881, "t_min": t_min * 2, "glucose_mg_dl": [120.0, 121.0] * 2881}
    )
    table.write_parquet(tmp_path / "run" / "glucose_1min.parquet")
    records = glucoloop("report", "run", "--json").json["records"]
    assert [one["label"] for one in records] == ["a", "b"]
    assert [one["days_reported"] for one in records] == ["day 1 to day 3"] * 2
    assert records[0]["mean_mg_dl"] == pytest.approx(120.5, abs=1e-3)
    table.with_columns(person=7).rename({"case": "controller"}).write_parquet(tmp_path / "run" / "glucose_1min.parquet")
    assert [one["label"] for one in glucoloop("report", "run", "--json").json["records"]] == [
        "a person 7",
        "b person 7",
    ]
