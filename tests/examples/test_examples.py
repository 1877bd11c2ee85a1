"""Each example runs as it stands."""

import runpy
from pathlib import Path

import pytest

from glucoloop.cli import main

EXAMPLES = Path(__file__).parents[2] / "examples"


@pytest.fixture(autouse=True)
def _in_an_empty_folder(monkeypatch, tmp_path):
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(str(EXAMPLES))
    monkeypatch.setattr("sys.argv", ["example"])
    monkeypatch.setenv("GLUCOLOOP_CACHE_DIR", "off")


@pytest.mark.long
@pytest.mark.parametrize(
    ("name", "told"),
    [
        ("close_the_loop", "undershoot 10.2 mg/dl, settled in 345 min"),
        ("your_own_controller", "glucose from"),
        ("your_own_fault", "readings: 60, 80, 100"),
        ("your_own_sensor", "readings are behind glucose by up to"),
        ("your_own_pump", "delivery is behind the driven rate by up to 3.6 mU/min"),
        ("your_own_meal_model", "30 g of fat: largest appearance after 61 min"),
        ("your_own_estimator", "share=0.4"),
        ("your_own_sampler", "tried: "),
        ("your_own_reader", "readings: [101.0, 104.0]"),
        ("your_own_forecast", "forecast in mg/dl: 188.9, 168.4"),
        ("your_own_rhythm", "minutes of less sensitivity: 480, 480, 480"),
        ("your_own_metric", "time from 70 to 140 mg/dl: 91.8 %"),
        ("your_own_data", "1 of 576 samples were missing"),
        ("a_guarded_controller", "alone: glucose down to 59.9 mg/dl"),
        ("bergman", "27.7 mU/min hold 90 mg/dl"),
        ("a_population", "1000 people; undershoot: median 10.0, worst 22.2 mg/dl"),
    ],
)
def test_example(capsys, name, told):
    runpy.run_path(str(EXAMPLES / f"{name}.py"), run_name="__main__")
    assert told in capsys.readouterr().out


def test_every_example_has_its_test():
    names = {path.stem for path in EXAMPLES.glob("*.py")}
    tested = "".join(path.read_text() for path in Path(__file__).parent.glob("*.py"))
    assert names
    for name in names:
        assert f'"{name}"' in tested, name


@pytest.mark.parametrize(
    "kind",
    ["controller", "estimator", "fault", "meal_model", "metric", "pump", "reader", "rhythm", "sampler", "sensor"],
)
def test_a_component_of_ones_own_takes_fewer_than_40_lines(kind):
    assert len((EXAMPLES / f"your_own_{kind}.py").read_text().splitlines()) < 40


def test_a_patient_of_ones_own_takes_fewer_than_40_lines():
    assert len((EXAMPLES / "bergman.py").read_text().splitlines()) < 40


@pytest.mark.long
def test_configuration(capsys):
    with pytest.raises(SystemExit) as left:
        main(["run", "--config", str(EXAMPLES / "noisy.toml")])
    assert left.value.code == 0
    assert "knows of the dead time of 5 min" in capsys.readouterr().out
