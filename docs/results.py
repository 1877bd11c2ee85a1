"""Turn a report of ``glucoloop reproduce parker1999`` into the results that ``guide/reproducing.md`` shows.

    glucoloop reproduce parker1999 --out parker1999
    python docs/results.py parker1999/report.json

It rewrites ``guide/parker1999.md``.
"""

import json
import sys
from pathlib import Path

SECTIONS = {
    "Table I: disturbance rejection without noise": "table-1.",
    "Table II: dead time, with noise": "table-2.",
    "Figures and claims of the text": ("figure-", "claim."),
    "Patient, model and identification": "model.",
    "Tunings": "tuning.",
}


def number(value):
    return value if isinstance(value, str) else f"{value:.0f}" if abs(value) >= 100.0 else f"{value:.3g}"


def cell(result, is_input):
    """Median, percentiles, and whether it agrees; a tilde where only the spread of the seeds makes it agree."""
    if result is None:
        return "not run"
    middle = "551+" if result["unsettled"] else number(result["median"])
    spread = "" if result["p10"] is None else f" ({number(result['p10'])} to {number(result['p90'])})"
    text = f"{middle}{spread}"
    if is_input and result["agrees"]:
        return f"{text} (input)"
    if result["agrees_by_spread"]:
        return f"{text} ~"
    return text if result["agrees"] else f"*{text}*"


def page(report):
    points = list(report["seeds"])
    entries = report["entries"]
    counts = {
        point: [entry["reproduced"][point]["agrees"] for entry in entries if point in entry["reproduced"]]
        for point in points
    }
    by_spread = {
        point: sum(entry["reproduced"][point]["agrees_by_spread"] for entry in entries if point in entry["reproduced"])
        for point in points
    }
    results = {
        point: [
            entry["reproduced"][point]["agrees"]
            for entry in entries
            if point in entry["reproduced"] and point not in entry["input_at"]
        ]
        for point in points
    }
    told = "; ".join(
        f"{sum(agrees)} of {len(agrees)} printed entries agree at `{p}`, {by_spread[p]} of them by the spread of the "
        f"seeds alone, and {sum(results[p])} of {len(results[p])} without the entries that are inputs"
        for p, agrees in counts.items()
    )
    seeds = report["seeds"][points[0]]
    lines = [f"With {seeds} seeds, glucoloop {report['version']}: {told}.\n"]
    lines.append(
        "Entries in italics do not agree. "
        "Entries with a tilde agree only because the printed number lies within the spread of the seeds.\n"
    )
    for heading, prefix in SECTIONS.items():
        lines += [f"**{heading}**\n", "| Entry | Printed | " + " | ".join(f"`{point}`" for point in points) + " |"]
        lines.append("| :--- | :--- |" + " :--- |" * len(points))
        for entry in entries:
            if not entry["id"].startswith(prefix):
                continue
            bound = "at most " if entry["kind"] == "at-most" else ""
            printed = f"{bound}{number(entry['printed'])} {entry['unit']}".strip()
            result = [cell(entry["reproduced"].get(point), point in entry["input_at"]) for point in points]
            lines.append("| " + " | ".join([entry["what"], printed, *result]) + " |")
        lines.append("")
    return "\n".join(lines)


if __name__ == "__main__":
    if len(sys.argv) != 2:
        sys.exit(__doc__)
    told = page(json.loads(Path(sys.argv[1]).read_text(encoding="utf-8")))
    (Path(__file__).resolve().parent / "guide" / "parker1999.md").write_text(told, encoding="utf-8")
