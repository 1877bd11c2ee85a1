"""What README and documentation tell a reader to type: it runs, it exists, and it leads somewhere."""

import re
import shlex
import tomllib
from pathlib import Path

import pytest

from device_files import clarity
from glucoloop.cli import app
from glucoloop.cli.request import command_request
from glucoloop.component.code import loaded
from glucoloop.component.request import read_root
from glucoloop.refusal import Refusal
from glucoloop.studies.catalogue import STUDIES
from naming import naming

ROOT = Path(__file__).resolve().parent.parent
README = ROOT / "README.md"
# Folders whose names begin with an underscore are written by the build of the pages, which may run beside the tests,
# as are the pages of the commands.
WRITTEN = ROOT / "docs/commands"
FOUND = [*ROOT.glob("docs/*.md"), *ROOT.glob("docs/[!_]*/**/*.md")]
PAGES = [README, *sorted(page for page in FOUND if WRITTEN not in page.parents)]
FENCE = re.compile(r"^```(\S*)[^\n]*\n(.*?)^```$", re.M | re.S)
REQUESTS = {name: loaded(entry.place).request for name, entry in STUDIES.items()}
COMMAND = re.compile(r"(?:python3 dev run|(?:\.venv/bin/)?glucoloop)(?: |$)")


def blocks(page, *languages):
    return [text for language, text in FENCE.findall(page.read_text(encoding="utf-8")) if language in languages]


def commands(page):
    """Calls of the program: lines of blocks, which a backslash joins, spans of text, and strings in R."""
    text = page.read_text(encoding="utf-8")
    joined = [re.sub(r"\\\n\s*", "", block) for block in blocks(page, "", "text")]
    lines = [line.strip() for block in joined for line in block.splitlines()]
    spans = re.findall(r"(?<!`)`([^`\n]+)`(?!`)", FENCE.sub("", text))
    of_r = [quoted for block in blocks(page, "r") for quoted in re.findall(r'"(glucoloop [^"]+)"', block)]
    found = [line for line in [*lines, *spans, *of_r] if COMMAND.match(line)]
    return [line.replace("python3 dev run", "glucoloop run").removeprefix(".venv/bin/") for line in found]


def written():
    return sorted({line for page in PAGES for line in commands(page)})


def test_there_are_commands_to_check():
    assert len(written()) > 100


def test_a_block_after_an_included_one_is_read(tmp_path):
    page = tmp_path / "page.md"
    page.write_text("```{include} figures.md\n```\n\n```text\nglucoloop run --out DIR\n```\n", encoding="utf-8")
    assert commands(page) == ["glucoloop run --out DIR"]


def test_a_command_that_is_written_exists_with_its_options(monkeypatch):
    monkeypatch.syspath_prepend(ROOT / "examples")
    texts = "\n".join(page.read_text(encoding="utf-8") for page in PAGES)
    for line in written():
        with naming(line):
            refuse_unknown(line, texts)


def refuse_unknown(line, texts):
    """Refuse a command with a name, an option or a value that is none, unless a page tells of the refusal."""
    _, *words = shlex.split(line)
    if not words or words[0].startswith("-"):
        return
    command = app.command_of(words[0])  # raises for one that does not exist
    arguments = [word for word in words[1:] if word not in ("DIR", "--help")]
    if not arguments:
        return
    given = command.given(arguments)  # raises for an option that does not exist
    if words[0] in REQUESTS and "config" not in given:
        try:
            read_root(REQUESTS[words[0]], command_request(given, command.options).tree)
        except Refusal as error:
            if f"{error}." not in texts:
                raise


def options():
    """Options of the commands, and those that a script of the repository names."""
    found = {"--help", "--version"}
    for name in app.names():
        found |= {option.flag for option in app.command_of(name).options}
    for folder in ("dev", "docs", "benchmarks", "validation"):
        for script in (ROOT / folder).rglob("*.py"):
            found |= set(re.findall(r"\"(--[a-z-]+)\"", script.read_text(encoding="utf-8")))
    return found


def test_an_option_that_a_text_names_exists():
    known = options()
    for page in PAGES:
        text = FENCE.sub("", page.read_text(encoding="utf-8"))
        with naming(page):
            assert set(re.findall(r"(?<!`)`(--[a-z-]+)", text)) <= known


def test_commands_stand_in_blocks_that_are_read_here():
    for page in PAGES:
        blocks_of_page = FENCE.findall(page.read_text(encoding="utf-8"))
        with naming(page):
            assert {of for of, text in blocks_of_page if "glucoloop " in text} <= {"", "text", "python", "r", "toml"}


def test_who_types_all_commands_of_a_page_names_no_folder_twice():
    first = [ROOT / "docs" / "getting-started.md", ROOT / "docs" / "tutorial.md"]
    for pages in (first, *([page] for page in PAGES)):
        folders = re.findall(r"--out (?!DIR)(\S+)", "\n".join(line for page in pages for line in commands(page)))
        with naming(*pages):
            assert sorted(folders) == sorted(set(folders))


def test_the_example_of_the_readme_runs(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    [example] = blocks(README, "python")
    exec(compile(example, str(README), "exec"), {})
    assert (tmp_path / "loop.png").stat().st_size > 10_000


def test_the_example_of_the_readme_is_the_one_in_examples():
    [example] = blocks(README, "python")
    told = (ROOT / "examples" / "close_the_loop.py").read_text(encoding="utf-8")
    loop = [line for line in example.splitlines() if line and not line.startswith("gl.plot")]
    assert set(loop) <= set(told.splitlines())


@pytest.mark.long
@pytest.mark.parametrize("page", [page for page in PAGES if blocks(page, "python")], ids=lambda page: page.stem)
def test_an_example_of_a_page_is_python_that_runs(page, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "clarity.csv").write_text(clarity(), encoding="utf-8")  # what a reader of the page has
    if page != README:
        exec(compile("\n".join(blocks(page, "python")), str(page), "exec"), {})


def test_links_of_the_readme_lead_to_files():
    links = re.findall(r"\]\(([^)#]+)", README.read_text(encoding="utf-8"))
    missing = [link for link in links if "://" not in link and not (ROOT / link).exists()]
    assert not missing


def test_the_picture_is_small():
    assert (ROOT / "docs" / "first-run.png").stat().st_size < 200_000


def test_the_layers_of_contributing_are_those_that_are_checked():
    settings = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
    contract = settings["tool"]["importlinter"]["contracts"][0]
    checked = [re.findall(r"\((?!_)(\w+)\)", layer) for layer in contract["layers"]]
    [told] = [block for block in blocks(ROOT / "CONTRIBUTING.md", "") if "cli > reproduction" in block]
    assert [layer.split(", ") for layer in re.split(r"\s*>\s*", told.strip())] == [layer for layer in checked if layer]
