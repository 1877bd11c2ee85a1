"""What `import glucoloop` shows."""

import glucoloop


def test_the_names_are_the_interface_and_nothing_else():
    shown = {name for name in dir(glucoloop) if not name.startswith("__")}
    assert shown == set(glucoloop.__all__)
    assert set(glucoloop._HOME) == set(glucoloop.__all__)
    for name in shown:
        assert getattr(glucoloop, name).__doc__, name
