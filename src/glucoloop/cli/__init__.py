"""The command line. A command imports what it needs when it runs, so that help is shown at once."""

from glucoloop.cli.app import main, program

__all__ = ["main", "program"]
