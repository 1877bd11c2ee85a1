"""Every example in a docstring runs and gives what it shows."""

import doctest
import importlib
import inspect
import pkgutil
import re

import pytest

import glucoloop

# Importing it starts the program; it holds nothing but the call.
_PROGRAM = "glucoloop.__main__"
MODULES = sorted(
    {"glucoloop", *(found.name for found in pkgutil.walk_packages(glucoloop.__path__, "glucoloop."))} - {_PROGRAM}
)


def test_all_modules_are_looked_at():
    assert len(MODULES) > 60
    assert {"glucoloop.control.imc", "glucoloop.qp.two_moves", "glucoloop.reporting.figure"} <= set(MODULES)
    program = importlib.util.find_spec(_PROGRAM).loader.get_source(_PROGRAM)
    assert ">>>" not in program
    assert len(program.splitlines()) < 10


@pytest.mark.parametrize("name", MODULES)
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
