"""Modules packed into the script of a page."""

from pathlib import Path

import pytest

from glucoloop.pages import PAGES, _as_function, page_script


def test_every_module_is_in_the_script_of_a_page():
    script = page_script()
    for path in PAGES.glob("*.mjs"):
        assert script.count(f'"{path.stem}": () => {{') == 1
    assert script.endswith('need("page").start();\n')


def test_a_comment_with_lines_of_its_own_is_left_out():
    code = '// a\n/** b\n * c */\nconst url = "data://x"; // d\nconst e = /** @type {any} */ (url);\n'
    kept = 'const url = "data://x"; // d\nconst e = /** @type {any} */ (url);\n'
    assert _as_function(code, Path("own.mjs")) == f"{kept}return {{  }};"


@pytest.mark.parametrize(
    "line",
    [
        'import "./other.mjs";',
        "export default 3;",
        'import * as all from "./a.mjs";',
        'import { a as b } from "./a.mjs";',
    ],
)
def test_an_import_or_export_of_another_form_is_refused(line):
    with pytest.raises(ValueError, match=r"^own\.mjs has .*; name what is imported or exported$"):
        _as_function(f"const a = 1;\n{line}\n", Path("own.mjs"))
