"""Commands as functions: the same words, numbers and refusals as on the command line."""

import json
import subprocess
import sys
import types

import numpy as np
import pytest

import glucoloop as gl


def printed(*arguments):
    done = subprocess.run(
        [sys.executable, "-m", "glucoloop", *arguments, "--json"], check=True, capture_output=True, text=True
    )
    return json.loads(done.stdout)


def test_a_run_has_the_numbers_of_the_command():
    result = gl.run(controller="pid, gain=0.4", noise=1.45, seed=3, meal=["45g@1h"], duration="3h", model=None)
    same = printed(
        *["run", "--noise", "1.45", "--seed", "3", "--meal", "45g@1h", "--duration", "3h", "--controller"],
        "pid, gain=0.4",
    )
    assert dict(result.results)["metrics"] == same["metrics"]
    [trace] = result.traces.values()
    assert float(np.min(trace.fine_glucose_mg_dl)) == pytest.approx(same["metrics"]["minimum_mg_dl"], rel=1e-12)


def test_numbers_keep_every_digit():
    noise = 1.4500000000000002
    [sensor] = gl.run(controller="pid", noise=noise, duration=60.0).config["sensor"]
    assert sensor["variance"] == noise


def test_components_mappings_and_lists_are_taken():
    result = gl.compare("pid", {"name": "pid", "gain": 0.2, "label": "careful"}, duration=120, guard=True)
    assert list(result.traces) == ["pid", "careful"]
    assert all(case["guard"] is not None for case in result.config["controller"])
    assert repr(result).startswith("<glucoloop compare: ")
    assert "careful" in str(result)
    assert result._repr_html_().startswith("<pre>")


def test_a_trial_is_kept_and_found_again(tmp_path):
    first = gl.trial(people=3, controller="pid", duration=120, out=tmp_path / "trial")
    again = gl.trial(people=3, controller="pid", duration=120, out=tmp_path / "trial")
    assert first.results == again.results
    assert any("finished before" in text for text in again.notes)
    assert set(first.files) == set(again.files)
    with pytest.raises(gl.Refusal, match="keeps no traces"):
        _ = first.traces


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"contoller": "mpc"}, "run has no option 'contoller'; did you mean 'controller'"),
        ({"noise": -1}, "--noise is -1"),
        ({"duration": 60, "duration_min": 60}, "given twice"),
        ({"seed": [1, 2]}, "takes one value"),
        ({"controller": "mcp"}, "mcp"),
    ],
)
def test_what_the_command_refuses_is_refused(options, message):
    with pytest.raises(gl.Refusal, match=message):
        gl.run(**options)


def test_an_option_without_effect_is_a_warning(capsys):
    with pytest.warns(gl.NoEffectWarning, match="--announce-meals has no effect"):
        gl.run(controller="pid", announce_meals=True, duration=60)
    assert capsys.readouterr().err == ""


def test_a_table_goes_to_pandas():
    pytest.importorskip("pandas")
    result = gl.run(controller="pid", duration=60)
    table = result.to_pandas("trace.csv")
    assert table["glucose_mg_dl"].tolist() == result.tables["trace.csv"]["glucose_mg_dl"].to_list()


def test_a_table_goes_to_pandas_by_lists_alone(monkeypatch):
    monkeypatch.setitem(sys.modules, "pandas", types.SimpleNamespace(DataFrame=dict))
    result = gl.run(controller="pid", duration=60)
    table = result.to_pandas()
    assert all(isinstance(column, list) for column in table.values())
    assert table == result.to_pandas(next(iter(result.tables)))


def test_a_report_has_the_numbers_of_the_command(tmp_path):
    rows = [f"2024-03-{1 + k // 288:02d}T{k // 12 % 24:02d}:{k % 12 * 5:02d},{100 + k % 50}" for k in range(288 * 15)]
    file = tmp_path / "record.csv"
    file.write_text("\n".join(["time,glucose_mg_dl", *rows]))
    result = gl.report(file, period="last-14", label="A")
    same = printed("report", str(file), "--period", "last-14", "--label", "A")
    assert result.results["records"] == same["records"]
    assert "Time active" in str(result)
    assert gl.report(files=str(file), period="last-14", label="A").results == result.results


def test_a_figure_shows_itself_in_a_notebook():
    figure = gl.run(controller="pid", duration=60).plot()
    assert figure._repr_png_().startswith(b"\x89PNG")
