"""``python -m glucoloop``."""

from glucoloop.cli import main

main()
