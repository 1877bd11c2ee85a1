import re

from hypothesis import given, settings
from hypothesis import strategies as st

from glucoloop.native.targets.c.compact.memory import Array, mark, placed
from glucoloop.native.targets.c.compact.values import View

LINES = 8
a_life = st.tuples(st.integers(1, 4), st.integers(0, LINES - 1), st.integers(0, LINES - 1))


def places_of(lives):
    """Place of each array of the given sizes, first and last lines, and the size of the workspace."""
    uses = [[] for _ in range(LINES)]
    for number, (_, first, last) in enumerate(lives):
        for line in {first, last}:
            uses[line].append(f"{number}:w[{mark(number, 0)}]")
    arrays = [Array(number, "real", size) for number, (size, _, _) in enumerate(lives)]
    lines, total = placed([" ".join(line) for line in uses], arrays)
    return {int(n): int(at) for line in lines for n, at in re.findall(r"(\d+):w\[(\d+)\]", line)}, total["real"]


def test_arrays_share_places_only_while_they_do_not_need_them():
    def w(number, element=0):
        return f"w[{mark(number, element)}]"

    lines = [
        f"{w(0)} = 1.0;",
        f"{w(1)} = {w(0)};",  # the first is done with
        f"{w(2)} = {w(1)};",
        "for (int32_t i1 = 0; i1 < 3; i1++)",
        "{",
        f"{w(3)} = {w(2)};",  # read in every round: kept for the whole loop
        f"{w(4)} = {w(3)};",
        "}",
        f"d = {w(4)};",
    ]
    arrays = [Array(i, "real", 2) for i in range(5)]
    told, room = placed(lines, arrays)
    place = [int(told[i].split("[")[1].split("]")[0]) for i in (0, 1, 2, 5, 6)]
    assert place[0] != place[1]
    assert place[1] != place[2]
    assert place[0] == place[2]  # shared
    assert len({place[2], place[3], place[4]}) == 3
    assert room == {"real": 6}


def test_another_order_is_tried_where_the_largest_first_leave_a_gap():
    lives = [(3, 3, 6), (3, 0, 3), (2, 1, 4), (2, 2, 2), (4, 5, 5)]
    assert places_of(lives)[1] == 8  # of which all are needed in the fourth line; 9 with the largest first


@settings(deadline=None, max_examples=50)
@given(st.lists(a_life, min_size=1, max_size=8))
def test_no_array_overwrites_another_that_is_still_needed(given_lives):
    lives = [(size, *sorted(ends)) for size, *ends in given_lives]
    place, total = places_of(lives)
    for number, (size, first, last) in enumerate(lives):
        assert place[number] + size <= total
        for other in range(number):
            other_size, other_first, other_last = lives[other]
            if other_first <= last and other_last >= first:
                assert place[other] + other_size <= place[number] or place[number] + size <= place[other]


def test_no_index_is_multiplied_by_one():
    last_row_first = View("w", "real", (3, 2), (2, 1), number=0).reversed(0).reversed(1)
    assert re.sub("§.*§", "5", last_row_first.element(["i1", "i2"])) == "w[-2 * i1 - i2 + 5]"
