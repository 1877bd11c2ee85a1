"""Close the loop in a few lines: identify a patient, design a controller, simulate a meal, look at the result.

python examples/close_the_loop.py [FIGURE]
"""

import sys

import glucoloop as gl

patient = gl.patient()
model = gl.identify(patient).model
controller = gl.design_linear_mpc(model)
trace = gl.simulate(patient, controller)
metrics = gl.summarise(trace)

print(f"undershoot {float(metrics.undershoot_mg_dl):.1f} mg/dl, settled in {float(metrics.settling_2pct_min):.0f} min")
gl.plot(trace, title="Linear MPC, 50 g at 50 min").savefig(sys.argv[1] if len(sys.argv) > 1 else "loop.png")
