"""The study of the paper: the printed numbers, the comparison, and a small run from end to end."""

import io
import json
import re
from dataclasses import replace
from html.parser import HTMLParser

import numpy as np
import pytest
from rich.console import Console

from glucoloop.reporting.figure_files import KINDS
from glucoloop.reproduction.parker1999 import Reproduction, experiments
from glucoloop.reproduction.parker1999.comparison import (
    DEVIATIONS,
    ENTRIES,
    INTERPRETATIONS,
    ComparedEntry,
    Reproduced,
    _PrintedEntry,
    compare,
    count,
    left_out,
    reason_for,
)
from glucoloop.reproduction.parker1999.study import (
    FIGURES,
    WHOLE,
    _chosen,
    _compared_results,
    _entry_tables,
    _ReproductionResults,
    files_of,
    page,
    results_of,
    tables,
)
from glucoloop.situations.situation import configured
from glucoloop.storage.results import Results

POINT = "setpoint-81"
# Tables I and II as printed on p. 155: undershoot, settling time, whether (17)-(19) hold.
TABLE_1 = {"imc": (8.7, 376), "mpc": (9.7, 343), "mpc-se": (4.4, 204), "nlqdmc-se": (3.6, 216)}
TABLE_2 = {
    "mpc": {
        "0": (15.4, 315, None),
        "5": (17.7, 316, True),
        "5M": (18.8, 358, True),
        "10": (21.1, 327, True),
        "10M": (21.9, 378, False),
        "15": (39.0, "551+", False),
        "15M": (25.1, 364, False),
    },
    "mpc-se": {
        "0": (12.5, 262, None),
        "5": (15.3, 494, True),
        "5M": (15.7, "551+", True),
        "10": (24.8, "551+", False),
        "10M": (17.6, "551+", True),
        "15": (29.7, "551+", False),
        "15M": (25.6, 536, False),
    },
}


@pytest.fixture(scope="session")
def study():
    wanted = experiments.all_experiments((0, 10), tunings=False)
    return experiments.study(POINT, wanted, seeds=4, seed=3, progress=lambda done: None)


def _entry(printed, kind="value"):
    return _PrintedEntry(
        id="x", what="x", printed=printed, page=155, place="", kind=kind, metric="", interpretations=()
    )


def _row(printed, found, kind="value"):
    return ComparedEntry(entry=_entry(printed, kind), reproduced={POINT: found})


class TestPublished:
    def test_holds_both_tables_as_printed(self):
        by_id = {entry.id: entry.printed for entry in ENTRIES}
        for name, (undershoot, settling) in TABLE_1.items():
            assert by_id[f"table-1.{name}.undershoot"] == undershoot
            assert by_id[f"table-1.{name}.settling"] == settling
        words = {True: "satisfied", False: "violated"}
        for name, rows in TABLE_2.items():
            for dead_time, (undershoot, settling, holds) in rows.items():
                stem = f"table-2.{name}.{dead_time}"
                assert by_id[f"{stem}.undershoot"] == undershoot
                assert by_id[f"{stem}.settling"] == settling
                assert by_id.get(f"{stem}.constraints") == words.get(holds)

    def test_every_entry_has_a_place_and_known_interpretations(self):
        assert len({entry.id for entry in ENTRIES}) == len(ENTRIES)
        for entry in ENTRIES:
            assert 148 <= entry.page <= 157
            assert entry.place
            assert entry.kind in ("value", "at-most")
            assert entry.interpretations
            assert set(entry.interpretations) <= set(INTERPRETATIONS)

    def test_every_interpretation_is_used(self):
        assert {name for entry in ENTRIES for name in entry.interpretations} == set(INTERPRETATIONS)


