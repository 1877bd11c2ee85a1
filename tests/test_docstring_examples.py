"""Every example in a docstring runs and gives what it shows."""

import contextlib
import doctest
import importlib
import inspect
import re
from pathlib import Path

import pytest

import glucoloop
from glucoloop.refusal import MissingExtraError
from naming import naming

ROOT = Path(glucoloop.__file__).parent
# Importing glucoloop.__main__ starts the program; it holds nothing but the call.
SOURCES = {
    ".".join(("glucoloop", *file.relative_to(ROOT).with_suffix("").parts)).removesuffix(".__init__"): file
    for file in sorted(ROOT.rglob("*.py"))
    if file.name != "__main__.py"
}
WITH_EXAMPLES = [name for name, file in SOURCES.items() if ">>> " in file.read_text(encoding="utf-8")]


def test_all_modules_are_looked_at():
    assert len(SOURCES) > 60
    assert {"glucoloop", "glucoloop.control.imc", "glucoloop.reporting.figure"} <= set(SOURCES)
    assert {"glucoloop.qp.two_moves"} <= set(WITH_EXAMPLES)
    program = (ROOT / "__main__.py").read_text(encoding="utf-8")
    assert ">>>" not in program
    assert len(program.splitlines()) < 10


def test_a_module_without_examples_can_be_imported():
    for name in SOURCES.keys() - WITH_EXAMPLES:
        with naming(name), contextlib.suppress(MissingExtraError):  # of a library of gigabytes
            importlib.import_module(name)


@pytest.mark.parametrize("name", WITH_EXAMPLES)
def test_examples(name):
    module = importlib.import_module(name)
    tests = [test for test in doctest.DocTestFinder().find(module) if test.examples]
    examples = [example for test in tests for example in test.examples]
    # Nothing is passed over: neither by an option nor because the finder does not see where it stands.
    assert not any(example.options.get(doctest.SKIP) for example in examples)
    assert len(examples) == len(re.findall(r"^\s*>>> ", inspect.getsource(module), re.MULTILINE))
    runner = doctest.DocTestRunner(optionflags=doctest.NORMALIZE_WHITESPACE)
    told = []
    for test in tests:
        runner.run(test, out=told.append)
    assert runner.summarize(verbose=False).failed == 0, "".join(told)
