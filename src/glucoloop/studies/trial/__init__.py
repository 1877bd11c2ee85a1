"""Trial: controllers on a population of virtual people, in a folder that can be resumed."""

from __future__ import annotations

from typing import Final

from glucoloop.studies.study import COMPONENTS_HELP, TrialStudy
from glucoloop.trials.trial import Trial

TRIAL: Final = TrialStudy(
    name="trial",
    what="a trial",
    help=(
        "Simulate controllers on a population of virtual people; the results are tables, percentiles over time and a "
        "page.\n\n"
        "The folder holds one row for each person and controller, and is written in parts (shards). After Ctrl-C, a "
        "kill or a full disk, the same command continues where it stopped, and the results are the same to the bit. By "
        "default linear MPC is simulated on 1000 people whose metabolism varies as in Parker et al. (2000), for a day "
        "with three meals.\n\n"
        f"{COMPONENTS_HELP}\n\n"
        "  glucoloop trial --people 10000 --controller mpc --controller mpc-se --seed 1 --out trial\n\n"
        "  glucoloop trial --scenario 'week, days=14' --noise 1.45 --out fortnight\n\n"
        "  glucoloop trial --controller mpc --controller 'mpc, move_weight=3, label=careful' --out weights\n\n"
        "  glucoloop trial --people 1000000 --precision float32 --dask tcp://10.0.0.1:8786 --out million"
    ),
    module="glucoloop.studies.trial.study",
    request=Trial,
    option_texts={
        "help": {
            "patient": "Patient, around whom people vary and for whom controllers are designed.",
            "setpoint_mg_dl": "Glucose at which all people rest at the start, and the target; that of the operating "
            "point by default.",
            "seed": "The same seed gives the same people, meals and noise.",
        },
        "rare": dict.fromkeys(
            ("sample_time_min", "design", "traces", "allow_unusual", "meal_size_spread_pct", "meal_time_spread_min"),
            True,
        ),
    },
    on_clusters=True,
    files=("bands.parquet", "figure.pdf", "figure.png", "figure.svg", "report.html"),
)
