"""Parts of the documentation that are read out of the program, so that nothing is typed twice.

    python docs/generate.py

``conf.py`` calls it before each build. It writes ``_generated``, which the pages include, and the pages in ``commands``
and ``api``.
"""

import importlib.util
import inspect
import pkgutil
import re
import tomllib
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType

import house
import numpy as np
import safety

import glucoloop
from glucoloop import plugin, units
from glucoloop.cli import app
from glucoloop.cli.command import CommandOption
from glucoloop.component.setting import PANELS, Default, value_text
from glucoloop.control.catalogue import CONTROLLERS
from glucoloop.faults import FAULTS, TIMING
from glucoloop.firmware.safety import SafetyFile
from glucoloop.lab import pack
from glucoloop.metrics.metric import METRICS
from glucoloop.metrics.readings import MEASURES
from glucoloop.metrics.readings.given import GIVEN_RESULTS
from glucoloop.patients.catalogue import PATIENTS
from glucoloop.reproduction.parker1999.comparison import DEVIATIONS, ENTRIES, INTERPRETATIONS
from glucoloop.studies.catalogue import STUDIES

LEFT_OUT = ("cli",)
"""What the command line is made of is no interface."""
MAX_MODULES_OF_A_PAGE = 8
"""Of a layer with more, each module has a page of its own: no page is to be over 300 kB."""
SHARED = (*TIMING, "key")
"""Settings that nearly all faults have, which the page on them describes once."""
WORDS = {
    "brain_uptake": "r_{BGU}",
    "red_cell_uptake": "r_{RBCU}",
    "gut_uptake": "r_{GGU}",
    "basal_hepatic_production": "r_{HGP}^B",
    "basal_hepatic_uptake": "r_{HGU}^B",
    "basal_peripheral_uptake": "r_{PGU}^B",
    "tau_I": r"\tau_I",
    "tau_N": r"\tau_N",
    "excretion_threshold": "G_K^*",
    "excretion_offset": "r_{KE}^0",
    "excretion_clearance": r"\kappa_{KE}",
    "excretion": "M_{KE}",
}
GROUPS = {
    "Glucose transport": r"q_.*|v_.*|T_B|T_P",
    "Insulin transport and clearance": r"Q_.*|V_(?!N).*|T_PI|F_.*",
    "Constant uptakes and basal rates": r".*_uptake|basal_.*",
    "Healthy basal state": r"ref_.*",
    "Slow effects and glucagon": r"tau_.*|[kV]_N",
    "Renal excretion above its threshold": r"excretion_.*",
}


def table(columns: list[str], rows: list[list[str]], align: str = "") -> str:
    """A Markdown table; `align` has one letter a column, l or r."""
    marks = [{"l": ":---", "r": "---:"}[letter] for letter in align or "l" * len(columns)]
    lines = [columns, marks, *rows]
    return "\n".join("| " + " | ".join(cell.replace("|", "\\|") for cell in line) + " |" for line in lines) + "\n"


def code(text: str) -> str:
    return f"`{text}`"


def symbol(name: str) -> str:
    """LaTeX of a field of the parameter record."""
    if name in WORDS:
        return WORDS[name]
    letter, _, place = name.removeprefix("ref_").partition("_")
    subscript = f"_{{{place}}}" if place else ""
    return f"{letter}{subscript}^B" if name.startswith("ref_") else f"{letter}{subscript}"


def constants() -> str:
    from glucoloop.patients.sorensen.parker1999 import CONSTANTS

    sources = list(dict.fromkeys(constant.source for constant in CONSTANTS))
    parts, sigmoids = [], {}
    for constant in CONSTANTS:
        name, dot, part = constant.name.partition(".")
        if dot:
            sigmoids.setdefault(name, {})[part] = constant
    for heading, pattern in GROUPS.items():
        rows = [
            [
                f"${symbol(constant.name)}$",
                code(constant.name),
                f"{constant.value:g}",
                constant.unit,
                constant.meaning,
                str(sources.index(constant.source) + 1),
            ]
            for constant in CONSTANTS
            if "." not in constant.name and re.fullmatch(pattern, constant.name)
        ]
        columns = ["Symbol", "Field", "Value", "Unit", "Meaning", "Source"]
        parts += [f"**{heading}**\n", table(columns, rows, "llrllr")]
    rows = []
    for name, of_name in sigmoids.items():
        values = [f"{of_name[part].value:g}" for part in ("offset", "scale", "slope", "inflection")]
        meaning = of_name["offset"].meaning.rpartition(":")[0]
        source = str(sources.index(of_name["offset"].source) + 1)
        rows.append([f"${symbol(name)}$", code(name), *values, meaning, source])
    columns = ["Symbol", "Field", "$o$", "$s$", "$k$", "$c$", "Meaning", "Source"]
    parts += ["**Saturating effects**, $M(x) = o + s \\, \\tanh(k (x - c))$\n", table(columns, rows, "llrrrrlr")]
    listed = sum(len(re.findall(r"^\| \$", part, re.M)) for part in parts) - len(sigmoids)
    if listed != sum("." not in constant.name for constant in CONSTANTS):
        raise ValueError("a constant belongs to no group, or to two; see GROUPS in docs/generate.py")
    legend = [f"{number}. {source}." for number, source in enumerate(sources, 1)]
    return "\n".join([*parts, "Sources:\n", *legend]) + "\n"


