"""The script that checks the claims keeps what is computed, goes on from it, and writes the tables."""

import numpy as np
import pytest

from meal_aware.measures import Runs, numbers_at_samples
from meal_aware.situations import CONTROLLERS

SMALL = ("--only", "juice", "--seeds", "2", "--seed", "899999", "--no-bounds")


@pytest.fixture
def script(docs_module, monkeypatch, tmp_path):
    """The script, for loops that are written down in place of closed ones."""
    module = docs_module("claims")
    module.closed, module.most = [], len(CONTROLLERS)

    def written(extent, situations, mismatches, *, controllers, done):
        for row in mismatches:
            for number, name in enumerate(controllers):
                if (row.name, name) in done:
                    continue
                if len(module.closed) == module.most:
                    raise KeyboardInterrupt
                module.closed.append(name)
                glucose = np.full((121, extent.seeds), 81.0)
                glucose[30] -= np.arange(extent.seeds) + 10.0 - 2.0 * number
                numbers = numbers_at_samples(glucose, np.full((120, extent.seeds), 25.6), 81.0, 5.0)
                yield row.name, name, Runs(run=np.arange(extent.seeds), numbers=numbers)

    monkeypatch.setattr(module, "close_loops", written)
    monkeypatch.setattr(module, "keep_compiled", lambda: None)
    monkeypatch.chdir(tmp_path)
    return module


@pytest.mark.long
def test_it_goes_on_where_it_was_stopped_and_writes_the_same_tables(script, tmp_path):
    script.main([*SMALL, "--out", "whole", "--figures", "whole.md"])
    assert script.closed == list(CONTROLLERS)
    script.closed, script.most = [], 2
    with pytest.raises(KeyboardInterrupt):
        script.main([*SMALL, "--out", "parts", "--figures", "parts.md"])
    assert not (tmp_path / "parts.md").exists()
    script.closed, script.most = [], len(CONTROLLERS)
    script.main([*SMALL, "--out", "parts", "--figures", "parts.md"])
    assert script.closed == list(CONTROLLERS[2:])
    assert (tmp_path / "parts.md").read_text() == (tmp_path / "whole.md").read_text()
    assert (tmp_path / "parts/claims_runs.json").read_text() == (tmp_path / "whole/claims_runs.json").read_text()


def test_tables_tell_what_was_found(script, tmp_path):
    script.main([*SMALL, "--figures", "tables.md"])
    told = (tmp_path / "tables.md").read_text()
    assert told.startswith("2 of 2 claims hold.\n")
    assert "| ≤ 6.00 | holds | 10.50 | 8.50 | 6.50 | 4.50 | 2.50 | 2 runs of seed 899999 |" in told
    assert "| 15 g of juice, white | 2 runs of seed 899999 | 10.5 (10.1 to 10.9) |" in told
    assert "seeds 900000 to 900000 of the sensor are here too: they are no independent test." in told


def test_runs_of_another_extent_are_not_mixed(script):
    script.main([*SMALL, "--figures", "tables.md"])
    with pytest.raises(SystemExit, match=r"claims_runs.json holds runs made with .*choose another folder with --out"):
        script.main([*SMALL, "--seeds", "3", "--figures", "tables.md"])
