"""One name has one meaning: no two modules define a class of the same name."""

import ast
from collections import defaultdict
from pathlib import Path

PACKAGE = Path(__file__).parents[1] / "src" / "glucoloop"


def test_a_class_is_defined_once():
    """Names that begin with an underscore are used in their own module alone."""
    homes = defaultdict(list)
    for path in PACKAGE.rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.ClassDef) and not node.name.startswith("_"):
                homes[node.name].append(str(path.relative_to(PACKAGE)))
    twice = {name: sorted(modules) for name, modules in homes.items() if len(modules) > 1}
    assert len(homes) > 100
    assert not twice
