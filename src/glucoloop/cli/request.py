"""Requests from what was typed: options and a file become one tree, and the results get their place."""

from __future__ import annotations

import contextlib
import dataclasses
import functools
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, TypeVar

from glucoloop.cli.command import DEAD_TIME, NOISE, SET, CommandOption, Given, options_of
from glucoloop.cli.errors import written_whole
from glucoloop.cli.screen import for_terminal, note, stage
from glucoloop.component.base import Component
from glucoloop.component.grammar import NAME, NONE, Leaf, Tree, as_table, as_tables, as_tree, over, plain, put
from glucoloop.component.request import configuration_from
from glucoloop.patients.catalogue import DEFAULT_PATIENT
from glucoloop.refusal import Refusal

if TYPE_CHECKING:
    from glucoloop.storage.folder import OutputFolder

P = TypeVar("P", bound=Component)

_NOT_FILLED_IN: Final = ("settled.", "model.path", "data")
"""Keys of a file that do not follow from what it leaves out: designs, and paths from its folder."""
_EXPERIMENT: Final = ("patient", "sensor", "amplitude_mU_min", "samples")
_RECORD: Final = ("data", "method", "max_gap_min", "basal_insulin_mU_min", "not_from_rest")
_EXCLUDING: Final = {
    "days": ("duration_min",),
    "duration_min": ("days",),
    "data": _EXPERIMENT,
    **dict.fromkeys(_EXPERIMENT, _RECORD),
    "best_pole": ("laguerre_pole",),
    "laguerre_pole": ("best_pole",),
}
"""Settings of a file that a setting of the command line takes the place of."""


@dataclass(frozen=True)
class Output:
    """Destination of the results."""

    out: Path | None
    overwrite: bool = False
    json: bool = False

    @property
    def place(self) -> Path | None:
        """Path of the output folder, or None if nothing is to be written; Refusal if there is none to overwrite."""
        if self.out is None and self.overwrite:
            raise Refusal("--overwrite is about an output folder; name one with --out")
        return self.out

    def folder(self, *holds: str) -> contextlib.AbstractContextManager[OutputFolder | None]:
        """The output folder, or None if nothing is to be written; every one of the command holds files of these names.

        It is entered before anything is computed, so that a place that cannot be used is refused at once.
        """
        from glucoloop.storage.folder import output_folder

        place = self.place
        if place is None:
            return written_whole(contextlib.nullcontext(), None)
        return written_whole(output_folder(place, overwrite=self.overwrite, holds=holds), place)


@dataclass(frozen=True)
class CommandRequest:
    """A tree of given values, and what to do with the results."""

    tree: Tree
    output: Output
    config: Path | None = None
    of_file: Tree = field(default_factory=dict)
    """Tree of the file alone."""
    used: Mapping[str, Any] | None = None
    """Values that were used when the configuration file was written, if it tells them."""


def command_request(typed: Given, options: Iterable[CommandOption]) -> CommandRequest:
    """Options and the file that they name as one request; Refusal for a file or a text that cannot be read."""
    for key in ("out", "config"):
        if typed.get(key) == "":
            raise Refusal(f"--{key} is empty; give a path")
    out, path = (Path(typed[key]) if key in typed else None for key in ("out", "config"))
    output = Output(out, **{key: bool(typed.get(key)) for key in ("overwrite", "json")})
    by_key = {option.key: option for option in options if option.setting is not None}
    lower, used = _of_file(path)
    whole_names = {option.setting.name_without_unit: key for key, option in by_key.items() if option.setting}
    lower = {key if key in by_key else whole_names.get(key, key): leaf for key, leaf in lower.items()}
    tree = _laid_over(lower, {key: _leaf(by_key[key], value) for key, value in typed.items() if key in by_key})
    for option, name, setting in ((NOISE, "white-noise", "variance"), (DEAD_TIME, "dead-time", "minutes")):
        if option.key in typed:
            chain = as_tables(tree.get("sensor", []), "sensor")
            tree["sensor"] = _with_component(
                chain, name, {setting: Leaf(typed[option.key], option.flag, by_option=True)}
            )
    for text in typed.get(SET.key, ()):
        path_to, equals, value = map(str.strip, text.partition("="))
        path_to = path_to if path_to in by_key else whole_names.get(path_to, path_to)
        if not equals or not value:
            raise Refusal(f"--set {text!r} has no value; write it like --set patient.operating_point=fasting-81")
        named = by_key.get(path_to)
        if named is not None:  # as the option would read it
            leaf = _leaf(dataclasses.replace(named, flag=f"{SET.flag} {path_to}"), [value] if named.many else value)
            tree = _laid_over(tree, {path_to: leaf})
        else:
            tree = put(tree, path_to, value, f"{SET.flag} {path_to}")
    return CommandRequest(tree, output, path, lower, used)


