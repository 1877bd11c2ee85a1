"""``glucoloop cite``: publications to cite for what a run was made of."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, Final

from glucoloop.cli.command import ALLOW_CODE, Command, CommandOption, Given
from glucoloop.cli.screen import note, print_text, print_value
from glucoloop.component.base import Component
from glucoloop.component.catalogue import catalogues
from glucoloop.component.code import loaded
from glucoloop.component.grammar import NONE
from glucoloop.component.listing import Reference, cited_components, known_references, reference
from glucoloop.component.setting import Setting, known_names
from glucoloop.metrics.metric import METRICS
from glucoloop.refusal import Refusal
from glucoloop.studies.catalogue import STUDIES

HELP: Final = (
    "Print what to cite for a run, a trial or another study: glucoloop, and the publications of each patient, "
    "population, meal model, sensor, pump, controller, estimator and metric in it, as BibTeX.\n\n"
    "Name the folder or the file that a command wrote, or components by their names. Without either, glucoloop alone "
    "is cited. A component that follows no publication, or that another package brings without naming one, is said.\n\n"
    "  glucoloop cite trial\n\n"
    "  glucoloop cite run/run.toml > run.bib\n\n"
    "  glucoloop cite hovorka-2004 dexcom-g6"
)
_PROGRAM: Final = "glucoloop"


def _cite(typed: Given) -> None:
    """Print the entries, each once, with a comment that says what it is for."""
    config = typed.get("what", ())
    whose: dict[str, list[str]] = {_PROGRAM: ["the program"]}
    for what, sources in (pair for text in config for pair in _parts_of(str(text))):
        for source in sources:
            users = whose.setdefault(source, [])
            if what not in users:
                users.append(what)
        if not sources:
            note([f"The {what} names no publication."])
    references = [(source, reference(source), users) for source, users in whose.items()]
    if typed.get("json"):
        from glucoloop.storage.files import with_version

        print_value(with_version({"references": [_plain(*entry) for entry in references]}))
        return
    for number, (_, entry, users) in enumerate(references, start=1):
        print_text(f"% {'; '.join(users)}\n{entry.bibtex(entry.key or f'source{number}')}\n")


def _plain(source: str, entry: Reference, users: list[str]) -> dict[str, Any]:
    return {"key": entry.key, "for": users, "text": entry.text, "authors": entry.authors, **entry.fields}


def _parts_of(text: str) -> Iterator[tuple[str, tuple[str, ...]]]:
    """Components of a folder, of a file, or by a name, with the publications of each."""
    path = Path(text)
    if path.is_dir():
        files = sorted(file for file in path.glob("*.toml") if file.stem in STUDIES)
        if not files:
            raise Refusal(f"{text} holds no configuration that a command wrote; name the folder of a run or a trial")
        for file in files:
            yield from _parts_of_file(file)
    elif path.is_file():
        yield from _parts_of_file(path)
    else:
        yield from _named(text)


def _parts_of_file(path: Path) -> Iterator[tuple[str, tuple[str, ...]]]:
    """Components that the file of a command says were used; of this package those that follow a publication."""
    from glucoloop.situations.toml import read_file

    used = read_file(str(path)).used
    if used is None:
        raise Refusal(f"{path} does not say what was used; name a file that a command wrote, or its folder")
    settings = _settings()
    for key, leaf in used.items():
        if key == "population" and leaf in known_references():
            yield f"population {leaf}", (leaf,)
        if key in settings and leaf != NONE:
            for item in leaf if isinstance(leaf, list) else [leaf]:
                results = cited_components(settings[key].kind.catalogue.read(_without_computed(item)))
                yield from (
                    _described(component) for component in results if component.sources or not _is_own(component)
                )
    if "metrics" in used:
        yield from (_described(component) for component in METRICS.values() if component.always and component.sources)


def _without_computed(tree: Any) -> Any:
    """The tree of a component without what its design settled."""
    return {key: leaf for key, leaf in tree.items() if key != "settled"} if isinstance(tree, dict) else tree


def _is_own(component: type[Component]) -> bool:
    return component.__module__.partition(".")[0] == _PROGRAM


def _described(component: type[Component]) -> tuple[str, tuple[str, ...]]:
    return f"{component.kind} {component.name}", component.sources


def _settings() -> Mapping[str, Setting]:
    """Settings of all studies whose values are components, by name."""
    results: dict[str, Setting] = {}
    for entry in STUDIES.values():
        request: type[Component] | None = getattr(loaded(entry.place), "request", None)
        if request is not None:
            results.update((name, setting) for name, setting in request.settings().items() if setting.is_component)
    return results


def _named(name: str) -> Iterator[tuple[str, tuple[str, ...]]]:
    kinds = catalogues()
    results = [components.find(name) for components in kinds.values() if name in components.names()]
    yield from map(_described, results)
    populations = {population for component in kinds["patient"].values() for population in component.populations}
    if name in populations:
        yield f"population {name}", (name,) if name in known_references() else ()
    elif not results:
        every = [*populations, *(known for components in kinds.values() for known in components.names())]
        known = known_names(name, every, where="glucoloop list shows every component")
        raise Refusal(f"there is no file, folder or component {name!r}; {known}")


CITE: Final = Command(
    "cite",
    HELP,
    (
        CommandOption(
            "what",
            "WHAT...",
            "A folder or a file that a command wrote, or the name of a component.",
            metavar="WHAT",
            required=False,
            many=True,
        ),
        ALLOW_CODE,
        CommandOption("json", "--json", "Print one JSON object: a list of references."),
    ),
    _cite,
)
