"""Options of the commands, made from the settings of what they ask for."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any, Final

from glucoloop.component.base import Component
from glucoloop.component.request import Request, request_of
from glucoloop.component.setting import Setting, value_text
from glucoloop.situations.option import OUTPUT_PANEL, WORK_PANEL, Option

Given = dict[str, Any]
"""Text of each option that was given, by its key: True for a switch, a list where it may be repeated."""
_METAVARS: Final = {"mg/dl": "MG/DL", "mU/min": "MU/MIN", "min": "MIN", "%": "PCT", "U": "U"}


@dataclass(frozen=True)
class CommandOption:
    """One option of a command, or one of its arguments."""

    key: str
    flag: str
    """Name with dashes; without dashes it is an argument."""
    help: str
    panel: str = OUTPUT_PANEL
    metavar: str | None = None
    """Placeholder of the value; None for a switch."""
    many: bool = False
    default: str = ""
    rare: bool = False
    alone: str = ""
    """Text for which it stands without a value, where it may."""
    required: bool = True
    """Whether an argument is needed."""
    setting: Setting | None = None
    """Setting that it gives."""

    @property
    def is_argument(self) -> bool:
        """Whether it is an argument."""
        return not self.flag.startswith("-")

    @property
    def placeholder(self) -> str:
        """Place of the value in the help, after a blank; empty for a switch and for an argument."""
        if self.metavar is None or self.is_argument:
            return ""
        return f" [{self.metavar}]" if self.alone else f" {self.metavar}"

    @property
    def text(self) -> str:
        """Sentence of the help, with the default."""
        return f"{self.help} Default: {self.default}." if self.default else self.help


def options_of(root: type[Component]) -> tuple[CommandOption, ...]:
    """Options of the settings of a class that are declared as such and not refused; with a sensor, the short ones."""
    options = [
        CommandOption(
            key=setting.name,
            flag=about.flag or flag_of(setting.name, setting.unit),
            help=about.summary,
            panel=about.panel,
            metavar=None if setting.kind is bool else about.metavar or _metavar(setting),
            many=setting.many,
            default=_default_text(setting) or about.default,
            rare=about.rare,
            alone=about.alone,
            setting=setting,
        )
        for setting in root.settings().values()
        if isinstance(about := setting.about, Option) and setting.name not in root.refused
    ]
    return (*options, *(SHORT if any(option.key == "sensor" for option in options) else ()))


def flag_of(name: str, unit: str) -> str:
    """Name of the option of a setting: without its unit."""
    ending = f"_{unit.replace('/', '_').replace('%', 'pct')}" if unit in _METAVARS else ""
    return f"--{(name.removesuffix(ending) if ending else name).replace('_', '-')}"


def _metavar(setting: Setting) -> str:
    if setting.is_component:
        return "COMPONENT"
    return (
        "|".join(map(str, setting.choices))
        or _METAVARS.get(setting.unit)
        or {int: "N", float: "X"}.get(setting.kind, "NAME")
    )


def _default_text(setting: Setting) -> str:
    """The default in words; empty where it goes without saying: none, off, or an empty list."""
    default = setting.default.noise_free
    if default is None or isinstance(default, bool | Request) or default == ():
        return ""
    if isinstance(default, tuple) and isinstance(default[0], Component | Request):
        return ", ".join(request_of(component).text for component in default)
    return ", ".join(map(value_text, default)) if setting.many else value_text(default)


def reworded(options: Iterable[CommandOption], **by_field: Mapping[str, Any]) -> Iterator[CommandOption]:
    """Options with other texts by key, in place of some of theirs: ``help={"people": "Number of people."}``."""
    for option in options:
        texts: dict[str, Any] = {
            field: by_key[option.key] for field, by_key in by_field.items() if option.key in by_key
        }
        yield dataclasses.replace(option, **texts)


CONFIG: Final = CommandOption(
    "config", "--config", "Read a TOML file; what is given here is laid over it.", metavar="FILE"
)
SET: Final = CommandOption(
    "set",
    "--set",
    "A setting by its path, like patient.operating_point=fasting-81; repeat it.",
    metavar="PATH=VALUE",
    many=True,
)
ALLOW_CODE: Final = CommandOption(
    "allow_code",
    "--allow-code",
    "Import the code, module:attribute, that a file or folder names; without it only what is given here is imported.",
    rare=True,
)
"""Option that the program reads itself, before the command."""
OUT: Final = CommandOption("out", "--out", "Folder for tables, figures and the configuration.", metavar="DIR")
OVERWRITE: Final = CommandOption("overwrite", "--overwrite", "Replace an earlier result in that folder.")
JSON: Final = CommandOption("json", "--json", "Print one JSON object instead of a table.")
UNITS: Final = CommandOption(
    "units",
    "--units",
    "Show results in mmol/l, U/h or both; data files keep mg/dl and mU/min.",
    metavar="UNIT,UNIT",
)
OUTPUT: Final = (CONFIG, SET, ALLOW_CODE, OUT, OVERWRITE, JSON)
WORKERS: Final = CommandOption(
    "workers",
    "--workers",
    "Threads that compute; with --dask local, processes.",
    panel=WORK_PANEL,
    metavar="N",
    default="one a core",
)
DASK: Final = CommandOption(
    "dask",
    "--dask",
    "Compute on a Dask cluster: the address of its scheduler, like tcp://10.0.0.1:8786, or local.",
    panel=WORK_PANEL,
    metavar="ADDRESS",
)
NOISE: Final = CommandOption(
    "noise",
    "--noise",
    "Variance of white noise on each reading, (mg/dl)²; the paper's is 1.45. Short for a component of --sensor.",
    panel="Sensor and pump",
    metavar="VARIANCE",
)
DEAD_TIME: Final = CommandOption(
    "dead_time",
    "--dead-time",
    "Delay of the readings in whole samples. Short for a component of --sensor.",
    panel="Sensor and pump",
    metavar="MIN",
)
SHORT: Final = (NOISE, DEAD_TIME)
"""Options that stand for a component of the sensor."""