def _leaf(option: CommandOption, value: Any) -> Any:
    """The value, the component, or the list of either that an option gives."""
    setting = option.setting
    assert setting is not None
    texts = [text for text in (value if option.many else [value]) if isinstance(text, str)]
    optional = option.many or (setting.is_component and setting.optional)
    if optional and any(text.strip() == NONE for text in texts):
        if len(texts) > 1:
            raise Refusal(f"{option.flag} none leaves all of them out; give it alone")
        return [] if option.many else Leaf(None, option.flag, text=False)
    if setting.is_component:
        if not all(text.strip() for text in texts):
            raise Refusal(f"{option.flag} is empty; give a component or settings after it")
        components = [setting.kind.catalogue.tree(text, option.flag) for text in texts]
        return components if option.many else components[0]
    if option.many:
        return [Leaf(text, option.flag, by_option=True) for text in value]
    return Leaf(value, option.flag, text=isinstance(value, str), by_option=True)


def _laid_over(lower: Tree, upper: Tree) -> Tree:
    """The options over the file: what is given again replaces what was there, and what it excludes."""
    tree, upper = dict(lower), dict(upper)
    for key, excluded in _EXCLUDING.items():
        if key in upper:
            tree = {name: value for name, value in tree.items() if name not in excluded or name in upper}
    patient = upper.get("patient")
    if isinstance(patient, Mapping) and NAME in patient and "population" not in upper:
        before = plain(as_table(tree.get("patient")))
        name = before.get(NAME) if isinstance(before, Mapping) else None
        if (name or DEFAULT_PATIENT.name) != plain(patient[NAME]):
            tree.pop("population", None)
    cases = upper.pop("controller", None)
    if cases is not None:
        tree["controller"] = _cases(tree.get("controller", []), cases)
    for key in ("guard", "model"):
        if key in upper and "controller" in tree and cases is None:
            tree["controller"] = [
                {**case, key: over(case[key], upper[key])} if key in case else case
                for case in as_tables(tree["controller"], "controller")
            ]
    for key, value in upper.items():
        tree[key] = over(tree[key], value) if key in tree and isinstance(value, Mapping) else value
    return tree


def _cases(in_file: Any, given_cases: list[Tree]) -> list[Tree]:
    """Controllers of the command line in place of those of the file, or over the one that is there."""
    named = [NAME in case for case in given_cases]
    if given_cases and all(named):
        return given_cases
    where = "--controller"
    if not given_cases:
        raise Refusal(f"{where} none leaves no controller; name one, like basal")
    tables = as_tables(in_file, "controller")
    if len(given_cases) > 1 and (any(named) or len(tables) != 1):
        raise Refusal(f"{where} is given {len(given_cases)} times, once without a name; name the controller")
    tables = tables or [{}]
    if len(tables) > 1:
        labels = ", ".join(str(plain(table.get("label", table.get(NAME)))) for table in tables)
        raise Refusal(
            f"{where}: the settings name no controller, and there are several ({labels})",
            "name one",
            "write --set controller.LABEL.setting=value",
        )
    return [functools.reduce(over, given_cases, tables[0])]


