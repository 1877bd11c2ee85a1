"""Tables of a workbook as texts: a program of its own, which `user_files._sheets_of` starts.

The library that opens workbooks takes as much memory as a workbook of a thousand bytes asks for, and ends the process
that it cannot serve; here that process is not the user's.
"""

import contextlib
import datetime
import importlib
import io
import re
import sys

MEMORY_BYTES = 4_000_000_000
SHEET_END = "\f"
_BREAKS = re.compile(r'[\x00-\x1f\x7f\x85\u2028\u2029"]+')


def text_of(cell: object) -> str:
    """Text of a cell, without signs that divide fields or lines."""
    if isinstance(cell, bool):
        return str(cell).lower()
    if isinstance(cell, float) and cell.is_integer():
        return str(int(cell))
    if isinstance(cell, datetime.datetime):
        return cell.isoformat(sep=" ")
    if isinstance(cell, datetime.timedelta):
        minutes, seconds = divmod(round(cell.total_seconds()), 60)
        return f"{minutes // 60}:{minutes % 60:02d}:{seconds:02d}"
    return _BREAKS.sub(" ", str(cell)).strip()


def main() -> None:
    """Write the tables of the workbook on standard input, each with a line that names it, divided by tabs."""
    with contextlib.suppress(ImportError, ValueError, OSError):  # where a system has no such limit
        import resource

        resource.setrlimit(resource.RLIMIT_AS, (MEMORY_BYTES, MEMORY_BYTES))
        resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    # `user_files._sheets_of` has checked that the package is there, and this process imports no other module of ours.
    calamine = importlib.import_module("python_calamine")
    workbook = calamine.CalamineWorkbook.from_filelike(io.BytesIO(sys.stdin.buffer.read()))
    for name in workbook.sheet_names:
        lines = ("\t".join(map(text_of, row)) for row in workbook.get_sheet_by_name(name).to_python())
        text = "\n".join([f"Sheet: {text_of(name)}", *lines, SHEET_END])
        sys.stdout.buffer.write(text.encode(errors="replace"))


if __name__ == "__main__":
    main()