class TestVerdict:
    def test_a_number_within_a_tenth_agrees(self):
        assert _row(10.0, Reproduced(10.9)).agrees(POINT) is True
        assert _row(10.0, Reproduced(11.1)).agrees(POINT) is False

    def test_a_printed_number_among_the_seeds_agrees(self):
        assert _row(10.0, Reproduced(14.0, low=9.5, high=20.0)).agrees(POINT) is True
        assert _row(9.0, Reproduced(14.0, low=9.5, high=20.0)).agrees(POINT) is False

    def test_what_only_the_spread_makes_agree_is_told_apart(self):
        assert _row(10.0, Reproduced(14.0, low=9.5, high=20.0)).agrees_by_spread(POINT) is True
        assert _row(10.0, Reproduced(10.9, low=9.5, high=20.0)).agrees_by_spread(POINT) is False
        assert _row(9.0, Reproduced(14.0, low=9.5, high=20.0)).agrees_by_spread(POINT) is False
        assert _row(15.0, Reproduced(3.0, low=2.0, high=20.0), "at-most").agrees_by_spread(POINT) is False
        assert _row("551+", Reproduced(551.0, unsettled=True)).agrees_by_spread(POINT) is False
        assert ComparedEntry(entry=_row(1.0, Reproduced(1.0)).entry, reproduced={}).agrees_by_spread(POINT) is False

    def test_the_count_says_how_many_rest_on_the_spread(self):
        rows = [
            _row(10.0, found) for found in (Reproduced(14.0, low=9.5, high=20.0), Reproduced(10.0), Reproduced(1.0))
        ]
        told = "2 of 3 printed entries reproduce, 1 of them only within the spread of the seeds"
        assert count(rows, POINT) == told
        assert count(rows[1:], POINT) == "1 of 2 printed entries reproduce"

    def test_an_input_cannot_but_agree_and_is_not_counted_as_a_result(self):
        given = _row(81.0, Reproduced(81.0))
        given = replace(given, entry=replace(given.entry, input_at=(POINT,)))
        told = "2 of 3 printed entries reproduce; without 1 entry that is an input, 1 of 2"
        assert count([given, _row(1.0, Reproduced(1.0)), _row(1.0, Reproduced(2.0))], POINT) == told
        at = {entry.id: entry.input_at for entry in ENTRIES if entry.input_at}
        assert POINT in at["model.setpoint"]
        assert POINT in at["model.noise-variance"]
        assert POINT not in at["model.nominal-insulin"]

    def test_what_was_not_run_is_said_and_left_out(self):
        rows = [_row(1.0, Reproduced(1.0)), replace(_row(7.5, Reproduced(1.0)), reproduced={})]
        assert left_out(rows) == "1 printed entry not run and left out."
        assert left_out(rows[:1]) == ""
        rows = [replace(row, entry=replace(row.entry, id="table-1.x")) for row in rows]
        (table,) = _entry_tables(rows, {POINT: None})
        assert [line[1:3] for line in table.rows] == [("1", "1; +0.00; yes")]

    def test_the_terminal_shows_units_and_verdicts_and_explains_unsettled(self):
        rows = [
            _row(10.0, Reproduced(10.5)),
            _row(10.0, Reproduced(20.0)),
            _row("551+", Reproduced(551.0, unsettled=True)),
        ]
        rows = [replace(row, entry=replace(row.entry, unit="mg/dl")) for row in rows]
        request = Reproduction(operating_point=(POINT,))
        [table] = tables(request, Results({}, extra=_ReproductionResults({}, rows, ())))
        console = Console(width=100, record=True, file=io.StringIO())
        console.print(table)
        text = " ".join(console.export_text().split())
        assert "10 mg/dl 10.5; +0.50; yes" in text
        assert "10 mg/dl 20; +10.00; no" in text
        assert "551+: glucose has not settled by the end of the run." in text
        [table] = tables(request, Results({}, extra=_ReproductionResults({}, rows[:2], ())))
        console.print(table)
        assert "551+" not in console.export_text().split("no", 1)[1]

    def test_every_entry_of_the_tables_that_stands_out_has_its_reason(self):
        ids = {entry.id for entry in ENTRIES}
        assert all(any(entry.startswith(one.entries) for entry in ids) for one in DEVIATIONS)
        for entry in ("table-1.mpc-se.undershoot", "table-2.mpc-se.5M.settling", "table-2.mpc.10.constraints"):
            assert reason_for(entry, POINT)
        assert reason_for("table-1.imc.settling", POINT) == ""

    def test_a_bound_agrees_when_it_is_kept(self):
        assert _row(15.0, Reproduced(3.0), "at-most").agrees(POINT) is True
        assert _row(15.0, Reproduced(15.1), "at-most").agrees(POINT) is False

    def test_words_and_unsettled_runs(self):
        assert _row("violated", Reproduced("violated")).agrees(POINT) is True
        assert _row("violated", Reproduced("satisfied")).agrees(POINT) is False
        assert _row("551+", Reproduced(551.0, unsettled=True)).agrees(POINT) is True
        assert _row("551+", Reproduced(551.0)).agrees(POINT) is False

    def test_what_was_not_run_has_no_verdict(self):
        row = ComparedEntry(entry=_entry(1.0), reproduced={})
        assert row.agrees(POINT) is None
        assert row.difference(POINT) is None

    def test_percentiles_are_those_of_numpy(self):
        values = np.random.default_rng(0).normal(size=61)
        found = Reproduced.of(values)
        assert (found.low, found.median, found.high) == tuple(np.percentile(values, [10, 50, 90]))


