"""The commands that `same_numbers.py` carries out: small, and together they touch every part and every study.

A command is one or more lines, of which the last is the one in question; an earlier one writes what it reads. In the
old grammar of the command line a setting is an option of its own, in the new one it is given with its part; a command
that reads the same in both is written once.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field


@dataclass(frozen=True)
class Command:
    """Lines of a command line in both grammars, and the files that they read."""

    old: str
    new: str = ""
    """Lines in the new grammar; those of the old one by default."""
    files: Mapping[str, str] = field(default_factory=dict)
    """Texts of the files, by name; `{grammar}` in a line stands for the name of the grammar."""

    def lines(self, grammar: str) -> list[str]:
        text = self.new or self.old if grammar == "new" else self.old
        return [line.strip().replace("{grammar}", grammar) for line in text.strip().splitlines()]


_FAULTS = "--fault 'missing, start_min=60, duration_min=30' --fault 'calibration, gain=1.3'"

_OLD_FILE = """
duration_min = 240
noise_variance = 1.45
sensor = "lag, lag_min=8"
max_insulin_mU_min = 50
faults = ["missing, start_min=60, duration_min=30"]

[[case]]
label = "careful"
controller = "mpc"
move_weight = 1
memory = 48

[[case]]
label = "guarded"
controller = "imc"
guard = true
guard_max_hour = 2
"""

_NEW_FILE = """
duration_min = 240
sensor = [{name = "lag", lag_min = 8}, "white-noise, variance=1.45"]
faults = ["missing, start_min=60, duration_min=30"]

[pump]
max_insulin_mU_min = 50

[[controller]]
name = "mpc"
label = "careful"
move_weight = 1
model = {name = "identified", memory = 48}

