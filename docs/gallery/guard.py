"""A sensor that gets stuck, with a guard and without

From 150 min on the sensor repeats one reading for three hours. A controller that believes it goes on giving insulin;
the guard stops trusting it, and falls back to the basal rate and then to half of it.
"""

import glucoloop as gl
from glucoloop.faults import Stuck, once

patient = gl.patient()
mpc = gl.design_linear_mpc(gl.identify(patient).model)
sensor = Stuck(schedule=once(start_sample=30, samples=36), inner=gl.white_noise(1.45))
traces = {
    name: gl.simulate(patient, controller, sensor, key=1)
    for name, controller in {"alone": mpc, "guarded": gl.guarded(mpc)}.items()
}

for name, trace in traces.items():
    print(f"{name}: glucose down to {gl.summarise(trace).minimum_mg_dl:.1f} mg/dl")
figure = gl.plot(traces)
