"""The drawing of the layers says what the imports are."""

import re
from pathlib import Path

import pytest

SOURCE = Path(__file__).resolve().parents[2] / "src/glucoloop"


@pytest.fixture
def house(docs_module):
    return docs_module("house")


def package(folder: Path, files: dict[str, str]) -> Path:
    for name, text in files.items():
        path = folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text)
    return folder


def test_imports_of_every_form_are_read(house, tmp_path):
    root = package(
        tmp_path,
        {
            "low.py": "import numpy\n",
            "mid/__init__.py": "from ..low import x\n",
            "mid/deep.py": "from glucoloop import low\nfrom glucoloop.mid import y\n",
            "top.py": "def f():\n    import glucoloop.mid.deep\n    from glucoloop.low import x\n",
            "_hidden.py": "import glucoloop.top\n",
        },
    )
    of = house.imports(root)
    assert of == {"low": set(), "mid": {"low"}, "top": {"mid", "low"}}
    assert house.floors(of) == [["low"], ["mid"], ["top"]]
    assert house.direct(of) == [("mid", "low"), ("top", "mid")]


def test_layers_in_a_ring_are_refused(house):
    with pytest.raises(ValueError, match="ring: a, b"):
        house.floors({"a": {"b"}, "b": {"a"}, "c": set()})


def test_every_layer_is_drawn_above_what_it_imports(house):
    of = house.imports(SOURCE)
    at, height = house.placed(of)
    assert all(at[layer][1] < at[name][1] < height for layer in of for name in of[layer])
    drawn = house.drawing(of)
    assert set(re.findall(r"<text[^>]*>(\w+)<", drawn)) == set(of)
    assert len(re.findall("<path ", drawn)) == len(house.direct(of))
