"""What `cohort.py` found: as text, and as the tables of the documentation."""

from __future__ import annotations

from typing import Any

NAMES = {
    "plain|basal": "Open loop, basal rate",
    "plain|mpc": "MPC",
    "plain|mpc-se": "MPC/SE",
    "plain|nlqdmc-se": "NLQDMC/SE",
    "noise|mpc": "MPC, noise of 1.45 (mg/dl)²",
    "own meals|mpc": "MPC, everybody's own meals",
    "noise and own meals|mpc": "MPC, noise and own meals",
    "noise and own meals|mpc-se": "MPC/SE, noise and own meals",
}
CASES = {"basal": "Open loop, basal rate", "mpc": "MPC", "mpc-se": "MPC/SE", "mpc, no metrics": "MPC, no metrics"}
_ONE, _ALL = "one core", "all cores"


def report(result: dict[str, Any]) -> str:
    parts = (_speeds, _beside_simglucose, _ceiling, _where, _scaling, _accuracy)
    return "\n\n".join("\n".join(part(result)) for part in parts)


def _row(name: str, *columns: str) -> str:
    return f"{name:34}" + "".join(f"{column:>14}" for column in columns)


def _of(result: dict[str, Any], key: str, what: str, which: str = "best") -> float:
    figure: float = result["speeds"][key][what][which]
    return figure


def _number(figure: float) -> str:
    return f"{figure:.0f}" if figure >= 100.0 else f"{figure:.3g}"


def _speeds(result: dict[str, Any]) -> list[str]:
    lines = [
        "Patient-days a second: 24 h, three meals, 5-min samples, two steps each; the best of the repeats (median)",
        "loop: the loop alone; trial: with drawing, basal rates, all metrics and histograms",
        "",
        _row("", f"{_ONE}, loop", "trial", f"{_ALL}, loop", "trial", "all / one"),
    ]
    for key, name in NAMES.items():
        for precision in ("float64", "float32"):
            keys = [f"{key}|{precision}|{which}" for which in (_ONE, _ALL)]
            if keys[0] not in result["speeds"]:
                continue
            best = [_of(result, of, what) for of in keys for what in ("loop", "trial")]
            usual = [_of(result, of, what, "median") for of in keys for what in ("loop", "trial")]
            engine = "" if result["engines"][key] == "native" else f" ({result['engines'][key]})"
            lines.append(f"{name}, {precision}{engine}")
            lines.append(_row("", *map(_number, best), f"{best[3] / best[1]:.2f}"))
            lines.append(_row("", *(f"({_number(figure)})" for figure in usual), f"({usual[3] / usual[1]:.2f})"))
    return lines


def _beside_simglucose(result: dict[str, Any]) -> list[str]:
    other = result["simglucose"]
    if "absent" in other:
        return [
            f"simglucose was not run ({other['absent']}). Install simglucose==0.2.11 and 'setuptools<81' in an "
            "environment and give its interpreter with --simglucose-python."
        ]
    theirs = _of(result, "simglucose", "trial")
    lines = [
        f"Beside simglucose 0.2.11 with pandas {other['pandas']}, one core, one day of {other['samples']} samples, "
        f"basal-bolus: {theirs:.4f} patient-days a second; ratios:",
        "",
        _row("", "loop, best", "trial, best", "trial, median"),
    ]
    for key, name in NAMES.items():
        ours = f"{key}|float64|{_ONE}"
        ratios = [_of(result, ours, "loop") / theirs, _of(result, ours, "trial") / theirs]
        usual = _of(result, ours, "trial", "median") / _of(result, "simglucose", "trial", "median")
        lines.append(_row(name, *map(_number, (*ratios, usual))))
    return lines


