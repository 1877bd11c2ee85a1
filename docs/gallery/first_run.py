"""A first loop

Linear MPC on a model identified from the patient, 50 g of glucose at 50 min, an ideal sensor.
"""

import glucoloop as gl

patient = gl.patient()
model = gl.identify(patient).model
trace = gl.simulate(patient, gl.design_linear_mpc(model))
metrics = gl.summarise(trace)

print(f"undershoot {metrics.undershoot_mg_dl:.1f} mg/dl")
print(f"settled in {metrics.settling_2pct_min:.0f} min")
figure = gl.plot(trace)
