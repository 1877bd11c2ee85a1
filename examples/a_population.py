"""Does a controller hold for everybody? A thousand virtual people, one meal, and who fares worst."""

import numpy as np

import glucoloop as gl

people = gl.virtual_people(gl.population("parker2000"), seed=1, person=range(1000))
controller = gl.design_linear_mpc(gl.identify(gl.patient()).model)
run = gl.simulate_people(people, controller)

undershoot = run.metrics.undershoot_mg_dl
print(f"{people.able.sum()} people; undershoot: median {np.median(undershoot):.1f}, worst {undershoot.max():.1f} mg/dl")

worst = int(undershoot.argmax())
basal = people.basal_insulin_mU_min[worst]
print(f"Person {people.draw.person[worst]} has the lowest glucose; the basal rate is {basal:.1f} mU/min.")
for parameter, values in people.draw.values.items():
    print(f"    {parameter:18} {values[worst]:8.3f}")
