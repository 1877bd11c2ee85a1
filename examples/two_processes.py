"""A loop over two processes: a patient, a controller, and a socket between them. Either may be killed at any moment.

    python examples/two_processes.py [--samples 12] [--folder FOLDER]

The patient's process asks nothing of the controller's but doses, and the other way round. Each writes what it remembers
to a file before it says anything, so that it goes on where it was when it is started again:

- The patient delivers a dose only for the sample at which it is. A dose that comes twice is delivered once.
- The controller decides once for each sample. When it is asked again, it gives the same dose again.

So what was done is what an undisturbed loop would have done, to the last bit. Here the patient waits for its doses; a
pump would go on with the basal rate instead.
"""

import argparse
import json
import os
import socket
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import jax

import glucoloop as gl

MEALS_G = {3: 50.0}
"""By the number of the sample with which each begins."""


def keep(path: Path, data: bytes) -> None:
    """Write a file whole or not at all, whatever happens meanwhile."""
    part = path.with_suffix(".part")
    with part.open("wb") as file:
        file.write(data)
        file.flush()
        os.fsync(file.fileno())
    part.replace(path)


def patient(folder: Path, samples: int) -> None:
    """Tell the controller what the sensor reads, and deliver what it answers, until the end."""
    stepper = gl.Stepper(gl.patient(), gl.white_noise(1.45), key=1)
    saved = folder / "patient.state"
    seen = stepper.restore(saved.read_bytes()) if saved.exists() else stepper.reset()
    with socket.create_server(("127.0.0.1", 0)) as server:
        keep(folder / "port", str(server.getsockname()[1]).encode())
        while stepper.sample < samples:
            connection, _ = server.accept()
            with connection, connection.makefile("rw") as wire:
                while stepper.sample < samples:
                    now = {
                        "sample": stepper.sample,
                        "glucose_mg_dl": float(seen.glucose_mg_dl),
                        "delivered_mU_min": float(seen.delivered_mU_min),
                        "setpoint_mg_dl": float(seen.setpoint_mg_dl),
                    }
                    if not tell(wire, now) or (answer := hear(wire)) is None:
                        break  # the controller died; wait for the next one
                    if answer["sample"] != stepper.sample:
                        continue
                    seen = stepper.step(answer["insulin_mU_min"], carbs_g=MEALS_G.get(stepper.sample, 0.0))
                    keep(saved, stepper.save())


def controller(folder: Path) -> None:
    """Answer each reading with a dose, as long as there is a patient."""
    pid = gl.design_pid(gl.PIDTuning(0.5, 150.0))
    step = jax.jit(pid.step)
    saved, state, doses = folder / "controller.state", None, []
    while True:
        with connected(folder) as connection, connection.makefile("rw") as wire:
            while (now := hear(wire)) is not None:
                sample = now.pop("sample")
                seen = gl.observation(now.pop("glucose_mg_dl"), **now)
                if state is None:
                    state = pid.init(seen)
                    if saved.exists():
                        state, doses = restored(saved.read_bytes(), state)
                if sample == len(doses):
                    state, decision = step(state, seen)
                    doses.append(float(decision.insulin_mU_min))
                    keep(saved, json.dumps(doses).encode() + b"\n" + gl.snapshot.pack(state, "PID"))
                if not tell(wire, {"sample": sample, "insulin_mU_min": doses[sample]}):
                    break


def restored(data: bytes, like):
    """State and doses of a controller that was killed."""
    doses, _, state = data.partition(b"\n")
    return gl.snapshot.unpack(state, like, "PID"), json.loads(doses)


def connected(folder: Path) -> socket.socket:
    """A connection to the patient, whenever there is one."""
    while True:
        try:
            return socket.create_connection(("127.0.0.1", int((folder / "port").read_text())))
        except (OSError, ValueError):
            time.sleep(0.02)


def tell(wire, message: dict) -> bool:
    """Send a line; whether somebody is there to hear it."""
    try:
        wire.write(json.dumps(message) + "\n")
        wire.flush()
    except OSError:
        return False
    return True


def hear(wire) -> dict | None:
    """A whole line, or None if there is nobody any more."""
    try:
        line = wire.readline()
    except OSError:
        return None
    return json.loads(line) if line.endswith("\n") else None


def start(role: str, folder: Path, samples: int) -> subprocess.Popen:
    """One of the two processes."""
    return subprocess.Popen([sys.executable, __file__, role, "--folder", folder, "--samples", str(samples)])


def told(folder: Path, running: dict[str, subprocess.Popen]) -> None:
    """Write down which processes these are, for whoever wants to kill them."""
    keep(folder / "processes", json.dumps({role: process.pid for role, process in running.items()}).encode())


def both(folder: Path, samples: int) -> None:
    """Keep both processes running until the patient has come to the end."""
    running = {role: start(role, folder, samples) for role in ("patient", "controller")}
    told(folder, running)
    while running["patient"].poll() != 0:
        for role, process in running.items():
            if process.poll():  # not None and not 0
                running[role] = start(role, folder, samples)
                told(folder, running)
        time.sleep(0.02)
    running["controller"].kill()
    running["controller"].wait()
    doses = json.loads((folder / "controller.state").read_bytes().partition(b"\n")[0])
    print(f"{len(doses)} doses, the last {doses[-1]:.2f} mU/min")


if __name__ == "__main__":
    options = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    options.add_argument("role", nargs="?", choices=["both", "patient", "controller"], default="both")
    options.add_argument("--samples", type=int, default=12)
    options.add_argument("--folder", type=Path, default=None)
    chosen = options.parse_args()
    place = Path(tempfile.mkdtemp()) if chosen.folder is None else chosen.folder
    if chosen.role == "both":
        both(place, chosen.samples)
    elif chosen.role == "patient":
        patient(place, chosen.samples)
    else:
        controller(place)