def _ceiling(result: dict[str, Any]) -> list[str]:
    lines = [
        "The ceiling of one core: patient-days a second if all arithmetic went at the rate of fused products",
        "counted in floating-point operations, and in vector operations, of which a sum takes the place of a product",
        "",
    ]
    for precision, of in result["ceilings"].items():
        lines.append(f"{precision}: {of['gflops']:.1f} GFLOP/s at most")
        lines.append(_row("", "flops a sample", "ceiling", "operations", "ceiling", "reached", "share", "share"))
        for case, asked in of["asked"].items():
            ceiling = of["ceilings"][case]
            reached = _of(result, f"kernel|{case}|{precision}|{_ONE}", "kernel")
            columns = [asked["flops"], ceiling["flops"], asked["operations"], ceiling["operations"], reached]
            shares = [f"{100.0 * reached / ceiling[which]:.0f} %" for which in ("flops", "operations")]
            lines.append(_row(CASES[case], *map(_number, columns), *shares))
        instructions = of["asked"]["mpc"]["instructions"]
        if instructions:
            told = ", ".join(
                f"{instructions[kind]} {kind}" for kind in sorted(instructions, key=instructions.get)[::-1]
            )
            lines.append(f"MPC: {sum(instructions.values())} instructions a sample and vector: {told}")
    return lines


def _where(result: dict[str, Any]) -> list[str]:
    lines = ["Where the time of a trial with MPC goes on one core, microseconds a person"]
    for key, parts in result["parts"].items():
        situation, precision = key.split("|")
        lines += ["", f"{NAMES[f'{situation}|mpc']}, {precision}"]
        lines += [_row(f"    {name}", f"{value:.1f}") for name, value in sorted(parts.items(), key=lambda p: -p[1])]
        lines.append(_row("    all", f"{sum(parts.values()):.1f}"))
    return lines


def _scaling(result: dict[str, Any]) -> list[str]:
    lines = ["Whole trials from the command line: MPC, float32, all cores, from start to report page", ""]
    lines.append(_row("people", "seconds", "people/s", "memory, MB", "disk, MB"))
    for of in result["scaling"]:
        columns = (f"{of['seconds']:.1f}", _number(of["people"] / of["seconds"]), f"{of['memory_MB']:.0f}")
        lines.append(_row(f"{of['people']}", *columns, f"{of['disk_MB']:.1f}"))
    return lines


def _accuracy(result: dict[str, Any]) -> list[str]:
    of = result["accuracy"]
    lines = [
        f"Batch, float64, against the adaptive integrator, {of['people']} people under MPC, glucose at all samples: "
        f"largest error {of['largest']:.1e}, 95 % of people below {of['p95']:.1e}, median {of['median']:.1e} mg/dl",
        "",
        "Metrics in float32 against float64, largest difference, mg/dl",
        _row("", "undershoot", "peak", "mean", "median person", "beyond 0.1"),
    ]
    for case, apart in result["precisions"].items():
        columns = [f"{apart[name]:.1e}" for name in ("undershoot", "peak", "mean", "median")]
        lines.append(_row(CASES[case], *columns, f"{apart['beyond']} of {apart['people']}"))
    return lines


# tables of the documentation


def tables(result: dict[str, Any]) -> str:
    """The same in Markdown."""
    quick = " --quick" if result["quick"] else ""
    told = f"Measured on {result['date']} by `benchmarks/cohort.py{quick}`: {result['machine']}; {result['versions']}."
    parts = (_speed_table, _ceiling_table, _parts_table, _scaling_table, _accuracy_table)
    return "\n\n".join([told, *("\n".join(part(result)) for part in parts)]) + "\n"


def _table(heads: list[str], rows: list[list[str]]) -> list[str]:
    lines = [f"| {' | '.join(heads)} |", f"| :--- |{' ---: |' * (len(heads) - 1)}"]
    return [*lines, *(f"| {' | '.join(row)} |" for row in rows)]


def _grouped(figure: float) -> str:
    """Four digits at most, in groups of three."""
    if figure < 1000.0:
        return _number(figure)
    step = 10.0 ** (len(str(int(figure))) - 3)
    return f"{round(figure / step) * step:,.0f}".replace(",", "\N{NO-BREAK SPACE}")


