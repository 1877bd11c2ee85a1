"""Readings, boluses and carbohydrate are those that cgm-format, an independent reader, finds in the same files."""

import pytest

from device_files import START, carelink, clarity, every, glucose, libre, nightscout_entries
from other_programs import answer_of

SCRIPT = """
from cgm_format import FormatParser
told = {}
for name, text in asked.items():
    text = FormatParser.decode_raw_data(text.encode())
    known = name != "nightscout" and FormatParser.detect_format(text)
    table = FormatParser.parse_to_unified(text, known) if known else FormatParser.parse_nightscout(text)
    table = table.with_columns(table["datetime"].dt.strftime("%Y-%m-%d %H:%M:%S"))
    told[name] = {
        column: table.filter(table[column].is_not_null()).select("datetime", column).rows()
        for column in ("glucose", "insulin_fast", "carbs")
        if column in table.columns
    }
print(json.dumps(told))
"""
OURS = {"glucose": "glucose_mg_dl", "insulin_fast": "bolus_U", "carbs": "carbs_g"}
PUMP = [
    (
        START,
        {"Bolus Number": "1", "Bolus Type": "Normal", "Bolus Volume Selected": "3,0", "Bolus Volume Delivered": "2,9"},
    ),
    (START, {"BWZ Carb Input": "35", "Basal Rate": "1,0"}),
]
FILES = {
    "clarity": clarity(
        300,
        events=[("Carbs", "", "", "", "45"), ("Insulin", "Fast-Acting", "", "4.5", ""), ("Alert", "Low", "", "", "")],
    ),
    "clarity in mmol/l": clarity(3).replace("mg/dL),I", "mmol/L),I").replace("G6,1", "G6,5.1"),
    "libre": libre(300, events=[(4, "Rapid-Acting Insulin (units)", 5.5), (5, "Carbohydrates (grams)", 30)]),
    "carelink": carelink(PUMP, [(time, {"Sensor Glucose": str(glucose(n))}) for n, time in enumerate(every(5, 300))]),
    "nightscout": nightscout_entries(300, offset=0),
}


@pytest.fixture(scope="module")
def theirs():
    return answer_of("cgm-format", SCRIPT, FILES)


@pytest.mark.parametrize("name", FILES)
def test_the_same_is_found(read, theirs, name):
    record = read(FILES[name])
    for column, values in theirs[name].items():
        told = record.frame.select("time", OURS[column]).drop_nulls()
        assert told["time"].dt.strftime("%Y-%m-%d %H:%M:%S").to_list() == [time for time, _ in values]
        # mmol/l is 18 mg/dl there and 18.0156 here
        assert told[OURS[column]].to_list() == pytest.approx([value for _, value in values], rel=1e-3)
    assert theirs[name]["glucose"]