def _with_component(chain: list[Tree], name: str, settings: Tree) -> list[Tree]:
    """A chain in which a component has these settings; noise is put inside a dead time, either outside others."""
    if any(plain(component.get(NAME)) == name for component in chain):
        return [{**component, **settings} if plain(component.get(NAME)) == name else component for component in chain]
    [leaf] = settings.values()
    new = {NAME: Leaf(name, leaf.source), **settings}
    late = bool(chain) and name != "dead-time" and plain(chain[-1].get(NAME)) == "dead-time"
    return [*chain[:-1], new, chain[-1]] if late else [*chain, new]


def _of_file(path: Path | None) -> tuple[Tree, Mapping[str, Any] | None]:
    """Tree of a configuration file, with paths from the file, and the values that were used when it was written."""
    if path is None:
        return {}, None
    import glucoloop
    from glucoloop.situations.toml import read_toml
    from glucoloop.storage.files import read_text

    written = read_toml(read_text(path, "a configuration"), str(path))
    if written.version not in (None, glucoloop.__version__):
        versions = f"was written by glucoloop {written.version}; this is {glucoloop.__version__}"
        note([f"{path} {versions}, and numbers may differ."])
    return _beside(as_tree(written.keys, str(path)), path), written.used


def _beside(tree: Mapping[str, Any], path: Path) -> Tree:
    """The tree of a file with its paths from the folder of the file."""

    def in_folder(leaf: Any) -> Any:
        is_text = isinstance(plain(leaf), str)
        return Leaf(str(path.parent / leaf.value), leaf.source, text=False) if is_text else leaf

    results = dict(tree)
    if "data" in results:
        results["data"] = in_folder(results["data"])
    for key in ("population", "scenario"):
        if ".toml" in str(plain(results.get(key))):
            results[key] = in_folder(results[key])
    if isinstance(results.get("therapy"), list):
        named = (".toml", ".json")
        results["therapy"] = [in_folder(one) if str(plain(one)).endswith(named) else one for one in results["therapy"]]
    if "model" in results:
        from glucoloop.models.settings import MODELS

        model = results["model"]
        if isinstance(plain(model), str) and plain(model) != NONE:
            model = MODELS.tree(model.value, model.source)
        if isinstance(model, Mapping) and "path" in model:
            model = {**model, "path": in_folder(model["path"])}
        results["model"] = model
    if "controller" in results:
        cases = results["controller"]
        results["controller"] = [
            _beside(case, path) if isinstance(case, Mapping) and "model" in case else case
            for case in map(as_table, cases if isinstance(cases, list) else [cases])
        ]
    return results


def configuration_of(request: CommandRequest, root: type[P]) -> P:
    """The complete request, once the simulator is imported; with a note on what a file leaves out and is other now."""
    with stage("Importing the simulator"):
        if for_terminal():  # the settings of JAX are the user's in Python
            from glucoloop.cli.jax_cache import keep_compiled

            keep_compiled()  # before the patient's rest is computed
        config = configuration_from(root, request.tree)
        if request.used is not None:
            with contextlib.suppress(Refusal):  # a file that does not stand alone
                _note_changes(request, configuration_from(root, request.of_file).tree(whole=True))
    return config


def notes_without_effect(config: Component) -> tuple[str, ...]:
    """Notes on what was given of a complete request and changes nothing, by the names of options."""
    from glucoloop.situations.unused import without_effect

    flags = {option.key: option.flag for option in options_of(type(config))}
    return without_effect(config, lambda setting: flags.get(setting.name, setting.name))


def _note_changes(request: CommandRequest, now: Mapping[str, Any]) -> None:
    from glucoloop.storage.resumable import differences

    then = {key: value for key, value in (request.used or {}).items() if key in now}
    changes = "; ".join(
        f"{name} was {before} and is {after}"
        for name, before, after in differences(then, {key: now[key] for key in then})
        if not name.startswith(_NOT_FILLED_IN)
    )
    if changes:
        note([f"What {request.config} leaves out was filled in otherwise when it was written: {changes}."])
