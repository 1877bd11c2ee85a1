"""Does a controller hold for everybody? A thousand virtual people, one meal, and who fares worst."""

import numpy as np

import glucoloop as gl

people = gl.virtual_people(gl.population("parker2000"), seed=1, person=range(1000))
controller = gl.design_linear_mpc(gl.identify(gl.patient()).model)
run = gl.simulate_people(people, controller)

undershoot = run.metrics.undershoot_mg_dl
median, worst = np.median(undershoot), undershoot.max()
print(f"{people.feasible.sum()} people; undershoot: median {median:.1f}, worst {worst:.1f} mg/dl")

lowest = int(undershoot.argmax())
basal = people.basal_insulin_mU_min[lowest]
print(f"Person {people.draw.person[lowest]} has the lowest glucose; the basal rate is {basal:.1f} mU/min.")
for parameter, values in people.draw.values.items():
    print(f"    {parameter:18} {values[lowest]:8.3f}")