def operating_points() -> str:
    from glucoloop.patients import OPERATING_POINTS
    from glucoloop.simulation import linear_model

    rows = []
    for name, make in OPERATING_POINTS.items():
        person = make()
        model = linear_model(person)
        Phi, Gamma, C = (np.asarray(part) for part in (model.Phi, model.Gamma, model.C))
        gain = C @ np.linalg.solve(np.eye(Gamma.size) - Phi, Gamma)
        slowest = -model.sample_time_min / np.log(np.abs(np.linalg.eigvals(Phi)).max())
        insulin, glucose = float(person.basal_insulin_mU_min), float(person.setpoint_mg_dl)
        rows.append([code(name), f"{insulin:.4f}", f"{glucose:.4f}", f"{gain:.4f}", f"{slowest:.1f}"])
    columns = [
        "Operating point",
        "Basal insulin, mU/min",
        "Setpoint, mg/dl",
        "Gain, mg/dl per mU/min",
        "Slowest time constant, min",
    ]
    return table(columns, rows, "lrrrr")


def steady_states() -> str:
    from glucoloop.patients import patient

    person, rates = patient(), [0.0, 5.0, 10.0, 15.0, 20.0, 25.0, 30.0, 35.0, 40.0]
    glucose = np.asarray(person.glucose_mg_dl(person.steady_state(np.array(rates))))
    cells = [
        [f"{rate:g}", f"{units.u_h_from_mu_min(rate):.2f}", f"{value:.2f}"]
        for rate, value in zip(rates, glucose, strict=True)
    ]
    return table(["Insulin, mU/min", "Insulin, U/h", "Arterial glucose at steady state, mg/dl"], cells, "rrr")


def controllers() -> str:
    parts = []
    for entry in CONTROLLERS.values():
        parts.append(f"**{code(entry.name)}**: {entry.summary}.\n")
        rows = [
            [
                code(setting.name),
                default_text(setting.default),
                "; ".join(elsewhere(entry.name, setting.name)),
                setting.summary,
            ]
            for setting in entry.settings().values()
        ]
        columns = ["Setting", "Default", "Default at", "Meaning"]
        if not any(row[2] for row in rows):
            rows, columns = [[*row[:2], row[3]] for row in rows], [*columns[:2], columns[3]]
        parts.append(table(columns, rows) if rows else "It has no settings.\n")
    return "\n".join(parts)


def default_text(default: Default) -> str:
    """Text of a default: ``8`` or ``8, with noise 10``."""
    noisy = "" if default.noisy in (None, default.noise_free) else f", with noise {value_text(default.noisy)}"
    return f"{value_text(default.noise_free)}{noisy}"


def elsewhere(controller: str, setting: str) -> Iterator[str]:
    """Where a setting has another default than the controller's own: a patient, or one of its operating points."""
    for patient in PATIENTS.values():
        for place, tunings in (
            (patient.name, patient.tunings),
            *((point.name, point.tunings) for point in patient.operating_points),
        ):
            if setting in tunings.get(controller, {}):
                yield f"{place}: {default_text(tunings[controller][setting])}"


def metrics() -> str:
    rows = [[code(result.name), result.summary] for part in METRICS.values() for result in part().results]
    return table(["Metric", "Definition"], rows)


def metrics_of_records() -> str:
    """Metrics of a record, with the function that has the source of each."""
    rows = [
        [code(result.name), result.summary, code(f"{measure.of.__module__.rpartition('.')[2]}.{measure.of.__name__}")]
        for measure in MEASURES
        for result in measure.results
    ]
    rows += [[code(result.name), result.summary, code("given.given_numbers")] for result in GIVEN_RESULTS]
    return table(["Metric", "Definition", "Source, in `glucoloop.metrics.readings`"], rows)


def interpretations() -> str:
    rows = [[str(n), code(name), text] for n, (name, text) in enumerate(INTERPRETATIONS.items(), 1)]
    return table(["", "Interpretation", "Choice"], rows)


