"""Report of the claims: a self-contained page, and the same as plain data."""

from __future__ import annotations

import base64
import html
import math
from collections.abc import Mapping, Sequence
from typing import Any, Final

from glucoloop.config.key import plain
from glucoloop.papers.meal_aware.comparison import SHARES, Verdict, distances, runs_told, spread
from glucoloop.papers.meal_aware.experiments import ComparisonRuns
from glucoloop.papers.meal_aware.figures import COLOURS, caption
from glucoloop.papers.meal_aware.measures import AT_SAMPLES, LATE_MIN, MEASURES, SWING_MG_DL
from glucoloop.papers.meal_aware.mismatches import GROUPS
from glucoloop.papers.meal_aware.options import TUNING_PEOPLE_SEED, TUNING_SEEDS, ClaimsKeys
from glucoloop.papers.meal_aware.situations import NAMES, NamedSituation
from glucoloop.report import _page
from glucoloop.report._page import Repeat, scrolling, section

TITLE: Final = "Meals that nobody announced: the claims"
REPEAT: Final = "claims --config claims.toml"
_FILES: Final = {
    "claims.csv": "claims",
    "numbers.csv": "numbers of each situation",
    "runs.csv": "each run",
    "loops.parquet": "glucose and insulin of each run",
    "claims.json": "all of it",
}
"""Files with the data of the claims, beside their page."""
HOLDS: Final = {True: "holds", False: "does not hold"}

READINGS: Final[dict[str, str]] = {
    "patient": (
        "setpoint-81: the patient of Sorensen (1985) as printed by Parker et al. (2000), at rest at 81.1 mg/dl under "
        "25.606 mU/min. 50 g of carbohydrate at 50 min, 600 min, samples of 5 min."
    ),
    "pump": "0 to 66.9 mU/min, and a change of at most 16.7 mU/min from one sample to the next.",
    "noise": "Each reading carries independent normal noise of variance 1.45 (mg/dl)², cut off at 5 mg/dl.",
    "controllers": (
        "Those of the catalogue, at their defaults for the situation. Linear MPC identifies a model from a record of "
        "each seed, as noisy as the readings; of many people, one for all. A dead time is known to all of them; that "
        "of a meal's announcement only the meal-aware controller heeds."
    ),
    "wrong models": (
        "Where the model is wrong the setpoint is 81 mg/dl unless said, controllers are designed for it and for noise "
        "of variance 1.45, and are told of nothing else. Runs differ in their noise, people also in their constants "
        "and in the time of a fault, which is the same for every controller. Correlated noise is of first order, of "
        "variance 9 and correlation 0.7. All is measured at the samples."
    ),
    "seeds": "Seed n is `glucoloop run --seed n`: the same key of the sensor for every controller and situation.",
    "people": (
        "parker2000, each rests at an individual basal rate, which the controller knows, as in `glucoloop trial`; "
        "otherwise it is designed for the nominal patient. Each has an individual sensor key, the same under every "
        "controller."
    ),
    "glucose": (
        "Free of noise, on a grid of one minute; for the time within a band, that of people is taken as straight "
        "between samples."
    ),
    "oscillation": (
        "That of the search for tunings: a loop oscillates if glucose crosses the setpoint ± 2 % more than twice after "
        "a meal, or insulin turns more than 7 times. Noise turns any controller, so this is judged from the same "
        "controller and dead time without noise. With noise, swings are counted: from beyond "
        f"{SWING_MG_DL:g} mg/dl, the largest error of a reading, on one side of the setpoint to beyond it on the "
        f"other, in the last {LATE_MIN:g} min, long after the meal."
    ),
    "bound": (
        "The least largest deviation that any doses within the pump's limits reach (`glucoloop bound`), for whoever "
        "knows the meal exactly from its first minute; if it is announced, from the sample before. With noise nobody "
        "knows so much, so that part of the distance cannot be gained."
    ),
}
"""Explanation of how the claims are tested."""


def number(value: float, digits: int) -> str:
    """Format a number for a table; a dash stands for NaN."""
    if not math.isfinite(value):
        return "–"
    told = f"{value:.{digits}f}"
    return told.removeprefix("-") if float(told) == 0.0 else told.replace("-", "−")


def bound_told(verdict: Verdict) -> str:
    """Text of a bound in a table."""
    return f"{'≥' if verdict.claim.at_least else '≤'} {number(verdict.bound, verdict.claim.digits)}"


