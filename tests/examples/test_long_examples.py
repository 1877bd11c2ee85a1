"""Examples that compile much: training, and a loop over two processes that are killed."""

import json
import os
import random
import re
import runpy
import signal
import subprocess
import sys
import time
from pathlib import Path

import jax
import numpy as np
import pytest

import glucoloop as gl

EXAMPLES = Path(__file__).parents[2] / "examples"
SAMPLES = 8


def test_a_policy_gets_better_and_is_compared(capsys, monkeypatch):
    monkeypatch.setattr("sys.argv", ["example", "--generations", "3"])
    runpy.run_path(str(EXAMPLES / ("policy_search" + ".py")), run_name="__main__")
    told = capsys.readouterr().out
    best = [float(found) for found in re.findall(r"best (-\d+),", told)]
    assert len(best) == 3
    assert best[-1] > best[0]
    in_range = {row[0]: float(row[1]) for row in re.findall(r"^\| ([\w -]+) \| ([\d.]+) \|", told, re.MULTILINE)}
    assert set(in_range) == {"linear policy", "basal-bolus", "pid", "basal"}
    assert in_range["linear policy"] > in_range["basal"]


def test_ppo_of_stable_baselines_trains_and_is_measured(capsys, monkeypatch):
    pytest.importorskip("stable_baselines3")
    monkeypatch.setattr("sys.argv", ["example", "1"])
    runpy.run_path(str(EXAMPLES / ("train_ppo" + ".py")), run_name="__main__")
    assert [line.split()[0] for line in capsys.readouterr().out.splitlines()] == ["PPO", "basal-bolus"]


def test_training_lowers_the_cost(capsys, monkeypatch):
    monkeypatch.setattr("sys.argv", ["example", "2"])
    runpy.run_path(str(EXAMPLES / ("train_a_controller" + ".py")), run_name="__main__")
    costs = [
        float(line.split(" (mg/dl)^2")[0].split()[-1]) for line in capsys.readouterr().out.splitlines() if "^2" in line
    ]
    assert len(costs) == 4
    assert costs[1] < costs[0]
    assert costs[3] < costs[2]


def undisturbed():
    """Doses of the same loop in one process, and the patient at its end."""
    stepper = gl.Stepper(gl.patient(), gl.white_noise(1.45), key=1)
    pid = gl.design_pid(gl.PIDTuning(0.5, 150.0))
    step, seen, doses = jax.jit(pid.step), stepper.reset(), []
    state = pid.init(seen)
    for sample in range(SAMPLES):
        state, decision = step(state, seen)
        doses.append(float(decision.insulin_mU_min))
        seen = stepper.step(doses[-1], carbs_g=50.0 if sample == 3 else 0.0)
    return doses, stepper.save()


@pytest.mark.parametrize("seed", [1])
def test_both_processes_survive_being_killed(tmp_path, seed):
    """Each is killed once with SIGKILL, at a sample that the seed says."""
    rng = random.Random(seed)
    example = EXAMPLES / ("two_processes" + ".py")
    arguments = [sys.executable, str(example), "--folder", str(tmp_path), "--samples", str(SAMPLES)]
    running = subprocess.Popen(arguments)
    plan = {"patient": rng.randrange(1, SAMPLES - 1), "controller": rng.randrange(1, SAMPLES - 1)}
    decided = tmp_path / "controller.state"
    while running.poll() is None:
        done = len(json.loads(decided.read_bytes().partition(b"\n")[0])) if decided.exists() else 0
        for role, sample in list(plan.items()):
            if done >= sample:
                os.kill(json.loads((tmp_path / "processes").read_text())[role], signal.SIGKILL)
                del plan[role]
        time.sleep(0.001)
    assert running.returncode == 0
    assert not plan
    doses, end = undisturbed()
    np.testing.assert_array_equal(json.loads(decided.read_bytes().partition(b"\n")[0]), doses)
    assert (tmp_path / "patient.state").read_bytes() == end
