"""Situations simulated by the modules of the page, in node."""

import json
import shutil
import subprocess
from pathlib import Path

import pytest

from glucoloop import faults as parts
from glucoloop.lab.pack import DATA, PAGE
from glucoloop.native.targets.wasm import _HOST

NODE = shutil.which("node")


@pytest.fixture(scope="session")
def in_node(tmp_path_factory):
    """Answers of the page's modules to situations, or to the parts of links after the #."""
    if NODE is None:
        pytest.skip("needs node (Debian: apt install nodejs)")

    def ask(situations, built=PAGE):
        folder = tmp_path_factory.mktemp("page")
        request, answer = folder / "request.json", folder / "answer.json"
        request.write_text(json.dumps(situations))
        script = Path(__file__).with_name("simulate.mjs")
        subprocess.run([NODE, script, PAGE, _HOST, request, answer, built], check=True, timeout=300)
        return json.loads(answer.read_text())

    return ask


@pytest.fixture(scope="session")
def data():
    """Data of the page."""
    return json.loads(DATA.read_text(encoding="utf-8"))


LATE_MIN = {"pid": 5.0, "imc": 10.0, "mpc": 15.0, "mpc-se": 5.0}
"""Dead time of the guarded loops with each controller, which is part of a loop's program."""
FAULTS = {
    ("pid", False): ("missing", "occlusion"),
    ("imc", False): ("repeated", "spikes", "battery"),
    ("mpc", False): ("stuck", "drift", "occlusion"),
    ("mpc-se", False): ("calibration", "compression", "unheard"),
    ("pid", True): ("saturation", "nonsense", "resolution"),
    ("imc", True): ("missing", "unheard"),
    ("mpc", True): ("drift", "occlusion"),
    ("mpc-se", True): ("stuck", "compression", "battery"),
}
"""Faults that the loops with each controller may have, the first innermost."""
OTHERS = {
    ("pid", False): ("missing", "late", "missed-pulses"),
    ("imc", False): ("out-of-order", "repeated", "spikes", "battery"),
}
"""Faults in the place of some of these, drawn apart, so that nothing else of the corpus depends on them."""
PROGRAM = {"late": {"delay_min": 20.0}, "out-of-order": {"among": 5}}
"""Settings that are part of a loop's program in glucoloop."""
MONITORS = {("mpc-se", False): "dexcom-g6", ("imc", True): "facchinetti-2014"}
"""Continuous glucose monitors of the loops with each controller."""
NOTICED = ("mpc", True)
"""Loops whose pump reports an occlusion."""


@pytest.fixture(scope="session")
def loops_faults():
    """Faults of the loops with each controller, guarded or not, with the settings by which they do nothing."""

    def idle(name, noticed):
        never = (
            {"noticed": True} if noticed and name == "occlusion" else {"share": 0.0} if name == "missed-pulses" else {}
        )
        return {**parts.FAULTS[name].idle, **PROGRAM.get(name, {}), **never}

    return {
        which: [parts.FAULTS[name](**idle(name, which == NOTICED)) for name in names]
        for which, names in {**FAULTS, **OTHERS}.items()
    }


@pytest.fixture(scope="session")
def corpus(data):
    """Generated situations: every controller and fault, with and without a guard, and limits of their own.

    They are of the families whose people the page draws; `test_page_equations.py` has loops of the others.
    """
    import numpy as np

    rng, found = np.random.default_rng(17), []
    families = [name for name in data["families"] if name in data["people"]]
    for i in range(216):
        family = data["families"][families[i // 8 % len(families)]]
        patients = [name for name, of in data["patients"].items() if data["families"][of["family"]] is family]
        controller = list(family["controllers"])[i % 4]  # those of all families; test_page_boluses.py has the others
        noisy, guard = bool(rng.integers(2)), bool(i // 4 % 2)
        settings = family["controllers"][controller]["settings"]
        tuning = {}
        for name in rng.permutation(list(settings))[: rng.integers(0, 3)].tolist():
            of = settings[name]
            value = rng.uniform(of["least"], of["most"])
            tuning[name] = round(value) if of["whole"] else round(float(value), 2)
        if tuning.get("move_horizon", 2) > tuning.get("prediction_horizon", 24):
            tuning["prediction_horizon"] = 24
        if tuning.get("move_horizon", 2) > 2 and tuning.get("move_weight", 1.0) < 0.5:
            tuning["move_weight"] = 0.5
        if tuning.get("derivative_time_min", 0.0) < 0.0:
            tuning["derivative_time_min"] = -1.0
        told = rng.permutation(list(family["guard_limits"]))[: rng.integers(0, 4) if guard else 0].tolist()
        found.append(
            {
                "patient": patients[i // 24 % len(patients)],
                "controller": controller,
                "tuning": tuning,
                "guard": guard,
                "guard_limits": {name: drawn(family["guard_limits"][name], rng) for name in told},
                "pump_limits": {"max_insulin_mU_min": 45.0, "max_change_mU_min": 8.0} if i % 10 == 7 else {},
                "faults": [
                    faulty(name, data["faults"][name], rng, (controller, guard) == NOTICED)
                    for name in FAULTS[controller, guard]
                    if rng.integers(2)
                ],
                "meals": [
                    {"t_min": float(rng.integers(0, 500)), "carbs_g": float(rng.integers(5, 120))}
                    for _ in range(rng.integers(0, 4))
                ],
                "monitor": None,
                "noise_variance": float(rng.integers(1, 40)) / 10.0 if noisy else 0.0,
                "dead_time_min": LATE_MIN[controller] if guard else 0.0,
                "seed": int(rng.integers(data["seeds"])),
                "duration_min": 600.0,
                "announce": False,
                "announce_before_min": 0.0,
                "announced_late_min": 0.0,
            }
        )
    rng = np.random.default_rng(18)
    for situation in found:
        names = OTHERS.get((situation["controller"], situation["guard"]))
        if names is not None:
            chosen = [name for name in names if rng.integers(2)]
            situation["faults"] = [faulty(name, data["faults"][name], rng, False) for name in chosen]
    rng = np.random.default_rng(19)
    for situation in found:
        name = MONITORS.get((situation["controller"], situation["guard"]))
        if name is not None:
            settings = {setting: False for setting in ("noise", "drift") if rng.integers(4) == 0}
            if rng.integers(3):
                settings["worn_min"] = float(rng.integers(0, data["monitors"][name]["settings"]["worn_min"]["most"]))
            if rng.integers(4) == 0:
                settings["worn_min"] = (
                    data["monitors"][name]["settings"]["worn_min"]["most"] - 300.0
                )  # soon another one
            situation |= {"monitor": {"name": name, "settings": settings}, "noise_variance": 0.0}
    return found


def drawn(setting, rng):
    """A value of a setting that the page offers, near the default one."""
    low, high = (0.5 * setting["usual"] + 0.5 * setting[end] for end in ("least", "most"))
    value = float(rng.uniform(low, high))
    return round(value) if setting["whole"] else round(value, 2)


def faulty(entry_name, entry, rng, noticed):
    """A fault with times and settings of its own."""
    settings = {
        name: drawn(setting, rng)
        for name, setting in entry["settings"].items()
        if name != "noticed" and rng.integers(2)
    } | PROGRAM.get(entry_name, {})
    if "noticed" in entry["settings"] and noticed:
        settings["noticed"] = True
    lasting = float(rng.integers(5, 240)) if rng.integers(4) else None
    start = float(rng.integers(0, 480)) if entry["timed"] else 0.0
    return {
        "name": entry_name,
        "start_min": start,
        "duration_min": lasting if entry["timed"] else None,
        "settings": settings,
    }
