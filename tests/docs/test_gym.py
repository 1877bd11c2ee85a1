"""The page on reinforcement learning: its example runs as it stands, and its tables name what is there."""

import re
from pathlib import Path

import numpy as np
import pytest

from glucoloop.gym.rewards import REWARDS

PAGE = (Path(__file__).resolve().parents[2] / "docs/guide/gym.md").read_text(encoding="utf-8")


@pytest.mark.long
def test_the_example_runs():
    names = {}
    (code,) = re.findall(r"^```python\n(.*?)^```", PAGE, re.MULTILINE | re.DOTALL)
    exec(compile(code, "gym.md", "exec"), names)
    env, seen = names["env"], names["seen"]
    assert names["truncated"].all()
    assert env.observation_space.contains(seen)
    assert np.mean(names["info"]["glucose_mg_dl"] > 70.0) > 0.5
    for name in (*env.observation_names, *env.action_names, *REWARDS):
        assert f"| `{name}` |" in PAGE
