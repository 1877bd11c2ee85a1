"""Why was this dose given?

Each thin line is the forecast on which a dose rests: where oref0 expects glucose to go at the basal rate, by insulin
and carbohydrate on board. At 2 h it counts the announced meal and its bolus, and expects glucose to rise an hour later
than it does in this patient; from 3 h on it follows what happens.
"""

import glucoloop as gl

result = gl.run(
    patient="hovorka-2004",
    controller="oref0",
    meal=["60g@2h", "50g@7h"],
    announce_meals=True,
    duration="14h",
    forecasts=True,
)
forecasts = result.tables["forecasts.csv"]
for row in forecasts.filter(forecasts["t_min"] == 120.0).iter_rows(named=True):
    if row["ahead_min"] % 60.0 == 0.0:
        print(f"{row['ahead_min']:3.0f} min after the meal: {row['glucose_mg_dl']:.0f} mg/dl expected")
figure = gl.plot(result.traces, subcutaneous=True)
