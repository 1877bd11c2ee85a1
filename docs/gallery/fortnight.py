"""Two weeks of a virtual person, as clinics see them

Meals that vary, snacks, missed boluses and weekends under pump therapy: the percentiles of glucose over the day, and
the time in each range.
"""

from glucoloop.metrics.readings import Readings, numbers_of
from glucoloop.reporting.record_figure import plot_records
from glucoloop.reporting.record_groups import GOALS, ReportedRecord
from glucoloop.situations.run import Run
from glucoloop.situations.situation import configured
from glucoloop.studies.closed_loop import close_the_loop

run = configured(
    Run, patient="hovorka-2004", scenario="week", days=14, sensor=["dexcom-g6"], controller=["basal-bolus"]
)
trace = close_the_loop(run, run.case).trace
readings = Readings.of(trace.fine_t_min, trace.fine_glucose_mg_dl)
numbers = numbers_of(readings)

print(f"{numbers['time_70_180_pct']:.1f} % of the time from 70 to 180 mg/dl")
figure = plot_records([ReportedRecord(label="14 days", readings=readings, numbers=numbers)], GOALS["adult"])
