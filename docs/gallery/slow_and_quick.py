"""A slow loop and a quick one

The same PID controller, asked to be slow or quick, and a meal that nobody told it of. The slow one lets glucose rise
higher, and, since its insulin comes late, lets it fall lower too.
"""

import glucoloop as gl
from glucoloop.situations.run import Run
from glucoloop.situations.situation import configured
from glucoloop.studies.closed_loop import close_the_loop

traces = {}
for name, minutes in {"slow": 100, "quick": 10}.items():
    run = configured(Run, controller=[f"pid, closed_loop_min={minutes}"])
    outcome = close_the_loop(run, run.case)
    traces[name] = outcome.trace
    print(f"{name}: glucose from {outcome.metrics.minimum_mg_dl:.1f} to {outcome.metrics.peak_mg_dl:.1f} mg/dl")
figure = gl.plot(traces)
