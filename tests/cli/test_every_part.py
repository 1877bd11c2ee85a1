"""Every part of every kind: text, table, JSON and Python are one thing, and each is described and refused alike."""

import json

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from glucoloop.component.catalogue import catalogues
from glucoloop.component.grammar import part_text
from glucoloop.component.listing import described, listing
from glucoloop.refusal import Refusal
from glucoloop.situations.toml import read_toml, toml_text

KINDS = catalogues()
EVERY = [(kind, name) for kind, catalogue in KINDS.items() for name in catalogue]
of_every_part = pytest.mark.parametrize(("kind", "name"), EVERY, ids=" ".join)
PLAIN = (int, float, bool, str)


def values_of(setting):
    """Possible values of a setting, as a strategy; None where there is none to be sure of."""
    about = setting.about
    if setting.many or setting.kind not in PLAIN:
        return None
    if setting.choices:
        return st.sampled_from(setting.choices)
    if setting.kind is bool:
        return st.booleans()
    if setting.kind is str:
        return st.text(st.characters(exclude_categories=["C"], exclude_characters="'"), min_size=1).filter(
            lambda text: text == text.strip()
        )
    least, most = max(about.at_least, about.above, -1e30), min(about.at_most, about.below, 1e30)
    if setting.kind is int:
        return st.integers(int(max(least, -(2**53))), int(min(most, 2**53))).filter(about.allows)
    return st.floats(least, most).filter(about.allows)


def given_to(part):
    """Settings of a part, some of which are given."""
    found = {name: values_of(setting) for name, setting in part.settings().items()}
    return st.fixed_dictionaries({}, optional={name: of for name, of in found.items() if of is not None})


@pytest.mark.long
@of_every_part
@settings(max_examples=25)  # of each of fifty parts
@given(data=st.data())
def test_text_table_json_and_toml_of_a_part_are_read_as_the_same_part(kind, name, data):
    catalogue = KINDS[kind]
    part = catalogue[name].partial(data.draw(given_to(catalogue[name])))
    tree = part.tree()
    text = part_text(tree)
    written = read_toml(toml_text({"part": tree}, ""), "a.toml").keys["part"]
    for again in (
        catalogue.parse(text),
        catalogue.parse(text, "--option"),
        catalogue.read(tree),
        catalogue.read(json.loads(json.dumps(tree))),
        catalogue.read(written),
    ):
        assert again == part
        assert again.given == part.given
        assert again.tree() == tree


@of_every_part
def test_text_of_a_part_with_every_setting_is_read_as_the_same_part(kind, name):
    part = KINDS[kind][name].partial({}).completed()
    again = KINDS[kind].parse(part.text)
    assert again.completed() == part
    assert set(again.given) == {key for key, value in part.values().items() if value is not None}
    assert part.given == {}
    assert part.tree() == {"name": name}


@of_every_part
def test_a_part_is_described_with_each_of_its_settings(kind, name):
    text = listing([described(KINDS[kind].find(name))], 100)
    assert text.startswith(f"{kind} {name}: ")
    assert max(map(len, text.splitlines())) <= 100
    for setting in KINDS[kind][name].settings():
        assert f"\n  {setting}" in text


@of_every_part
def test_an_unknown_setting_is_refused_by_option_and_part(kind, name):
    with pytest.raises(Refusal) as refused:
        KINDS[kind].parse(f"{name}, wobble=1", f"--{kind}")
    assert str(refused.value).startswith(f"--{kind}: the {kind} {name} has no setting 'wobble'; ")


WRONG = [
    (kind, name, setting.name, value)
    for kind, name in EVERY
    for setting in KINDS[kind][name].settings().values()
    if setting.kind in (int, float, bool) or setting.choices
    for value in ("wobble", setting.about.at_most * 2, setting.about.at_least - 1, setting.about.above - 1)
    if isinstance(value, str) or abs(value) < 1e9
]


@pytest.mark.parametrize(("kind", "name", "setting", "value"), WRONG, ids=lambda of: str(of))
def test_a_wrong_type_and_a_value_out_of_bounds_are_refused_by_option_part_and_setting(kind, name, setting, value):
    declared = KINDS[kind][name].setting(setting)
    if not isinstance(value, str) and declared.about.allows(value):
        pytest.skip("the value is within the other bound")
    typed = value if isinstance(value, str) or declared.kind is not int else round(value)
    with pytest.raises(Refusal) as refused:
        KINDS[kind].parse(f"{name}, {setting}={typed}", f"--{kind}")
    assert str(refused.value).startswith(f"--{kind}: {name}: {setting} is ")
    assert "; give " in str(refused.value)
    with pytest.raises(Refusal) as refused:
        KINDS[kind].read({"name": name, setting: "wobble" if isinstance(value, str) else typed})
    assert str(refused.value).startswith(f"{name}: {setting} is ")
    with pytest.raises((Refusal, TypeError), match=setting):
        KINDS[kind][name](**{setting: value})