def spread_told(shares: Mapping[str, float], digits: int, *, one: bool) -> str:
    """Text of a median, with the range from 5 to 95 % where there are several runs."""
    if one:
        return number(shares["median"], digits)
    low, middle, high = (number(shares[share], digits) for share in SHARES)
    return f"{middle} ({low} to {high})"


def seeds_told(asked: ClaimsKeys) -> list[str]:
    """The seeds of a comparison and those on which the tuning was chosen, one sentence each."""
    seeds = asked.sensor_seeds
    told = [
        f"Sensor seeds {seeds[0]} to {seeds[-1]}, and {asked.people} people of seed {asked.seed}.",
        f"The tuning of the meal-aware controller was chosen on sensor seeds {TUNING_SEEDS.start} to "
        f"{TUNING_SEEDS.stop - 1} and on people of seed {TUNING_PEOPLE_SEED}.",
    ]
    if asked.tuned_on:
        return [*told, f"Of these, {' and '.join(asked.tuned_on)} are here too: they are no independent test."]
    return [*told, "None of them is here: these are other keys and other people."]


def summary_told(verdicts: Sequence[Verdict]) -> str:
    """Sentence with the number of claims that hold."""
    held = sum(verdict.holds for verdict in verdicts)
    if held == len(verdicts):
        return f"All {held} claims hold."
    return f"{held} of {len(verdicts)} claims hold."


def report(study: ComparisonRuns, verdicts: Sequence[Verdict]) -> dict[str, Any]:
    """Report as plain values for JSON, the same for the same seeds: measured times are left out."""
    return {
        "config": plain(study.asked),
        "tuning": {"sensor_seeds": [TUNING_SEEDS.start, TUNING_SEEDS.stop - 1], "people_seed": TUNING_PEOPLE_SEED},
        "tuned_on": list(study.asked.tuned_on),
        "claims": [
            {
                "id": verdict.claim.id,
                "situation": verdict.claim.situation,
                "what": verdict.claim.what,
                "unit": verdict.claim.unit,
                "found": verdict.ours,
                "kind": "at-least" if verdict.claim.at_least else "at-most",
                "bound": verdict.bound,
                "holds": verdict.holds,
                "runs": verdict.runs,
                "controllers": dict(verdict.found),
            }
            for verdict in verdicts
        ],
        "situations": [
            {
                "name": situation.name,
                "title": situation.title,
                "keys": dict(situation.keys),
                "runs": runs_told(study, situation.name),
                "bound_mg_dl": study.bounds[situation.name].bound if situation.name in study.bounds else None,
                "unable": next(iter(study.loops[situation.name].values())).infeasible,
                "controllers": {name: spread(loops) for name, loops in study.loops[situation.name].items()},
                "distance_to_bound_mg_dl": distances(study, situation.name),
            }
            for situation in study.situations
        ],
        "mismatches": [
            {
                "name": row.name,
                "group": row.group,
                "title": GROUPS[row.group],
                "runs": runs_told(study, row.name),
                "bound_mg_dl": study.bounds[row.name].bound if row.name in study.bounds else None,
                "unable": next(iter(study.of_rows[row.name].values())).infeasible,
                "controllers": {name: spread(runs) for name, runs in study.of_rows[row.name].items()},
                "distance_to_bound_mg_dl": distances(study, row.name),
            }
            for row in study.rows
        ],
    }


def page(study: ComparisonRuns, verdicts: Sequence[Verdict], figures: Mapping[str, str]) -> str:
    """Self-contained page of the claims.

    Parameters
    ----------
    study : Study
    verdicts : sequence of Verdict
    figures : mapping
        Text of the SVG figure of each situation.
    """
    lead = " ".join([summary_told(verdicts), *seeds_told(study.asked)])
    sections = [
        f'<p class="lead">{html.escape(lead)}</p>',
        _claims(study, verdicts),
        *(_situation(study, situation, figures[situation.name]) for situation in study.situations),
        *(_group(study, name) for name in dict.fromkeys(row.group for row in study.rows)),
        _step(study),
        _readings(),
        _page.situation({}, Repeat(REPEAT, plain(study.asked), _FILES)),
    ]
    return _page.page(TITLE, "\n".join(part for part in sections if part), _STYLE)


def _name(name: str) -> str:
    return f'<span class="chip" style="background: {COLOURS[name]}"></span>{html.escape(NAMES[name])}'


def _others(study: ComparisonRuns) -> list[str]:
    controllers = next(iter(study.runs.values()))
    return [name for name in controllers if name != study.ours]


