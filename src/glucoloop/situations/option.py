"""A setting that is an option of a command as well: how the option is written, and where it stands in the help."""

from __future__ import annotations

from dataclasses import dataclass

from glucoloop.component.setting import About

PATIENT_PANEL = "Patient and meals"
SENSOR_PANEL = "Sensor and pump"
CONTROLLER_PANEL = "Controller"
PEOPLE_PANEL = "People"
WORK_PANEL = "Work"
RUN_PANEL = "Run"
OUTPUT_PANEL = "Files and output"
PANELS = (PEOPLE_PANEL, PATIENT_PANEL, SENSOR_PANEL, CONTROLLER_PANEL, RUN_PANEL, WORK_PANEL, OUTPUT_PANEL)
"""Headings of the help that commands share, in their order; those of a study of its own come first."""


@dataclass(frozen=True)
class Option(About):
    """Meaning of a setting and its possible values, and the option that stands for it."""

    panel: str = RUN_PANEL
    flag: str = ""
    """Name of the option; by default that of the setting without its unit."""
    metavar: str = ""
    """Placeholder of the value in help; by default the unit, or the choices."""
    default: str = ""
    """Default in words; by default the value."""
    rare: bool = False
    """Whether the help of commands only names it; `glucoloop list` with the name of the command describes it."""
    alone: str = ""
    """Text for which the option stands without a value, where it may."""
