"""Times with their units, on the command line and in files, of faults, sensors and controllers."""

import pytest


@pytest.fixture
def asked(glucoloop, monkeypatch):
    """The request to which a run comes."""

    def command(*arguments):
        found = []

        def take(run, case):
            del case
            found.append(run)
            raise KeyboardInterrupt

        monkeypatch.setattr("glucoloop.studies.run.study.close_the_loop", take)
        answer = glucoloop("run", *arguments)
        assert answer.code == 130, answer.err
        return found[0]

    return command


def test_options_take_units(asked):
    plain = asked("--duration", 1440, "--sample-time", 6, "--controller", "imc, filter_min=30", "--meal", "50g@5h",
                  "--sensor", "lag, lag_min=12", "--fault", "missing, start_min=120, duration_min=90")  # fmt: skip
    units = asked("--duration", "1d", "--sample-time", ".1h", "--controller", "imc, filter_min=.5h",
                  "--meal", "50g@5h", "--sensor", "lag, lag_min=.2h",
                  "--fault", "missing, start_min=2h, duration_min=1.5h")  # fmt: skip
    assert units == plain
    assert plain.duration_min == 1440.0


def test_files_take_units(asked, tmp_path):
    (tmp_path / "a.toml").write_text(
        'duration_min = "10h"\nsensor = [{name = "dead-time", minutes = "10 min"}]\n'
        'faults = ["missing, start_min=2h"]\n'
        '[controller]\nname = "imc"\nfilter_min = "0.5h"\nknown_dead_time = true\n'
    )
    run = asked("--config", "a.toml")
    assert (run.duration_min, run.dead_time_min) == (600.0, 10.0)
    assert run.case.tuning["filter_min"] == 30.0
    assert run.fault_texts[0].startswith("missing, start_min=120")