def deviations() -> str:
    return "\n".join(f"- {deviation.reason}" for deviation in DEVIATIONS) + "\n"


def printed() -> str:
    rows = []
    for entry in ENTRIES:
        value = entry.printed if isinstance(entry.printed, str) else f"{entry.printed:g}"
        bound = "at most " if entry.kind == "at-most" else ""
        rows.append([entry.what, f"{bound}{value} {entry.unit}", f"p. {entry.page}, {entry.place}"])
    return table(["Entry", "Printed", "Place"], rows)


def conversions() -> str:
    values = {name: value for name, value in vars(units).items() if name.isupper() and isinstance(value, float)}
    return table(["Constant", "Value"], [[code(name), f"{value:.10g}"] for name, value in values.items()], "lr")


def other_units() -> str:
    rows = [[unit, ", ".join(name for name in others)] for unit, others in units.OTHER_UNITS.items()]
    return table(["Unit of a setting", "May be given in"], rows)


def layers(root: Path) -> str:
    contracts = tomllib.loads((root / "pyproject.toml").read_text())["tool"]["importlinter"]["contracts"]
    rows = []
    for line in contracts[0]["layers"]:
        for name in re.findall(r"\w+", line):
            if name.startswith("_"):
                continue
            try:
                summary = first_sentence(importlib.import_module(f"glucoloop.{name}"))
            except ModuleNotFoundError:
                continue
            rows.append([code(name), summary])
    return table(["Layer", "What it holds"], rows)


def house_drawing() -> str:
    of = house.imports(Path(glucoloop.__file__).parent)
    return house.drawing(of, lambda name: first_sentence(importlib.import_module(f"glucoloop.{name}")).replace("`", ""))


def first_sentence(thing: object) -> str:
    text = " ".join((inspect.getdoc(thing) or "").split("\n\n")[0].split())
    return text.replace("``", "`")


def lowered(sentence: str) -> str:
    """A sentence as a part of another one."""
    return f"{sentence[0].lower()}{sentence[1:].removesuffix('.')}"


def faults() -> str:
    rows = [
        [
            f"`{entry.name}`",
            entry.part,
            entry.summary,
            "; ".join(
                f"`{s.name}={default_text(s.default)}`: {lowered(s.summary)}"
                for s in entry.settings().values()
                if s.name not in SHARED
            ),
        ]
        for entry in FAULTS.values()
    ]
    return table(["Fault", "Of the", "What happens", "Settings with their defaults"], rows)


def command_table() -> str:
    entries = {**app.COMMANDS, **STUDIES}
    rows = [[f"[`glucoloop {name}`](commands/{name}.md)", entries[name].summary] for name in app.names()]
    return table(["Command", "What it does"], rows)


def commands(folder: Path) -> dict[Path, str]:
    """A page for each command."""
    return {folder / f"{name}.md": command_page(name) for name in app.names()}


def command_page(name: str) -> str:
    command = app.command_of(name)
    parts = [f"# glucoloop {name}", "", help_text(command.intro)]
    panels: dict[str, list[CommandOption]] = {}
    for option in command.options:
        if option.flag.startswith("-"):
            panels.setdefault(option.panel, []).append(option)
        else:
            parts.append(f"`{option.flag}`\n: {option.help}\n")
    for panel in sorted(panels, key=lambda panel: PANELS.index(panel) if panel in PANELS else -1):
        rows = [option_row(option) for option in panels[panel]]
        parts += [f"## {panel}\n", table(["Option", "Default", "Meaning"], rows)]
    return "\n".join(parts)


def help_text(text: str) -> str:
    """Paragraphs, and the indented example lines as code."""
    parts, examples = [], []
    for paragraph in [*text.split("\n\n"), ""]:
        if paragraph.startswith("  "):
            examples.append(paragraph.strip())
            continue
        if examples:
            parts.append("```text\n" + "\n".join(examples) + "\n```")
            examples = []
        parts.append(paragraph)
    return "\n\n".join(parts) + "\n"


def option_row(option: CommandOption) -> list[str]:
    value = f" [{option.metavar}]" if option.alone else f" {option.metavar}" if option.metavar else ""
    return [code(option.flag + value), option.default, option.help]


def record_columns() -> str:
    from glucoloop.storage.results import RECORD_COLUMNS

    return ", ".join(map(code, RECORD_COLUMNS)) + "\n"


