"""Numbers in texts."""

import pytest

from glucoloop.units import number_of


@pytest.mark.parametrize("text", ["1_0", "١٠", "１", "1e1_0", "x", ""])
def test_what_is_no_number(text):
    with pytest.raises(ValueError, match=r"."):
        number_of(text)
