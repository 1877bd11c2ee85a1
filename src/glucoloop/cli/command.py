"""A command: its help, its options, and the function that carries it out."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from glucoloop.cli.option import CommandOption, Given
from glucoloop.cli.parser import Parser


@dataclass(frozen=True)
class Command:
    """One command of the program."""

    name: str
    intro: str
    """Paragraphs of the help; those that begin with two spaces are examples."""
    options: tuple[CommandOption, ...]
    carry_out: Callable[[Given], None]
    more: str = ""
    """Name with which `glucoloop list` describes the options that the help only names."""

    def parser(self) -> Parser:
        """Parser of its arguments."""
        return Parser(f"glucoloop {self.name}", self.intro, self.options, self.more)

    def help(self) -> str:
        """Help of the command."""
        return self.parser().format_help()
