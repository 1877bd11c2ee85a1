"""Search for the worst sensor errors under other settings of the guard, and draw what each setting costs at a meal.

    python docs/trade_off.py searches.json

It makes the searches that the file does not hold yet, which takes some minutes, and rewrites
``guide/guard_trade_off.png`` and the tables ``guide/guard_trade_off.md`` and ``guide/guard_rules.md``.
"""

import json
import sys
from pathlib import Path

from made import NAMES, made

from glucoloop.reporting import _style
from glucoloop.situations.situation import configured
from glucoloop.studies.adversary import Adversary
from glucoloop.studies.adversary.study import search

GUIDE = Path(__file__).resolve().parent / "guide"
CONTROLLERS = ("mpc", "mpc-se")
SEARCH = {"errors_pct": [10.0, 30.0], "generations": 40, "people": 1}
WORST_PCT, PEAK_MG_DL = 30.0, 113.0
BOUND = {"color": _style.GREY, "linewidth": 0.6, "linestyle": (0, (4, 2)), "zorder": 0}
DEFAULT = (60.0, 5.0)
NO_TARGET = 1.0
"""Glucose for one basal rate on board with which a target is as good as none."""
# Glucose for one basal rate on board, and the error beyond which it counts, both in mg/dl.
TARGETS = (
    *((240.0, 5.0), (120.0, 5.0), DEFAULT, (45.0, 5.0), (30.0, 5.0), (NO_TARGET, 5.0)),
    *((60.0, 20.0), (60.0, 10.0)),
)
RULES = {
    "All rules": {},
    "Insulin on board without a target that depends on the reading": {"fall_mg_dl": NO_TARGET},
    "A reading held for over 10 min allows as much as one that repeats": {"unchanged_min": 10_000.0},
    "Both of these left out": {"fall_mg_dl": NO_TARGET, "unchanged_min": 10_000.0},
    "No suspension": {"low_mg_dl": 0.0, "ahead_min": 0.0, "hysteresis_mg_dl": 0.0},
    "A jump of the reading is not put down to the sensor": {"doubt_tau_min": 0.01},
    "A rise of any speed is accepted": {"fastest_mg_dl_min": 1000.0},
}


def target(fall, error):
    return {"fall_mg_dl": fall, "error_mg_dl": error}


class Searches:
    """Worst errors by controller and settings, kept in a file so that each search is made once."""

    def __init__(self, place):
        self._place = place
        self._found = json.loads(place.read_text(encoding="utf-8")) if place.exists() else {}

    def rows(self, controller, settings):
        """Minutes below 54 mg/dl, lowest glucose, and the peak without errors, by size of the errors in %."""
        settings = {key: value for key, value in settings.items() if (key, value) not in target(*DEFAULT).items()}
        name = json.dumps([controller, settings], sort_keys=True)
        if name not in self._found:
            print(name, flush=True)
            searched = search(configured(Adversary, SEARCH, guard=settings, controller=[controller]))
            result = searched.results_of(list(searched.missing([])))
            self._found[name] = {
                f"{row['error_pct']:g}": {
                    "below_54_min": row["below_54_min"],
                    "lowest_mg_dl": row["lowest_mg_dl"],
                    "peak_mg_dl": row["peak_without_errors_mg_dl"],
                }
                for row in result.plain["searches"]
            }
            self._place.write_text(json.dumps(self._found, indent=1), encoding="utf-8")
        return {float(error): row for error, row in self._found[name].items()}


def table(head, rows):
    lines = [head, [":---", *["---:"] * (len(head) - 1)], *rows]
    return "\n".join(f"| {' | '.join(line)} |" for line in lines) + "\n"


