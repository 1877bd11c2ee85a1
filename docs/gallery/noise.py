"""The same with a noisy sensor

Readings carry normal noise of variance 1.45 (mg/dl)²; the dots are readings, the lines glucose itself.
"""

import glucoloop as gl
from glucoloop.control.tuning import PARKER_1999

patient = gl.patient()
tuning = PARKER_1999["setpoint-81", True]
controllers = {
    "linear MPC": gl.design_linear_mpc(gl.identify(patient).model, tuning.mpc),
    "MPC/SE": gl.design_mpc_se(gl.linear_model(patient), patient.process_noise(*tuning.noise), tuning.mpc_se),
}
sensor = gl.white_noise(1.45)
traces = {name: gl.simulate(patient, controller, sensor, key=3) for name, controller in controllers.items()}

for name, trace in traces.items():
    found = gl.summarise(trace)
    moves = found.insulin_total_variation_mU_min
    print(f"{name}: undershoot {found.undershoot_mg_dl:.1f} mg/dl, insulin moved by {moves:.0f} mU/min in all")
figure = gl.plot(traces)
