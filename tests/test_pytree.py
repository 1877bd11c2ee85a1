"""Records that JAX traces: the class belongs to the structure, so that no program of one class runs for another."""

import jax
import pytest

from glucoloop._pytree import pytree, static


def made(number, sort):
    @pytree
    class Record:
        x: float
        name: str = static(default="")

        def value(self):
            return self.x * 0.0 + number

    return Record(x=1.0, name=sort)


def test_structures_of_two_classes_with_the_same_fields_differ():
    assert jax.tree.structure(made(1, "a")) != jax.tree.structure(made(1, "a"))


@pytest.mark.long
def test_a_compiled_function_takes_no_class_for_another():
    value = jax.jit(lambda record: record.value())
    records = [made(number, "a") for number in range(60)]  # with jaxlib's own dataclasses a tenth is confused
    assert [float(value(record)) for record in records] == list(range(60))


def test_another_static_field_is_another_structure_and_numbers_are_not():
    record = made(1, "a")
    assert jax.tree.structure(record) == jax.tree.structure(type(record)(x=2.0, name="a"))
    assert jax.tree.structure(record) != jax.tree.structure(type(record)(x=1.0, name="b"))


def test_paths_name_the_fields():
    ((path, _),) = jax.tree_util.tree_leaves_with_path(made(1, "a"))
    assert jax.tree_util.keystr(path) == ".x"


def test_trees_of_two_classes_are_not_mapped_together():
    with pytest.raises(ValueError, match="Record"):
        jax.tree.map(lambda a, b: a, made(1, "a"), made(1, "a"))