def target_rows(searches):
    for fall, error in TARGETS:
        result = {name: searches.rows(name, target(fall, error)) for name in CONTROLLERS}
        peaks = [row[WORST_PCT]["peak_mg_dl"] for row in result.values()]
        below = [
            f"{row[WORST_PCT]['below_54_min']:.0f} ({row[WORST_PCT]['lowest_mg_dl']:.1f})" for row in result.values()
        ]
        yield [
            f"{fall:g}, {error:g}" + (" (default)" if (fall, error) == DEFAULT else ""),
            *(f"{peak:.1f}" for peak in peaks),
            *below,
        ]


def rule_rows(searches):
    for text, settings in RULES.items():
        result = [searches.rows(name, settings) for name in CONTROLLERS]
        cells = [
            f"{row[error]['below_54_min']:.0f} ({row[error]['lowest_mg_dl']:.1f})"
            for row in result
            for error in sorted(row)
        ]
        yield [text, *cells]


def draw(searches):
    figure = _style.new_figure("double", 78.0, None)
    panels = figure.subplots(1, 2)
    handles = []
    for index, name in enumerate(CONTROLLERS):
        rows = {of: searches.rows(name, target(*of))[WORST_PCT] for of in TARGETS}
        for axes, what in zip(panels, ("below_54_min", "lowest_mg_dl"), strict=True):
            places = {of: (row["peak_mg_dl"], row[what]) for of, row in rows.items()}
            style = {**_style.line_style(index), "marker": "os^"[index], "markersize": 3.5}
            line = [place for (_, error), place in places.items() if error == DEFAULT[1]]
            handles += axes.plot(*zip(*line, strict=True), **style)
            others = [place for (_, error), place in places.items() if error != DEFAULT[1]]
            axes.plot(*zip(*others, strict=True), **{**style, "linestyle": "none", "markerfacecolor": "white"})
            axes.plot(*places[DEFAULT], marker="o", markersize=9.0, markerfacecolor="none", color="black")
            if index == 0:
                seen = {
                    fall: place for (fall, error), place in places.items() if error == DEFAULT[1] and place[1] > 0.0
                }
                _label(axes, seen, "left" if axes is panels[0] else "right")
    panels[0].set_ylabel(f"Below 54 mg/dl under errors of ±{WORST_PCT:g} % (min)")
    panels[1].set_ylabel("Lowest glucose under these errors (mg/dl)")
    for axes in panels:
        axes.margins(y=0.08)
        axes.axvline(PEAK_MG_DL, **BOUND)
        axes.set_xlabel("Highest glucose after 50 g, without errors (mg/dl)")
        _style.dress(axes)
    _style.add_legend(figure, dict(zip((NAMES[name] for name in CONTROLLERS), handles[::2], strict=True)), "double")
    return figure


def _label(axes, places, side):
    for fall, place in places.items():
        last = fall == NO_TARGET
        left = side == "left" or last
        axes.annotate(
            "no target" if last else f"{fall:g}",
            place,
            xytext=(5 if left else -5, 3 if side == "left" or not last else -8),
            textcoords="offset points",
            ha="left" if left else "right",
            fontsize=_style.FONT_PT - 1.0,
            color=_style.GREY,
        )


def main(place):
    searches = Searches(Path(place))
    targets, rules, drawn = target_rows(searches), rule_rows(searches), draw(searches)
    told = f"\nThe table was {made(place)}.\n"
    head = [
        "`fall_mg_dl`, `error_mg_dl`",
        *(f"{NAMES[name]}: peak, mg/dl" for name in CONTROLLERS),
        *(f"{NAMES[name]}: min below 54 (lowest), ±{WORST_PCT:g} %" for name in CONTROLLERS),
    ]
    (GUIDE / "guard_trade_off.md").write_text(table(head, targets) + told, encoding="utf-8")
    head = ["", *(f"{NAMES[name]}, ±{error:g} %" for name in CONTROLLERS for error in SEARCH["errors_pct"])]
    (GUIDE / "guard_rules.md").write_text(table(head, rules) + told, encoding="utf-8")
    drawn.savefig(GUIDE / "guard_trade_off.png", dpi=150)


if __name__ == "__main__":
    main(*sys.argv[1:])
