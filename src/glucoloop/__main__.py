"""``python -m glucoloop``."""

from glucoloop.cli import program

program()