def _speed_table(result: dict[str, Any]) -> list[str]:
    theirs = None if "absent" in result["simglucose"] else _of(result, "simglucose", "trial")
    rows = []
    for key, name in NAMES.items():
        for precision in ("float64", "float32"):
            ones = f"{key}|{precision}|{_ONE}"
            if ones not in result["speeds"]:
                continue
            figures = [
                _of(result, f"{key}|{precision}|{which}", what) for which in (_ONE, _ALL) for what in ("loop", "trial")
            ]
            ratio = "" if theirs is None or precision != "float64" else _grouped(figures[1] / theirs)
            engine = result["engines"][key]
            rows.append([name, precision if engine == "native" else f"{precision}, {engine}"])
            rows[-1] += [*map(_grouped, figures), ratio]
    heads = ["Patient-days a second", "Precision", "One core, loop", "One core, trial", "All cores, loop"]
    lines = _table([*heads, "All cores, trial", "One core, trial / simglucose"], rows)
    if theirs is not None:
        other = result["simglucose"]
        lines += [
            "",
            f"simglucose 0.2.11 with pandas {other['pandas']} made {theirs:.3g} patient-days a second, on one ",
        ]
        lines[-1] += f"core in the same run ({other['samples']} samples a day, basal-bolus)."
    return lines


def _ceiling_table(result: dict[str, Any]) -> list[str]:
    rows = []
    for precision, of in result["ceilings"].items():
        for case, asked in of["asked"].items():
            ceiling, key = of["ceilings"][case], f"kernel|{case}|{precision}|{_ONE}"
            reached = _of(result, key, "kernel")
            rows.append([CASES[case], precision, str(asked["flops"]), str(asked["operations"])])
            rows[-1] += [str(sum(asked["instructions"].values()) or ""), *map(_grouped, ceiling.values())]
            rows[-1] += [_grouped(reached), *(f"{100.0 * reached / limit:.0f} %" for limit in ceiling.values())]
    heads = ["Vector code of", "Precision", "Flops", "Operations", "Instructions", "Ceiling by flops"]
    heads += ["Ceiling by operations", "Reached", "Share of flops", "Share of operations"]
    most = " and ".join(f"{of['gflops']:.0f} GFLOP/s in {name}" for name, of in result["ceilings"].items())
    return [f"One core reached {most}.", "", *_table(heads, rows)]


def _parts_table(result: dict[str, Any]) -> list[str]:
    columns = {key: f"{NAMES[key.split('|')[0] + '|mpc']}, {key.split('|')[1]}" for key in result["parts"]}
    total: dict[str, float] = {}
    for parts in result["parts"].values():
        for name, value in parts.items():
            total[name] = total.get(name, 0.0) + value
    rows = [
        [name[0].upper() + name[1:], *(f"{result['parts'][key].get(name, 0.0):.1f}" for key in columns)]
        for name in sorted(total, key=lambda name: -total[name])
    ]
    rows.append(["All", *(f"{sum(result['parts'][key].values()):.1f}" for key in columns)])
    return _table(["Microseconds a person, one core", *columns.values()], rows)


def _scaling_table(result: dict[str, Any]) -> list[str]:
    rows = [
        [
            _grouped(of["people"]),
            f"{of['seconds']:.1f}",
            _grouped(of["people"] / of["seconds"]),
            f"{of['memory_MB']:.0f}",
            f"{of['disk_MB']:.1f}",
        ]
        for of in result["scaling"]
    ]
    return _table(["People", "Seconds", "People a second", "Memory, MB", "Disk, MB"], rows)


def _accuracy_table(result: dict[str, Any]) -> list[str]:
    of = result["accuracy"]
    rows = []
    for case, apart in result["precisions"].items():
        figures = [f"{apart[name]:.0e}" for name in ("undershoot", "peak", "mean", "median")]
        rows.append([CASES[case], *figures, f"{apart['beyond']} of {apart['people']}"])
    heads = ["float32 against float64, mg/dl", "Undershoot", "Peak", "Mean", "Median person", "Beyond 0.1"]
    return [
        f"Glucose of {of['people']} people under MPC against the adaptive integrator, float64: largest error "
        f"{of['largest']:.1e} mg/dl, 95 % of people below {of['p95']:.1e}, median {of['median']:.1e}.",
        "",
        *_table(heads, rows),
    ]
