"""Commands as functions: the same words, numbers and refusals as on the command line."""

import json
import pickle
import subprocess
import sys
import types
from datetime import timedelta

import jax.numpy as jnp
import numpy as np
import polars as pl
import pytest

import glucoloop as gl
from naming import naming


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


def test_values_of_other_packages_are_the_same_values():
    for name, given, same in (
        ("seed", np.int64(3), 3),
        ("duration", np.array([60]), 60),
        ("duration", jnp.array(60), 60),
        ("duration", timedelta(hours=1), 60),
        ("duration", np.str_("1h"), 60),
        ("duration", pl.Series([60]), 60),
        ("meal", gl.Meal(45.0, 30.0), ["45g@30min"]),
        ("meal", (text for text in ["45g@30min"]), ["45g@30min"]),
        ("meal", np.array(["45g@30min"]), ["45g@30min"]),
        ("controller", gl.control.PID, "pid"),
        ("controller", gl.design_pid(gl.PIDTuning(0.5, 150.0)), "pid, gain=0.5, integral_time=150, derivative_time=0"),
        ("patient", gl.patient("parker-1999", "nominal-22"), "parker-1999, operating_point=nominal-22"),
    ):
        with naming(f"{name}={given!r}"):
            options = {"controller": "pid", "duration": 60, "noise": 1.0}
            config, other = (gl.run(**{**options, name: value}).config for value in (given, same))
            for case in (*config["controller"], *other["controller"]):
                case.pop("label")
            assert config == other


def test_a_component_of_python_has_the_defaults_of_the_patient():
    given = gl.run(controller=gl.control.LinearMPC(), patient="hovorka-2004", duration=60)
    assert given.config == gl.run(controller="mpc", patient="hovorka-2004", duration=60).config


def test_what_a_configuration_cannot_have_is_refused_and_not_made_anew():
    patient = gl.patient()
    model = gl.identify(patient).model
    for name, value, lost in (
        (
            "controller",
            gl.design_linear_mpc(model),
            "the controller mpc holds what .* say .step_response, plan.*gl.sim",
        ),
        (
            "patient",
            patient.replaced(setpoint_mg_dl=jnp.array(100.0)),
            "the patient parker-1999 has constants, or a steady state, that",
        ),
        (
            "sensor",
            gl.sensors.Lag(inner=gl.white_noise(9.0)),
            r"the sensor lag .*\(inner\).* list, the innermost first",
        ),
        ("sensor", {"lag"}, "sensor is a set, which has no order; give a list"),
        ("seed", np.random.default_rng(1), "seed is of the type Generator; give a number"),
        ("out", b"o", "out is of the type bytes"),
        ("out", "a\0b", "out has a character that no text has, NUL"),
        ("duration", np.ma.masked, "duration_min is of the type MaskedConstant"),
    ):
        with naming(name), pytest.raises(gl.Refusal, match=lost):
            gl.run(**{"controller": "pid", "duration": 60, name: value})


def test_a_trial_is_kept_and_found_again(tmp_path):
    first = gl.trial(people=3, controller="pid", duration=120, out=tmp_path / "trial")
    again = gl.trial(people=3, controller="pid", duration=120, out=tmp_path / "trial")
    assert first.results == again.results
    assert any("finished before" in text for text in again.notes)
    assert set(first.files) == set(again.files)
    with pytest.raises(gl.Refusal, match="keeps no traces"):
        _ = first.traces


def test_results_go_to_other_processes(tmp_path):
    for result in (
        gl.run(controller="pid", duration=60),
        gl.compare(controller=["pid", "basal"], duration=60),
        gl.trial(people=2, controller="pid", duration=60, out=tmp_path / "trial"),
    ):
        with naming(result.command):
            same = pickle.loads(pickle.dumps(result))
            assert same.results == result.results
            assert str(same) == str(result)


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


@pytest.mark.parametrize("value", [True, False])
def test_a_place_is_no_truth(value, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(gl.Refusal, match=f"out is {value}; give the name of a place, or leave it out"):
        gl.run(patient="hovorka-2004", controller="basal-bolus", out=value)
    assert not list(tmp_path.iterdir())
