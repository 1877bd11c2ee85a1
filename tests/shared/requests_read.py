"""The request of a command, whether it is declared as a study or has a module of its own in `cli`."""

import importlib

from glucoloop.cli.declared import asked_of
from glucoloop.studies.catalogue import STUDIES


def request_of(command, keys, of_file):
    """The request from the keys of the command line and those of a file."""
    for study in STUDIES:
        if study.name == command:
            return asked_of(study, keys, of_file)[1]
    return importlib.import_module(f"glucoloop.cli.{command}")._read(keys, of_file)
