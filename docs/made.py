"""Words that tables of several pages share: names of controllers, and when and with which version figures were made."""

from datetime import date, datetime
from pathlib import Path

import glucoloop

NAMES = {
    "mpc": "MPC",
    "mpc-se": "MPC/SE",
    "nlqdmc-se": "NLQDMC/SE",
    "profile-mpc": "MPC by profile",
    "therapy-mpc": "MPC by therapy settings",
    "meal-mpc": "Meal-aware MPC",
    "imc": "IMC",
    "pid": "PID",
    "pid-ifb": "PID with insulin feedback",
    "loop-like": "Loop-like",
    "basal-bolus": "Basal and bolus",
    "basal": "Basal rate",
    "oref0": "oref0",
}


def made(*results, version=glucoloop.__version__):
    """Words on the newest of some files with results; without one, on what was computed just now."""
    on = max((datetime.fromtimestamp(Path(path).stat().st_mtime).date() for path in results), default=date.today())
    return f"made on {on.isoformat()} with glucoloop {version}"
