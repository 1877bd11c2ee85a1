"""What a command is asked for, from what is typed and from the file that is named there."""

from glucoloop.cli.app import command_of
from glucoloop.cli.request import command_request
from glucoloop.component.code import loaded
from glucoloop.component.request import configuration_from
from glucoloop.studies.catalogue import STUDIES


def root_of(command):
    """The class of what a command asks for."""
    return loaded(STUDIES[command].place).request


def typed(command, *arguments):
    """The tree of what is typed, laid over that of the file."""
    of = command_of(command)
    return command_request(of.given([str(argument) for argument in arguments]), of.options)


def asked(command, *arguments):
    """What is asked for, complete."""
    return configuration_from(root_of(command), typed(command, *arguments).tree)