def _claims(study: ComparisonRuns, verdicts: Sequence[Verdict]) -> str:
    titles = {situation.name: situation.title for situation in study.situations}
    titles |= {row.group: GROUPS[row.group] for row in study.rows}
    others = _others(study)
    heads = "".join(f'<th scope="col" class="value">{_name(name)}</th>' for name in (study.ours, *others))
    parts = []
    for situation, title in titles.items():
        own = [verdict for verdict in verdicts if verdict.claim.situation == situation]
        if not own:
            continue
        runs = f' <span class="runs">{html.escape("; ".join(dict.fromkeys(verdict.runs for verdict in own)))}</span>'
        parts.append(f'<tr><th scope="rowgroup" colspan="{len(others) + 5}">{html.escape(title)}{runs}</th></tr>')
        parts += [_claim(verdict, others) for verdict in own]
    table = (
        '<table class="claims">\n<thead><tr><th scope="col">Claim</th><th scope="col">Verdict</th>'
        f'<th scope="col" class="value">Bound</th>{heads}<th scope="col">Unit</th></tr></thead>\n'
        f"<tbody>{''.join(parts)}</tbody></table>"
    )
    about = (
        "Of the meal-aware controller. The other controllers met the same situations with the same sensor keys; their "
        "numbers stand beside."
    )
    return section("What holds and what does not", about, scrolling(table, "Claims"))


def _claim(verdict: Verdict, others: Sequence[str]) -> str:
    claim, kind = verdict.claim, "yes" if verdict.holds else "no"
    ours = f'<td class="value ours">{number(verdict.ours, claim.digits)}</td>'
    cells = "".join(f'<td class="value">{number(verdict.found[name], claim.digits)}</td>' for name in others)
    return (
        f'<tr><th scope="row">{html.escape(claim.what)}</th><td class="{kind}">{HOLDS[verdict.holds]}</td>'
        f'<td class="value">{bound_told(verdict)}</td>{ours}{cells}<td class="unit">{html.escape(claim.unit)}</td></tr>'
    )


def _situation(study: ComparisonRuns, situation: NamedSituation, svg: str) -> str:
    loops, one = study.loops[situation.name], situation.runs == "one"
    from_bound = distances(study, situation.name)
    columns = [
        f"<th scope='col'>{html.escape(measure.title)}<small>{measure.unit}</small></th>" for measure in MEASURES
    ]
    if from_bound:
        columns.append("<th scope='col'>Distance to the bound<small>mg/dl</small></th>")
    rows = []
    for name, own in loops.items():
        shares = spread(own)
        cells = [spread_told(shares[measure.name], measure.digits, one=one) for measure in MEASURES]
        if from_bound:
            cells.append(spread_told(from_bound[name], 1, one=one))
        told = "".join(f'<td class="value">{_wrapped(cell)}</td>' for cell in cells)
        rows.append(f'<tr><th scope="row">{_name(name)}</th>{told}</tr>')
    table = (
        f'<table class="numbers">\n<thead><tr><th scope="col">Controller</th>{"".join(columns)}</tr></thead>\n'
        f"<tbody>{''.join(rows)}</tbody></table>"
    )
    picture = base64.b64encode(svg.encode()).decode()
    alt = html.escape(f"{situation.title}: glucose and insulin of {len(loops)} controllers.")
    figure = (
        f'<figure><img src="data:image/svg+xml;base64,{picture}" alt="{alt}">'
        f"<figcaption>{html.escape(caption(situation))}</figcaption></figure>"
    )
    about = [f"{runs_told(study, situation.name).capitalize()}{'' if one else '; median (5 to 95 %)'}."]
    infeasible = next(iter(loops.values())).infeasible
    if infeasible:
        about.append(f"{infeasible} of them have no basal rate for the setpoint, and are not counted.")
    if from_bound:
        bound = study.bounds[situation.name]
        about.append(f"Bound of the largest deviation: {bound.bound:.2f} mg/dl.")
        if not bound.converged:
            about.append("It has not converged, and so is none.")
    return section(
        html.escape(situation.title),
        html.escape(" ".join(about)),
        f"{figure}\n{scrolling(table, situation.title)}",
        "situation",
    )


