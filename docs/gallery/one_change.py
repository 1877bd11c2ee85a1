"""One thing changed: the move weight

With weight on its moves the controller gives less insulin at once. Glucose rises higher, and the insulin that comes
late lets it fall lower, too.
"""

import glucoloop as gl

patient = gl.patient()
model = gl.identify(patient).model
traces = {}
for weight in (0.0, 3.0):
    controller = gl.design_linear_mpc(model, gl.MPCTuning(move_weight=weight))
    traces[f"move weight {weight:g}"] = gl.simulate(patient, controller)

for label, trace in traces.items():
    metrics = gl.summarise(trace)
    peak, undershoot = metrics.peak_mg_dl, metrics.undershoot_mg_dl
    print(f"{label}: peak {peak:.1f}, undershoot {undershoot:.1f} mg/dl")
figure = gl.plot(traces)
