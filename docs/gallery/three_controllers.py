"""Three controllers in the same situation

Linear MPC on an identified model, MPC with a Kalman filter on the linearised patient (MPC/SE), and internal model
control on a first-order model (IMC).
"""

import glucoloop as gl
from glucoloop.control.tuning import PARKER_1999

patient = gl.patient()
tuning = PARKER_1999["setpoint-81", False]
first_order = gl.fit_step(patient)
controllers = {
    "linear MPC": gl.design_linear_mpc(gl.identify(patient).model, tuning.mpc),
    "MPC/SE": gl.design_mpc_se(gl.linear_model(patient), patient.process_noise(*tuning.noise), tuning.mpc_se),
    "IMC": gl.design_imc(first_order.gain, first_order.tau_min, first_order.delay_min),
}
traces = {name: gl.simulate(patient, controller) for name, controller in controllers.items()}

for name, trace in traces.items():
    print(f"{name}: undershoot {gl.summarise(trace).undershoot_mg_dl:.1f} mg/dl")
figure = gl.plot(traces)
