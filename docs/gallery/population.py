"""A population

300 people whose metabolism varies as in Parker et al. (2000), all under a controller designed for the nominal patient.
"""

import matplotlib.pyplot as plt
import numpy as np

import glucoloop as gl

people = gl.virtual_people(gl.population("parker2000"), seed=1, person=range(300))
controller = gl.design_linear_mpc(gl.identify(gl.patient()).model)
run = gl.simulate_people(people, controller)
lowest = run.metrics.minimum_mg_dl

print(f"lowest glucose: median {np.median(lowest):.1f}, worst {lowest.min():.1f} mg/dl")
print(f"{np.mean(lowest < 70.0):.0%} of the people go below 70 mg/dl")
figure, (above, below) = plt.subplots(2, figsize=(7.1, 4.5), layout="constrained")
shares = np.percentile(run.glucose_mg_dl, [1, 5, 25, 50, 75, 95, 99], axis=1)
for low, high, opacity in ((0, 6, 0.15), (1, 5, 0.25), (2, 4, 0.4)):
    above.fill_between(run.t_min, shares[low], shares[high], color="#0072B2", alpha=opacity, linewidth=0)
above.plot(run.t_min, shares[3], color="#0072B2")
above.set(xlabel="Time (min)", ylabel="Glucose (mg/dl)\n50, 90, 98 % of people")
below.hist(lowest, bins=40, color="#0072B2")
below.axvline(70.0, color="black", linestyle="--")
below.set(xlabel="Lowest glucose (mg/dl)", ylabel="People")
