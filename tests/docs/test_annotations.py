"""Signatures of settings are shown with their types alone."""

import pytest


@pytest.fixture
def bare(docs_module):
    return docs_module("annotations").bare


@pytest.mark.parametrize(
    ("signature", "shown"),
    [
        ("(a: int = 3)", "(a: int = 3)"),
        ("(a: Annotated[float, About(summary=x, (mg/dl)², at_least=0.0)] = 1.0)", "(a: float = 1.0)"),
        (
            "(a: Annotated[dict[str, int] | None, About(x)] = None, *, b: Annotated[int, y], c: bool)",
            "(a: dict[str, int] | None = None, *, b: int, c: bool)",
        ),
        ("(a: tuple[Annotated[str, x], ...] = ())", "(a: tuple[str, ...] = ())"),
        ("(a: Annotated[int, x", "(a: Annotated[int, x"),
    ],
)
def test_what_is_said_of_a_type_is_left_out(bare, signature, shown):
    assert bare(signature) == shown
