"""Every part of every kind: text, table, JSON and Python are one thing, and each is described and refused alike."""

import json

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from glucoloop.component.catalogue import catalogues
from glucoloop.component.grammar import component_text
from glucoloop.component.listing import described, listing
from glucoloop.component.request import completed, requested
from glucoloop.refusal import Refusal
from glucoloop.situations.toml import read_toml, toml_text
from naming import naming

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
    part = requested(catalogue[name], data.draw(given_to(catalogue[name])))
    tree = part.tree()
    text = component_text(tree)
    written = read_toml(toml_text({"part": tree}, ""), "a.toml").keys["part"]
    for again in (
        catalogue.parse(text),
        catalogue.parse(text, "--option"),
        catalogue.read(tree),
        catalogue.read(json.loads(json.dumps(tree))),
        catalogue.read(written),
    ):
        assert again == part
        assert again.explicit == part.explicit
        assert again.tree() == tree


def test_text_of_a_part_with_every_setting_is_read_as_the_same_part():
    for kind, name in EVERY:
        with naming(kind, name):
            part = KINDS[kind][name]()
            again = KINDS[kind].parse(part.text)
            assert completed(again) == part
            assert set(again.explicit) == {key for key, value in part.values().items() if value is not None}
            assert part.explicit == {}
            assert part.tree() == {"name": name}


def test_a_part_is_described_with_each_of_its_settings():
    for kind, name in EVERY:
        with naming(kind, name):
            text = listing([described(KINDS[kind].find(name))], 100)
            assert text.startswith(f"{kind} {name}: ")
            assert max(map(len, text.splitlines())) <= 100
            for setting in KINDS[kind][name].settings():
                assert f"\n  {setting}" in text


def test_an_unknown_setting_is_refused_by_option_and_part():
    for kind, name in EVERY:
        with naming(kind, name), pytest.raises(Refusal) as refused:
            KINDS[kind].parse(f"{name}, wobble=1", f"--{kind}")
        assert str(refused.value).startswith(f"--{kind}: the {kind} {name} has no setting 'wobble'; ")


def wrong_values(setting):
    """A text, and the numbers beyond its bounds, that a setting has to refuse; none where any text is right."""
    about, number = setting.about, round if setting.kind is int else float
    if setting.kind not in (int, float, bool) and not setting.choices:
        return []
    beyond = (about.at_most + 1, about.at_least - 1, about.above, about.below)
    return ["wobble", *(number(value) for value in beyond if abs(value) < 1e9)]


def test_a_wrong_type_and_a_value_out_of_bounds_are_refused_by_option_part_and_setting():
    tried = 0
    for kind, name in EVERY:
        part = KINDS[kind][name]
        for setting in part.settings():
            for value in wrong_values(part.setting(setting)):
                tried += 1
                with naming(kind, name, setting, value):
                    with pytest.raises(Refusal) as refused:
                        KINDS[kind].parse(f"{name}, {setting}={value}", f"--{kind}")
                    assert str(refused.value).startswith(f"--{kind}: {name}: {setting} is ")
                    assert "; give " in str(refused.value)
                    with pytest.raises(Refusal) as refused:
                        KINDS[kind].read({"name": name, setting: value})
                    assert str(refused.value).startswith(f"{name}: {setting} is ")
                    with pytest.raises((Refusal, TypeError), match=setting):
                        part(**{setting: value})
    assert tried > 500
