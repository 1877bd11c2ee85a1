"""A model from noisy readings

The patient gets pulses of insulin, and readings carry noise of variance 1.45. The estimated coefficients are smoothed
by two Laguerre functions.
"""

import jax

import glucoloop as gl
from glucoloop.reporting import plot_identification

patient = gl.patient()
noisy = gl.identify(patient, gl.white_noise(1.45), jax.random.key(1))
truth = gl.identify(patient)

print(f"{noisy.model.memory} samples of {noisy.model.sample_time_min:g} min")
for label, found in {"with noise": noisy, "without": truth}.items():
    print(f"{label}: gain {found.model.step_response[-1]:.2f} mg/dl per mU/min")
figure = plot_identification(noisy, truth=truth.impulse_response)
