"""Request of the user: keys of a configuration file overridden by the command line, and the use of the results."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, Protocol, TypeVar

from glucoloop.cli.options import ALLOW_CODE, CASE, SETTINGS, SITUATION, Given
from glucoloop.cli.results import written_whole
from glucoloop.cli.screen import note
from glucoloop.control.catalogue import setting_names
from glucoloop.parts.keyed_values import keyed_values
from glucoloop.refusal import Refusal

T = TypeVar("T")

if TYPE_CHECKING:
    from glucoloop.storage.folder import OutputFolder


@dataclass(frozen=True)
class Output:
    """Destination of the results."""

    out: Path | None
    overwrite: bool
    json: bool
    mmol: bool

    @property
    def place(self) -> Path | None:
        """Path of the output folder, or None if nothing is to be written; ValueError if there is none to overwrite."""
        if self.out is None and self.overwrite:
            raise Refusal("--overwrite is about an output folder; name one with --out")
        return self.out

    def folder(self) -> contextlib.AbstractContextManager[OutputFolder | None]:
        """The output folder, or None if nothing is to be written."""
        from glucoloop.storage.folder import output_folder

        place = self.place
        if place is None:
            return written_whole(contextlib.nullcontext(), None)
        return written_whole(output_folder(place, overwrite=self.overwrite), place)


def split_off_output(given: Given) -> tuple[Given, Output, Path | None]:
    """Configuration keys, destination of the results, and the configuration file."""
    keys = dict(given)
    keys.pop(ALLOW_CODE.key, None)
    out, config = keys.pop("out", None), keys.pop("config", None)
    if out == "" or config == "":
        raise Refusal(f"--{'out' if out == '' else 'config'} is empty; give a path")
    output = Output(
        out=None if out is None else Path(out),
        overwrite=bool(keys.pop("overwrite", False)),
        json=bool(keys.pop("json", False)),
        mmol=bool(keys.pop("mmol", False)),
    )
    return keys, output, None if config is None else Path(config)


def with_lists(keys: Given) -> Given:
    """Keys with meals and faults as one list each; ``--no-meal`` and ``--no-fault`` give empty lists.

    Each ``--setting KEY=VALUE`` becomes a key like the others.

    Raises
    ------
    ValueError
        For options that exclude one another, or a malformed setting.
    """
    keys = _with_settings(keys)
    for several, none, called in (("meals", "no_meal", "meal"), ("faults", "no_fault", "fault")):
        without = keys.pop(none, False)
        if not keys.get(several):
            keys.pop(several, None)
        if without and several in keys:
            raise Refusal(f"--{called} and --no-{called} exclude one another; leave one out")
        if without:
            keys[several] = []
    return keys


def _with_settings(keys: Given) -> Given:
    keys = dict(keys)
    given = keyed_values(keys.pop(SETTINGS, None) or (), "option --setting", "gain=0.2")
    options = {option.key: option.name for option in (*SITUATION, *CASE)}
    for key in given:
        if key in keys:
            raise Refusal(f"--setting {key} and {options.get(key, key)} say the same; leave one out")
        if key in options and key not in setting_names():
            raise Refusal(f"{key} is not a setting of a controller; give {options[key]} in place of --setting")
    return {**keys, **given}


_PATHS: Final = ("model", "data")


class _Used(Protocol):
    def keys(self) -> Mapping[str, Any]: ...


class FileKeys(dict[str, Any]):
    """Keys of a configuration file, with what was used when it was written."""

    path: Path | None = None
    used: Mapping[str, Any] | None = None


def file_keys(path: Path | None) -> FileKeys:
    """Keys of a configuration file; the paths in it start at the file."""
    import glucoloop
    from glucoloop.config.toml import beside, read_toml
    from glucoloop.storage.files import read_text

    if path is None:
        return FileKeys()
    written = read_toml(read_text(path, "a configuration"), str(path))
    keys, version = FileKeys(written.keys), written.version
    keys.path, keys.used = path, written.used
    if version is not None and version != glucoloop.__version__:
        note([f"{path} was written by glucoloop {version}; this is {glucoloop.__version__}, and numbers may differ."])
    cases = keys.get("case")
    for table in (keys, *(cases if isinstance(cases, list) else ())):
        if not isinstance(table, dict):
            continue
        for key in _PATHS:
            if isinstance(table.get(key), str):
                table[key] = beside(table[key], path)
    population = keys.get("population")
    if isinstance(population, str) and population.endswith(".toml"):  # and not the name of a preset
        keys["population"] = beside(population, path)
    return keys


def keys_used(asked: _Used) -> Mapping[str, Any]:
    """All keys of a request, with the values that are used."""
    return asked.keys()


def read_again(
    read: Callable[[Given, Given], T], used: Callable[[T], Mapping[str, Any]], keys: Given, of_file: Given
) -> T:
    """Read a request, with a note on where the file alone leads to other values now than when it was written.

    Parameters
    ----------
    read : callable
        Function of the keys of the command line and of those of the file.
    used : callable
        Function of what was read, that returns all values that are used, by key.
    keys, of_file : dict
    """
    asked = read(dict(keys), _copied(of_file))
    if isinstance(of_file, FileKeys) and of_file.used is not None:
        with contextlib.suppress(Refusal):  # a file that does not stand alone
            _note_changes(of_file, used(read({}, _copied(of_file))))
    return asked


def _copied(of_file: Given) -> Given:
    """Keys of a file, for a reader that takes some of them out."""
    cases = of_file.get("case")
    return {**of_file, **({"case": [*cases]} if isinstance(cases, list) else {})}


def _note_changes(of_file: FileKeys, now: Mapping[str, Any]) -> None:
    from glucoloop.config.toml import SETTLED_KEY
    from glucoloop.storage.origin import differences

    then = {key: value for key, value in (of_file.used or {}).items() if key in now and key not in _PATHS}
    if isinstance(then.get("case"), list):
        then["case"] = [{key: value for key, value in of.items() if key != SETTLED_KEY} for of in then["case"]]
    differing = [
        f"{name} was {before} and is {after}"
        for name, before, after in differences(then, {key: now[key] for key in then})
    ]
    if differing:
        note([f"What {of_file.path} leaves out was filled in otherwise when it was written: {'; '.join(differing)}."])