class TestStudy:
    @pytest.mark.long
    def test_table_1_is_the_prototypes(self, study):
        expected = {"imc": (8.7, 386), "mpc": (10.2, 345), "mpc-se": (4.9, 203), "nlqdmc-se": (3.6, 211)}
        for name, (undershoot, settling) in expected.items():
            metrics = study.runs[name, experiments.NOISE_FREE].metrics
            assert abs(float(metrics.undershoot_mg_dl[0]) - undershoot) <= 0.3
            assert abs(float(metrics.settling_2pct_min[0]) - settling) <= 12

    @pytest.mark.long
    def test_noise_and_dead_time_cost_what_they_should(self, study):
        """Each noisy run is worse than the quiet one, and each dead time worse than none, for the same seeds."""
        for name in ("mpc", "mpc-se"):
            quiet = float(study.runs[name, experiments.NOISE_FREE].metrics.undershoot_mg_dl[0])
            prompt = np.asarray(study.runs[name, "0"].metrics.undershoot_mg_dl)
            late = np.asarray(study.runs[name, "10"].metrics.undershoot_mg_dl)
            assert np.all(prompt > quiet)
            assert np.all(late > prompt)

    @pytest.mark.long
    def test_a_run_is_the_same_whatever_is_carried_out_beside_it(self, study):
        wanted = FIGURES["4"].experiments
        again = experiments.study(POINT, wanted, seeds=4, seed=3, progress=lambda done: None)
        assert again.model is None
        assert set(again.runs) == {("mpc", "0"), ("mpc-se", "0")}
        for name in ("mpc", "mpc-se"):
            ours, theirs = (one.runs[name, "0"].metrics.undershoot_mg_dl for one in (study, again))
            np.testing.assert_array_equal(ours, theirs)

    @pytest.mark.long
    def test_every_entry_that_was_run_is_compared(self, study):
        rows = compare({POINT: study})
        left_out = {row.entry.id for row in rows if not row.reproduced}
        assert all(re.match(r"table-2\.[a-z-]+\.(5|15)M?\.|tuning\.|claim\.dead-time-5", id) for id in left_out)

    @pytest.mark.long
    def test_a_controller_of_ones_own_stands_in_both_tables(self, study):
        """Linear MPC under another name has its numbers to the bit, and nothing printed to agree with."""
        own = configured(Reproduction, controller=["mpc, label=mine"]).controller
        wanted = frozenset({experiments.NOISE_FREE, ("mpc", "10")})
        again = experiments.study(POINT, wanted, seeds=4, seed=3, progress=lambda done: None, own={"mine": own[0]})
        rows = {row.entry.id: row for row in compare({POINT: again}, ("table-",), ["mine"])}
        own_rows = [row for id, row in rows.items() if ".mine." in id and row.reproduced]
        assert len(own_rows) == 5  # undershoot and settling time in both, and the constraints
        printed = {(row.entry.controller, row.entry.situation, row.entry.metric): row for row in rows.values()}
        for row in own_rows:
            assert row.reproduced == printed["mpc", row.entry.situation, row.entry.metric].reproduced
            assert row.agrees(POINT) is None
        assert count(rows.values(), POINT) == count(compare({POINT: again}, ("table-",)), POINT)
        results = _compared_results({POINT: again}, WHOLE, 3, ["mine"])
        assert "mine, dead time 10 min: undershoot" in files_of(Reproduction(seed=3), results)["report.html"].decode()

    def test_controllers_that_have_no_place_are_refused(self):
        for given, message in (
            ({"controller": ["mpc"]}, "mpc is one of the paper's own controllers"),
            ({"controller": ["pid, label=a", "imc, label=a"]}, "two controllers are named 'a'"),
            ({"controller": ["pid"], "figure": ["2"]}, "leave --controller out, or name a table"),
        ):
            with pytest.raises(ValueError, match=message):
                results_of(configured(Reproduction, **given), progress=lambda done: None)

    def test_an_unknown_operating_point_is_refused(self):
        asked = Reproduction(operating_point=("nominal-23",))
        with pytest.raises(ValueError, match="known ones are: setpoint-81, nominal-22, fasting-81"):
            results_of(asked, progress=lambda done: None)