def _group(study: ComparisonRuns, group: str) -> str:
    """Section of a group of situations in which the model is wrong."""
    rows = [row for row in study.rows if row.group == group]
    bounded = any(row.name in study.bounds for row in rows)
    columns = [*(f"{measure.title}<small>{measure.unit}</small>" for measure in AT_SAMPLES)]
    columns += ["Distance to the bound<small>mg/dl</small>"] if bounded else []
    lines = []
    for row in rows:
        from_bound, runs = distances(study, row.name), runs_told(study, row.name)
        title = f'{html.escape(row.name)} <span class="runs">{html.escape(runs)}</span>'
        lines.append(f'<tr><th scope="rowgroup" colspan="{len(columns) + 1}">{title}</th></tr>')
        for name, of_row in study.of_rows[row.name].items():
            one, shares = of_row.run.size == 1, spread(of_row)
            cells = [spread_told(shares[measure.name], measure.digits, one=one) for measure in AT_SAMPLES]
            if bounded:
                cells.append(spread_told(from_bound[name], 1, one=one) if name in from_bound else "")
            told = "".join(f'<td class="value">{_wrapped(cell)}</td>' for cell in cells)
            lines.append(f'<tr><th scope="row">{_name(name)}</th>{told}</tr>')
    heads = "".join(f'<th scope="col">{column}</th>' for column in columns)
    table = (
        f'<table class="numbers">\n<thead><tr><th scope="col">Controller</th>{heads}</tr></thead>\n'
        f"<tbody>{''.join(lines)}</tbody></table>"
    )
    about = "Of glucose at the samples; where there are several runs, median (5 to 95 %)."
    return section(html.escape(GROUPS[group]), about, scrolling(table, GROUPS[group]), "situation")


def _wrapped(cell: str) -> str:
    """Text of a median with its range on a line of its own."""
    middle, opening, rest = html.escape(cell).partition(" (")
    return f"{middle}<small>{rest.removesuffix(')')}</small>" if opening else middle


def _step(study: ComparisonRuns) -> str:
    if not study.step_ms:
        return ""
    rows = "".join(
        f'<tr><th scope="row">{_name(name)}</th><td class="value">{number(ms, 2)}</td><td class="unit">ms</td></tr>'
        for name, ms in study.step_ms.items()
    )
    about = (
        "Median time of a decision, compiled, as measured on the machine that made this page. It is no claim, and "
        "another machine or another day gives another number."
    )
    body = f'<table class="steps"><tbody>{rows}</tbody></table>'
    return section("One sample of one patient", about, body)


def _readings() -> str:
    rows = "".join(
        f'<tr><th scope="row">{html.escape(name)}</th><td>{_code(text)}</td></tr>' for name, text in READINGS.items()
    )
    return section("Readings", "How the claims are read.", f'<table class="readings"><tbody>{rows}</tbody></table>')


def _code(text: str) -> str:
    """Text in which parts between backticks are marked as code."""
    parts = html.escape(text).split("`")
    return "".join(f"<code>{part}</code>" if place % 2 else part for place, part in enumerate(parts))


_STYLE: Final = """
th[scope=row] { white-space: normal; padding-left: 0; }
.claims { width: 100%; }
.claims th, .claims td { vertical-align: baseline; }
.claims thead th { vertical-align: bottom; white-space: nowrap; }
.claims tbody th[scope=row] { padding-left: 0.9rem; min-width: 15rem; }
.claims td:nth-child(2) { white-space: nowrap; }
.yes { color: var(--yes); } .no { color: var(--no); font-weight: 600; }
.ours { font-weight: 600; }
.runs, .unit { color: var(--faint); font-weight: normal; }
.runs { font-size: 0.85rem; margin-left: 0.5rem; }
.numbers { font-size: 0.85rem; width: 100%; }
.numbers th, .numbers td { padding: 0.25rem 0.7rem 0.25rem 0; }
.numbers thead th { text-align: right; }
.numbers th[scope=row] { white-space: nowrap; position: sticky; left: 0; background: var(--paper); }
.numbers tbody tr + tr > * { border-top: 1px solid var(--rule); }
.numbers td, .numbers tbody th { vertical-align: top; }
small { display: block; color: var(--faint); font-size: 0.85em; font-weight: normal; white-space: nowrap; }
figure { margin: 0.6rem 0; background: white; padding: 0.6rem; border-radius: 0.3rem; max-width: 58rem; }
figure img { width: 100%; height: auto; display: block; }
figcaption { color: #555; font-size: 0.85rem; margin-top: 0.4rem; }
.readings td { max-width: 56rem; }
.readings th, .readings td { vertical-align: top; padding-bottom: 0.5rem; }
@media (max-width: 44rem) { .claims tbody th[scope=row] { min-width: 9.5rem; padding-left: 0; }
                            .claims td:nth-child(2) { white-space: normal; } }
"""