[[controller]]
name = "imc"
label = "guarded"
guard = {name = "usual", max_hour = 2}
"""

_FILES = {"old.toml": _OLD_FILE, "new.toml": _NEW_FILE}

COMMANDS: dict[str, Command] = {
    # patients, and where they start
    "run": Command("run"),
    "run-noise": Command("run --noise 1.45 --seed 3"),
    "run-nominal-22": Command(
        "run --operating-point nominal-22 --duration 300",
        "run --patient operating_point=nominal-22 --duration 300",
    ),
    "run-fasting-81": Command(
        "run --patient parker-1999 --operating-point fasting-81 --noise 1.45 --duration 300",
        "run --patient 'parker-1999, operating_point=fasting-81' --noise 1.45 --duration 300",
    ),
    "run-hovorka-2004": Command("run --patient hovorka-2004 --duration 400"),
    "run-wilinska-2010": Command(
        "run --patient wilinska-2010 --site interstitial --noise 1.45 --duration 400",
        "run --patient wilinska-2010 --sensor 'ideal, site=interstitial' --noise 1.45 --duration 400",
    ),
    "run-setpoint": Command("run --setpoint 95 --initial-glucose 110 --duration 300"),
    "run-setpoint-again": Command(
        """
        run --setpoint 95 --initial-glucose 110 --noise 1.45 --duration 300 --out first
        run --config first/run.toml
        """
    ),
    "run-adaptive": Command("run --integrator adaptive --duration 300"),
    "run-sample-time": Command("run --sample-time 10 --duration 300"),
    # meals
    "run-no-meal": Command(
        "run --no-meal --initial-glucose 110 --duration 300", "run --meal none --initial-glucose 110 --duration 300"
    ),
    "run-meal-model": Command("run --meal-model hovorka --meal 40g@20min --meal 30g@2h/15min --duration 300"),
    # controllers
    "run-mpc": Command(
        "run --controller mpc --move-horizon 3 --prediction-horizon 12 --move-weight .5 --constraints qp "
        "--glucose-floor-mg-dl 72 --duration 300",
        "run --controller 'mpc, move_horizon=3, prediction_horizon=12, move_weight=.5, constraints=qp, "
        "glucose_floor_mg_dl=72' --duration 300",
    ),
    "run-nameless-settings": Command(
        "run --move-weight .5 --setting output_weight=2 --duration 300",
        "run --controller 'move_weight=.5, output_weight=2' --duration 300",
    ),
    "run-mpc-se": Command(
        "run --controller mpc-se --reference-filter .7 --offset-free output-disturbance --noise 1.45 --duration 300",
        "run --controller 'mpc-se, reference_filter=.7, offset_free=output-disturbance' --noise 1.45 --duration 300",
    ),
    "run-nlqdmc-se": Command(
        "run --controller nlqdmc-se --move-weight 1 --duration 300",
        "run --controller 'nlqdmc-se, move_weight=1' --duration 300",
    ),
    "run-meal-mpc": Command(
        "run --controller meal-mpc --caution-weight 5 --meals-by-time '0.6@06:30 0.02@22:00' --start 06:00 "
        "--noise 1.45 --duration 300",
        "run --controller \"meal-mpc, caution_weight=5, meals_by_time='0.6@06:30 0.02@22:00'\" --start 06:00 "
        "--noise 1.45 --duration 300",
    ),
    "run-imc": Command(
        "run --controller imc --filter-min 20 --delay-min 10 --duration 300",
        "run --controller 'imc, filter_min=20, delay_min=10' --duration 300",
    ),
    "run-pid": Command(
        "run --controller pid --closed-loop-min 40 --noise 1.45 --duration 300",
        "run --controller 'pid, closed_loop_min=40' --noise 1.45 --duration 300",
    ),
    "run-basal": Command("run --controller basal --duration 300"),
    "run-basal-bolus-announced": Command(
        "run --patient hovorka-2004 --controller basal-bolus --carb-ratio-g-U 12 --announce-meals --carb-error 20 "
        "--carb-bias -10 --meal 60g@1h --meal 40g@5h --max-bolus 4 --min-bolus .5 --bolus-step .25 --duration 480",
        "run --patient hovorka-2004 --controller 'basal-bolus, carb_ratio_g_U=12' --announce-meals --carb-error 20 "
        "--carb-bias -10 --meal 60g@1h --meal 40g@5h --pump 'max_bolus_U=4, min_bolus_U=.5, bolus_step_U=.25' "
        "--duration 480",
    ),
    # guards
    "run-guard": Command("run --guard --noise 1.45 --duration 300"),
    "run-guard-settings": Command(
        "run --controller imc --guard --guard-max-on-board .3 --guard-low-mg-dl 75 --duration 300",
        "run --controller imc --guard 'max_on_board=.3, low_mg_dl=75' --duration 300",
    ),
    # sensors
    "run-white-noise": Command(
        "run --noise 4 --noise-bound 2 --seed 5 --duration 300",
        "run --sensor 'white-noise, variance=4, bound_mg_dl=2' --seed 5 --duration 300",
    ),
    "run-white-noise-settings": Command(
        "run --sensor 'white-noise, variance=4, bound_mg_dl=6' --controller pid --duration 300"
    ),
    "run-correlated-noise": Command("run --sensor 'correlated-noise, variance=6, correlation=.8' --duration 300"),
    "run-chain": Command(
        "run --sensor 'lag, lag_min=8' --noise 1.45 --dead-time 10 --controller mpc-se --duration 300"
    ),
    "run-dead-time": Command(
        "run --sensor 'dead-time, samples=2' --controller imc --duration 300",
        "run --sensor 'dead-time, minutes=10' --controller imc --duration 300",
    ),
    "run-known-dead-time": Command(
        "run --dead-time 10 --known-dead-time --duration 300",
        "run --dead-time 10 --controller known_dead_time=true --duration 300",
    ),
    # pumps and faults
    "run-pump-limits": Command(
        "run --max-insulin 40 --min-insulin 15 --max-rate-change 3 --pump-resolution 1 --noise 1.45 --duration 300",
        "run --pump 'max_insulin_mU_min=40, min_insulin_mU_min=15, max_change_mU_min=3, resolution_mU_min=1' "
        "--noise 1.45 --duration 300",
    ),
    "run-expiring": Command(
        "run --pump 'expiring, samples=2' --max-insulin 50 --noise 1.45 "
        "--fault 'unheard, start_min=60, duration_min=40' --duration 300",
        "run --pump 'expiring, samples=2, max_insulin_mU_min=50' --noise 1.45 "
        "--fault 'unheard, start_min=60, duration_min=40' --duration 300",
    ),
    "run-faults": Command(
        "run --noise 1.45 --fault 'missing, per_day=20, duration_min=15' --fault 'spikes, per_day=10, size_mg_dl=-30' "
        "--fault 'occlusion, start_min=60, latest_min=120, duration_min=40, open_fraction=.2' --guard --seed 4"
    ),
    # models
    "run-model-settings": Command(
        "run --noise 1.45 --model-noise .5 --memory 48 --laguerre-pole .8 --laguerre-functions 3 --duration 300",
        "run --noise 1.45 --model 'noise_variance=.5, memory=48, laguerre_pole=.8, laguerre_functions=3' "
        "--duration 300",
    ),
    "run-model-file": Command(
        """
        identify --noise 1.45 --seed 2 --out first
        run --model first/model.json --duration 300
        """
    ),
    "identify": Command("identify --noise 1.45 --memory 48 --laguerre-functions 3 --best-pole"),
    "identify-record": Command(
        """
        run --controller pid --noise 1.45 --duration 2000 --out first
        identify --data first/trace.csv
        """
    ),
    # several controllers
    "compare": Command(
        "compare --bound --noise 1.45 --duration 300 --case mpc --case 'careful: mpc, move_weight=3' "
        "--case 'late: mpc-se, known_dead_time=true' --dead-time 5",
        "compare --bound --noise 1.45 --duration 300 --controller mpc --controller 'mpc, move_weight=3, label=careful' "
        "--controller 'mpc-se, known_dead_time=true, label=late' --dead-time 5",
    ),
    "compare-guards-and-models": Command(
        "compare --duration 300 --case 'safe: mpc, guard=true, guard_max_hour=2' --case 'long: mpc, memory=48' "
        "--case 'usual: mpc'",
        "compare --duration 300 --controller 'mpc, label=safe, guard=(usual, max_hour=2)' "
        "--controller 'mpc, label=long, model=(identified, memory=48)' --controller 'mpc, label=usual'",
    ),
    "compare-file": Command("compare --config {grammar}.toml", files=_FILES),
    "trial": Command(
        "trial --people 20 --seed 1 --noise 1.45 --meal-size-spread 30 --meal-time-spread 45 "
        "--case 'careful: mpc, move_weight=3' --case 'safe: mpc-se, guard=true, guard_max_on_board=1'",
        "trial --people 20 --seed 1 --noise 1.45 --meal-size-spread 30 --meal-time-spread 45 "
        "--controller 'mpc, move_weight=3, label=careful' "
        "--controller 'mpc-se, label=safe, guard=(usual, max_on_board=1)'",
    ),
    "trial-shared-settings": Command(
        "trial --people 20 --controller mpc --controller imc --move-weight 2 --guard --guard-max-on-board 1 "
        f"--duration 300 --meal 50g@50min --first-person 7 {_FAULTS}",
        "trial --people 20 --controller 'mpc, move_weight=2, label=mpc' --controller imc --guard max_on_board=1 "
        f"--duration 300 --meal 50g@50min --first-person 7 {_FAULTS}",
    ),
    "trial-individual": Command("trial --people 4 --design individual --duration 300 --meal 50g@50min --noise 1.45"),
    "trial-hovorka-2004": Command(
        "trial --people 6 --patient hovorka-2004 --controller mpc --duration 480 --meal 50g@50min --noise 1.45"
    ),
    "trial-float32-traces": Command(
        "trial --people 20 --precision float32 --arithmetic portable --traces all --population lognormal "
        "--duration 300 --meal 50g@50min --shard-people 8"
    ),
    "stress": Command(f"stress --people 4 --controller imc --controller mpc --duration 300 --seed 5 {_FAULTS}"),
    "stress-settings": Command(
        f"stress --people 4 --case 'slow: imc, filter_min=20' --guard-max-on-board 1 --duration 300 {_FAULTS}",
        "stress --people 4 --controller 'imc, filter_min=20, label=slow' --guard max_on_board=1 --duration 300 "
        f"{_FAULTS}",
    ),
    # studies
    "tune": Command(
        "tune --move-horizon 1:2 --prediction-horizon 4:8:2 --move-weight 0,1 --duration 300",
        "tune --controller 'mpc, move_horizon=1:2, prediction_horizon=4:8:2, move_weight=0|1' --duration 300",
    ),
    "tune-noise": Command(
        "tune --controller mpc-se --move-horizon 2 --prediction-horizon 6,8 --reference-filter .5:.7:.1 --noise 1.45 "
        "--seeds 3 --duration 300",
        "tune --controller 'mpc-se, move_horizon=2, prediction_horizon=6|8, reference_filter=.5:.7:.1' --noise 1.45 "
        "--seeds 3 --duration 300",
    ),
    "bound": Command(
        "bound --known-after 0 --known-after 20 --in-advance --max-insulin 50 --duration 300",
        "bound --known-after 0 --known-after 20 --in-advance --pump max_insulin_mU_min=50 --duration 300",
    ),
    "export": Command("export --controller imc --guard --samples 40"),
    "export-mpc": Command(
        "export --move-weight 1 --precision float64 --form compact --noise 1.45 --samples 40",
        "export --controller move_weight=1 --precision float64 --form compact --noise 1.45 --samples 40",
    ),
    "verify": Command("verify --loops 20 --controller imc --seed 2"),
    "adversary": Command(
        "adversary --controller mpc --guards both --error 20 --generations 3 --starts 2 --sequences 4 --people 4 "
        "--duration 300"
    ),
    "robust": Command(
        "robust --sampler random --batch 2 --rounds 2 --people 3 --seeds 3 --check-people 3 --check-seeds 3 "
        "--noise 1.45 --duration 300 --gut-doubt .2 --caution-weight 1:10",
        "robust --sampler random --batch 2 --rounds 2 --people 3 --seeds 3 --check-people 3 --check-seeds 3 "
        "--noise 1.45 --duration 300 --controller 'meal-mpc, gut_doubt=.2, caution_weight=1:10'",
    ),
    "detect": Command("detect --days 2 --controller basal"),
    "detect-settings": Command(
        "detect --days 2 --estimator kalman --meals-per-h .3",
        "detect --days 2 --estimator kalman --controller 'meal-mpc, meals_per_h=.3'",
    ),
}