_VOID = "meta", "br", "img", "input"  # tags of HTML that are never closed


class _Tags(HTMLParser):
    def __init__(self):
        super().__init__()
        self.open, self.ids, self.used = [], [], set()

    def handle_starttag(self, tag, attrs):
        if tag not in _VOID:
            self.open.append(tag)
        for name, value in attrs:
            if name == "id":
                self.ids.append(value)
            self.used |= set(re.findall(r"url\(#([^)]+)\)", value or ""))
            if name.endswith("href"):
                assert value.startswith("#")
                self.used.add(value[1:])

    def handle_startendtag(self, tag, attrs):
        self.handle_starttag(tag, attrs)
        if tag not in _VOID:
            self.open.pop()

    def handle_endtag(self, tag):
        assert self.open.pop() == tag


@pytest.fixture(scope="module")
def files(study):
    return files_of_part(study, WHOLE)


def files_of_part(study, part):
    """The files of a part of the paper."""
    result = _compared_results({POINT: study}, part, 3)
    return {**result.files("report.json"), **files_of(Reproduction(seed=3), result)}


class TestReport:
    @pytest.mark.long
    def test_writes_figures_and_two_reports(self, files):
        figures = {f"{POINT}-figure-{number}.{kind}" for number in range(2, 7) for kind in KINDS}
        assert set(files) == figures | {"report.html", "report.json"}

    @pytest.mark.long
    def test_the_page_is_whole_and_needs_nothing_else(self, files):
        tags = _Tags()
        text = files["report.html"].decode()
        tags.feed(text)
        assert tags.open == []
        assert len(set(tags.ids)) == len(tags.ids)
        assert tags.used <= set(tags.ids)
        assert not re.search(r'<script|<link|src="(?!data:)', text)

    @pytest.mark.long
    def test_both_tell_the_same_number(self, files, study):
        found = Reproduced.of(study.runs["mpc", "0"].metrics.undershoot_mg_dl)
        entry = next(
            entry for entry in json.loads(files["report.json"])["entries"] if entry["id"] == "table-2.mpc.0.undershoot"
        )
        assert entry["reproduced"][POINT]["median"] == found.median
        assert found.text in files["report.html"].decode()

    @pytest.mark.long
    def test_a_part_of_the_paper_is_compared_drawn_and_told_alone(self, study):
        part = _chosen(["1"], ["4"])
        rows = compare({POINT: study}, part.entries)
        written = files_of_part(study, part)
        assert {row.entry.id.split(".")[0] for row in rows} == {"table-1", "figure-4"}
        assert all(row.reproduced for row in rows)
        figures = {f"{POINT}-figure-4.{kind}" for kind in KINDS}
        assert set(written) == figures | {"report.html", "report.json"}
        text = written["report.html"].decode()
        assert "Table I:" in text
        assert "Tunings" not in text
        assert "binary-sequence" not in text  # an interpretation on which nothing here rests

    @pytest.mark.long
    def test_a_figure_without_numbers_is_told_without_tables(self, study):
        written = files_of_part(study, _chosen([], ["2"]))
        assert json.loads(written["report.json"])["entries"] == []
        assert f"{POINT}-figure-2.pdf" in written
        assert b"<table" not in written["report.html"]

    def test_parts_that_are_not_reproduced_are_refused(self):
        assert _chosen([], []) is WHOLE
        assert _chosen(["ii", "2"], []).entries == ("table-2.",) * 2
        with pytest.raises(ValueError, match="unknown table 'III'; the known ones are: I, II"):
            _chosen(["III"], [])
        with pytest.raises(ValueError, match="unknown figure '1'; the known ones are: 2, 3, 4, 5, 6"):
            _chosen([], ["1"])

    @pytest.mark.long
    def test_what_does_not_reproduce_is_listed(self, study):
        wrong = replace(_entry(1.0), id="model.setpoint", what="A <number> that is far off")
        rows = [ComparedEntry(entry=wrong, reproduced={POINT: Reproduced(5.0)})]
        report = page({POINT: study}, rows, 3)
        assert "far off" in report.partition("What does not reproduce")[2]
        assert "<number>" not in report
