"""A reader of your own: lines of a time and a reading in mg/dl, with a bar between them.

python examples/your_own_reader.py
glucoloop records diary.txt --reader your_own_reader:Diary
"""

import tempfile
from pathlib import Path

import polars as pl

import glucoloop as gl
from glucoloop.plugin import Extract, ReaderComponent, extract_frame, times_of


class Diary(ReaderComponent, name="diary"):
    """Lines of a time and a reading."""

    def recognised(self, content):
        return content.head[0].count("|") == 1

    def rows(self, content, answers):
        fields = pl.Series(content.text.splitlines()).str.split_exact("|", 1).struct.unnest()
        times, notes = times_of(fields["field_0"], answers)
        frame = extract_frame(fields, times, glucose=pl.col("field_1"))
        return Extract(frame=frame, glucose_unit="mg/dl", notes=tuple(notes))


if __name__ == "__main__":
    with tempfile.TemporaryDirectory() as folder:
        diary = Path(folder) / "diary.txt"
        diary.write_text("2024-03-13 07:00|101\n2024-03-13 07:05|104\n")
        record = gl.read_record(diary, reader="your_own_reader:Diary")
    print(f"readings: {record.frame['glucose_mg_dl'].to_list()}")
