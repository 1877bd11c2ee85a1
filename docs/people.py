"""Turn trials of the paper's controllers into the tables that ``guide/trials.md`` shows.

    glucoloop trial --people 10000 --duration 600 --meal 50g@50min --controller imc --controller mpc \
        --controller mpc-se --controller nlqdmc-se --seed 1 --out quiet
    ... --noise 1.45 --out noisy
    python docs/people.py quiet/summary.json noisy/summary.json

It rewrites ``guide/people.md``; with ``--page NAME`` another page, as that of another patient's people:

    glucoloop trial --patient hovorka-2004 --people 200 --meal 50g@50min --controller imc --controller pid \
        --controller mpc --controller mpc-se --seed 1 --out quiet
    ... --noise 1.45 --out noisy
    python docs/people.py --page people_of_hovorka quiet/summary.json noisy/summary.json
"""

import json
import sys
from pathlib import Path

from made import made

COLUMNS = (
    "Controller",
    "Undershoot, median",
    "95 % of people",
    "Worst",
    "Ever below 60 mg/dl, % of people",
    "Time below 60 mg/dl, mean %",
    "Worst %",
)


def row(label, result):
    undershoot, below = result["metrics"]["undershoot_mg_dl"], result["metrics"]["time_below_60_pct"]
    cells = [
        label,
        *(f"{undershoot[name]:.1f}" for name in ("median", "p95", "max")),
        f"{result['ever_below']['60_mg_dl']['share_pct']:.2f}",
        f"{below['mean']:.3f}",
        f"{below['max']:.1f}",
    ]
    return f"| {' | '.join(cells)} |"


def table(summary):
    config = summary["config"]
    noise = sum(part["variance"] for part in config["sensor"] if part["name"] == "white-noise")
    lines = [
        f"{'With noise of variance ' + format(noise, 'g') if noise else 'Without noise'}, "
        f"{summary['able']} people of `{config['population']}`, seed {config['seed']}:",
        "",
        f"| {' | '.join(COLUMNS)} |",
        f"| :--- |{' ---: |' * (len(COLUMNS) - 1)}",
        *(row(label, result) for label, result in summary["controllers"].items()),
    ]
    return "\n".join(lines)


def main(arguments):
    page, paths = (arguments[1], arguments[2:]) if arguments[0] == "--page" else ("people", arguments)
    summaries = [json.loads(Path(path).read_text(encoding="utf-8")) for path in paths]
    text = "\n\n".join(table(summary) for summary in summaries)
    text += f"\n\nThe tables were {made(*paths, version=summaries[0]['version'])}.\n"
    (Path(__file__).resolve().parent / "guide" / f"{page}.md").write_text(text, encoding="utf-8")
    print(text)


if __name__ == "__main__":
    main(sys.argv[1:])