def names_of(package: ModuleType) -> str:
    """A table of what a module takes from others: each name with its place and its first sentence."""
    rows = []
    for name in sorted(package.__all__, key=str.lower):
        thing = getattr(package, name)
        if isinstance(thing, ModuleType):
            continue
        is_constant = not hasattr(thing, "__qualname__")
        link = f"``{name}``" if is_constant else f":py:obj:`{name} <{thing.__module__}.{thing.__qualname__}>`"
        rows.append(f"   * - {link}\n     - {first_sentence(thing).replace('`', '``')}")
    return "\n".join([".. list-table::", "   :widths: 30 70", "", *rows]) + "\n"


def modules(package: ModuleType) -> list[str]:
    if not hasattr(package, "__path__"):
        return []
    result = []
    for info in pkgutil.iter_modules(package.__path__, f"{package.__name__}."):
        if info.name.rpartition(".")[2].startswith("_"):
            continue
        result.append(info.name)
        if info.ispkg:
            result += modules(importlib.import_module(info.name))
    return result


def api(folder: Path) -> dict[Path, str]:
    """A page for each layer; a layer of many modules has one for each of them, which it links, so that none is long."""
    pages = {}
    for info in pkgutil.iter_modules(glucoloop.__path__):
        if info.name.startswith("_") or info.name in LEFT_OUT:
            continue
        layer = f"glucoloop.{info.name}"
        inside = modules(importlib.import_module(layer))
        parts = [*heading(layer, "="), f".. automodule:: {layer}", "" if inside else "   :members:", ""]
        if layer == plugin.__name__:  # whose names stand on the pages of their modules
            parts = [*heading(layer, "="), f".. automodule:: {layer}", "", names_of(plugin)]
        if len(inside) <= MAX_MODULES_OF_A_PAGE:
            for name in inside:
                parts += [*heading(name, "-"), *module(name)]
        else:
            parts += [".. list-table::", "   :widths: 40 60", ""]
            for name in inside:
                of_layer = name.removeprefix(f"{layer}.")
                summary = first_sentence(importlib.import_module(name)).replace("`", "``")
                parts += [f"   * - :doc:`{of_layer} <{info.name}/{of_layer}>`", f"     - {summary}"]
                back = f"A module of :doc:`{layer} <../{info.name}>`."
                page = [":orphan:", "", *heading(name, "="), back, "", *module(name)]
                pages[folder / info.name / f"{of_layer}.rst"] = "\n".join(page) + "\n"
        pages[folder / f"{info.name}.rst"] = "\n".join(parts) + "\n"
    return pages


def heading(text: str, line: str) -> list[str]:
    return [text, line * len(text), ""]


def module(name: str) -> list[str]:
    spec = importlib.util.find_spec(name)  # which imports no library that a module may need
    members = ["   :members:"] if spec is None or spec.submodule_search_locations is None else []
    return [f".. automodule:: {name}", *members, ""]


def included(docs: Path) -> list[str]:
    """Files that a page includes, from the folder of the documentation: they are no pages of their own."""
    result = set()
    for page in [*docs.glob("*.md"), *docs.glob("guide/*.md")]:
        for name in re.findall(r"^```\{include\} (\S+)$", page.read_text(encoding="utf-8"), re.M):
            result.add((page.parent / name).resolve())
    return sorted(str(path.relative_to(docs)) for path in result if path.is_relative_to(docs))


def write_all(docs: Path) -> None:
    """Write what has changed, so that an unchanged page is not built again."""
    made = docs / "_generated"
    pages = {
        made / "constants.md": constants(),
        made / "operating-points.md": operating_points(),
        made / "steady-states.md": steady_states(),
        made / "controllers.md": controllers(),
        made / "faults.md": faults(),
        made / "metrics.md": metrics(),
        made / "metrics-of-records.md": metrics_of_records(),
        made / "interpretations.md": interpretations(),
        made / "printed.md": printed(),
        made / "deviations.md": deviations(),
        made / "conversions.md": conversions(),
        made / "other-units.md": other_units(),
        made / "layers.md": layers(docs.parent),
        made / "house.svg": house_drawing(),
        made / "commands.md": command_table(),
        made / "hazards.md": safety.hazards(SafetyFile.read()),
        made / "requirements.md": safety.requirements(SafetyFile.read()),
        made / "record-columns.md": record_columns(),
        made / "everyday.rst": names_of(glucoloop),
        made / "lab.html": pack.page(),
        **commands(docs / "commands"),
        **api(docs / "api"),
    }
    for folder in (made, docs / "commands", docs / "api"):
        for path in folder.rglob("*"):
            if path.is_file() and path not in pages:
                path.unlink()
    for path, text in pages.items():
        path.parent.mkdir(parents=True, exist_ok=True)
        if not path.exists() or path.read_text(encoding="utf-8") != text:
            path.write_text(text, encoding="utf-8")


if __name__ == "__main__":
    write_all(Path(__file__).resolve().parent)
