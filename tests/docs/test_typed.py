"""Pages with what their commands print: commands are found, and what is shown follows them."""

import re

import pytest


@pytest.fixture
def typed(docs_module):
    return docs_module("typed")


def page_of(folder, text):
    (folder / "page.md").write_text(text, encoding="utf-8")
    return folder / "page.md"


def test_what_a_command_prints_follows_it(typed, tmp_path):
    folder, programs = tmp_path / "folder", tmp_path / "programs"
    folder.mkdir()
    programs.mkdir()
    typed.write_programs(programs)
    code = "# made.py\nprint('one')\nprint('two')\nprint('three')\n"
    page = page_of(
        tmp_path,
        f"Words.\n\n```python\n{code}```\n\n```text\npython made.py\n```\n\n```text output last 1\nold\n```\n\n"
        "```text output 2 from two\n```\n\n```text output\n```\n\n*What appears was not made yet.*\n",
    )
    text = typed.with_outputs(page, folder, programs)
    shown = re.findall(r"```text output[^\n]*\n(.*?)```", text, re.S)
    assert shown == ["three\n", "two\nthree\n", "one\ntwo\nthree\n"]
    assert re.search(r"^\*What appears was made on \d{4}-\d\d-\d\d with glucoloop", text, re.M)
    assert typed.with_outputs(page_of(tmp_path, text), folder, programs) == text


def test_a_command_that_fails_is_told(typed, tmp_path):
    typed.write_programs(tmp_path)
    with pytest.raises(SystemExit, match="leaves with 3"):
        typed.shell("python -c 'raise SystemExit(3)'\n", tmp_path, tmp_path)


def test_every_page_has_been_typed(typed):
    assert len(typed.PAGES) > 10
    for page in typed.PAGES:
        text = page.read_text(encoding="utf-8")
        blocks = [found["told"] for found in typed.BLOCK.finditer(text)]
        if any(typed.OUTPUT.fullmatch(told) for told in blocks):
            assert typed.LAST_LINE.search(text)[0].startswith("*What appears was made on 20"), page.name
