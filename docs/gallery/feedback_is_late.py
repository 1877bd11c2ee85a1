"""Feedback alone is late under the skin

A meal of 60 g. Feedback sees glucose rise when most of the meal is on its way; pump therapy is told of the meal, and
gives a bolus as eating begins.
"""

import glucoloop as gl
from glucoloop.situations.run import Run
from glucoloop.situations.situation import configured
from glucoloop.studies.closed_loop import close_the_loop

traces = {}
for name, controller in {"feedback": "pid", "told": "basal-bolus"}.items():
    run = configured(
        Run,
        patient="hovorka-2004",
        meals=["60g@60min"],
        duration_min=720,
        announce_meals=True,
        controller=[controller],
    )
    outcome = close_the_loop(run, run.case)
    traces[name] = outcome.trace
    print(f"{name}: glucose from {outcome.metrics.minimum_mg_dl:.1f} to {outcome.metrics.peak_mg_dl:.1f} mg/dl")
figure = gl.plot(traces)
