"""A refusal names no remedy that the command lacks: those of code that commands share are data, and are left out."""

import ast
import functools
from pathlib import Path

import pytest

import glucoloop
from glucoloop.cli.app import command_of, names
from glucoloop.component.code import loaded
from glucoloop.refusal import Refusal, options_named
from glucoloop.studies.catalogue import STUDIES
from naming import naming

ROOT = Path(glucoloop.__file__).parent
OPTIONS = {name: {"--help", *(option.flag for option in command_of(name).options)} for name in names()}
WRITING = frozenset(name for name in OPTIONS if "--out" in OPTIONS[name])
FILE = {"cli/screen.py": frozenset({"lab", "records"})}
SHARED = {
    "cli/command.py": None,  # what is said of an option that was typed
    "cli/request.py": None,
    "component/base.py": None,
    "storage/disk.py": WRITING,
    "storage/folder.py": WRITING,
    "storage/resumable.py": WRITING,
    "storage/rows.py": WRITING,
    "trials/computing.py": None,
    "trials/folder.py": WRITING,
    "firmware/hil": frozenset({"hil"}),
    "cli/study_command.py": WRITING,
    "studies/export/study.py": frozenset({"export"}),
    "lab": frozenset({"lab"}),
    "twins": frozenset({"twin", "replay"}),
    "studies/guarded.py": frozenset({"stress", "adversary"}),
    **FILE,
}
"""Code whose refusals only these commands meet; None where they name options that were typed."""


def commands_of(file):
    """The commands that can meet a refusal of a file; None where it names what was typed, or all."""
    within = file.relative_to(ROOT).as_posix()
    shared = next((place for place in SHARED if within == place or within.startswith(f"{place}/")), None)
    if shared is not None:
        return SHARED[shared]
    package = ".".join(("glucoloop", *file.relative_to(ROOT).parent.parts))
    own = {name for name, entry in STUDIES.items() if loaded(entry.place).module.startswith(f"{package}.")}
    if own and package not in ("glucoloop", "glucoloop.studies"):
        # a run of one controller, and hardware in the loop, are made of the comparison's code
        return frozenset(own)
    if within.startswith("cli/") and file.stem in OPTIONS:
        return frozenset({file.stem})
    return frozenset(OPTIONS)


def text_of(node):
    """All text that an expression holds."""
    return "\n".join(
        part.value for part in ast.walk(node) if isinstance(part, ast.Constant) and isinstance(part.value, str)
    )


@functools.cache
def refusals():
    """Each place at which the code refuses something: the file, and the call."""
    return [
        (file, node)
        for file in sorted(ROOT.rglob("*.py"))
        for node in ast.walk(ast.parse(file.read_text(encoding="utf-8")))
        if isinstance(node, ast.Call) and getattr(node.func, "id", "") == "Refusal" and node.args
    ]


def test_what_a_refusal_says_in_any_case_names_only_options_that_each_command_has():
    seen, wrong = 0, []
    for file, call in refusals():
        named, commands = options_named(text_of(call.args[0])), commands_of(file)
        seen += bool(named)
        wrong += [
            f"{file}:{call.lineno} names {', '.join(named - OPTIONS[command])} in {command}"
            for command in commands or ()
            if not named <= OPTIONS[command]
        ]
    assert not wrong, "\n".join(wrong)
    assert seen > 30


def test_a_remedy_is_told_by_the_commands_that_have_its_options_alone():
    remedies = {text_of(remedy): f"{file.stem}-{call.lineno}" for file, call in refusals() for remedy in call.args[1:]}
    with_options = {text: place for text, place in remedies.items() if options_named(text)}
    assert len(with_options) > 10
    for text, place in with_options.items():
        for command, options in OPTIONS.items():
            with naming(place, text, command):
                told = Refusal("it is wrong", text, "leave it out").of_command(command, options)
                assert options_named(told) <= options
                assert (text in told) == (options_named(text) <= options)
                assert told.startswith("it is wrong; ")
                assert told.endswith("leave it out")


def test_a_refusal_without_any_remedy_that_the_command_has_says_so():
    refusal = Refusal("the clock is missing", "give --start 06:00")
    assert str(refusal) == "the clock is missing; give --start 06:00"
    assert refusal.of_command("league", {"--out"}) == "the clock is missing; no option of glucoloop league changes that"
    assert refusal.of_command("run", {"--start"}) == str(refusal)


def test_a_refusal_within_another_keeps_its_remedies():
    refusal = Refusal("it is wrong.", "add --allow-unusual", "see `glucoloop identify --noise`").within("case 'a'")
    assert str(refusal) == "case 'a': it is wrong. Add --allow-unusual, or see `glucoloop identify --noise`"
    assert refusal.of_command("cite", ()) == "case 'a': it is wrong. See `glucoloop identify --noise`"


def test_own_code_of_a_run_is_cited_where_it_is_allowed(glucoloop, install, tmp_path):
    install("your_own_controller", "controllers", "your-own-pi", "YourOwnPI")
    (tmp_path / "run.toml").write_text(
        '[used]\n[[used.controller]]\nname = "your_own_controller:YourOwnPI"\n', encoding="utf-8"
    )
    refused = glucoloop("cite", "run.toml")
    assert refused.code == 2
    assert "add --allow-code if you trust the file" in refused.err
    assert glucoloop("cite", "run.toml", "--allow-code").code == 0


def test_a_doubtful_number_in_the_league_is_refused_without_the_option_that_it_lacks(refused):
    told = refused("league", "--out", "out", "--controller", "pid, gain=1e9")
    assert "usually from 0.001 to 100" in told
    assert "--allow-unusual" not in told


@pytest.mark.parametrize("command", ["twin", "report", "records"])
def test_a_question_about_a_file_is_asked_where_it_can_be_answered(refused, tmp_path, command):
    (tmp_path / "diary.csv").write_text("Zeit,BZ\n1,2\n", encoding="utf-8")
    told = refused(command, "diary.csv")
    assert not options_named(told) - OPTIONS[command]
    assert ("(--columns)" in told) == ("--columns" in OPTIONS[command])
    assert ("glucoloop records" in told) == (command == "twin")
