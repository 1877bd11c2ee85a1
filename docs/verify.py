"""Turn results of ``glucoloop verify`` into the table that ``guide/verify.md`` shows.

    glucoloop verify --seed 1 --controller mpc --controller mpc-se ... --json > most.json
    glucoloop verify --seed 1 --loops 2000 --controller meal-mpc --json > meal.json
    python docs/verify.py most.json meal.json

It rewrites ``guide/verify_figures.md``.
"""

import json
import sys
from pathlib import Path

from made import NAMES, made


def share(value):
    """A share of the time in percent."""
    return f"{value:.2f}" if value else "0"


def row(of):
    """Line of the table: what the guard does to the people of a controller."""
    low = " → ".join(share(of[key]) for key in ("bare_pct", "guarded_pct"))
    worst = f"+{of['worst_pct']:.1f}" if of["worse"] else "0"
    return f"| {NAMES[of['controller']]} | {of['pairs']} | {low} | {of['better']} | {of['worse']} | {worst} |"


def main(paths):
    results = [json.loads(Path(path).read_text(encoding="utf-8")) for path in paths]
    rows = {of["controller"]: row(of) for result in results for of in result["guarding"]}
    loops, samples = (sum(result[key] for result in results) for key in ("loops", "samples"))
    twice = sum(arm["repeated"] for result in results for arm in result["arms"])
    broken = sum(number for result in results for number in result["violations"].values())
    seeds = {result["seed"] for result in results}
    text = "\n".join(
        [
            f"Seed {', '.join(str(seed) for seed in sorted(seeds))}: {loops} loops of {samples} samples, with {twice} "
            f"of them closed twice. {'No promise was broken.' if not broken else f'{broken} promises were broken.'}",
            "",
            "| Controller | Pairs | Time below 60 mg/dl, mean, %, bare → guarded | Shorter with the guard | Longer "
            "| Worst, % of the run |",
            "| :--- | ---: | ---: | ---: | ---: | ---: |",
            *(rows[name] for name in NAMES if name in rows),
            "",
            f"Shorter and longer count people by more than 1 % of the run. The table was {made(*paths)}.",
        ]
    )
    (Path(__file__).resolve().parent / "guide" / "verify_figures.md").write_text(text + "\n", encoding="utf-8")
    print(text)


if __name__ == "__main__":
    main(sys.argv[1:])
