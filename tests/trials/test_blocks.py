"""People in blocks of one size."""

import threading

import numpy as np
import pytest

from glucoloop.trials.people import in_blocks


@pytest.mark.parametrize("threads", [1, 3])
def test_each_block_is_told_in_this_thread_and_in_order(threads):
    told = []

    def run(block, number):
        assert block.size == 4
        return block[:number].sum()

    def done(number):
        assert threading.current_thread() is threading.main_thread()
        told.append(number)

    assert in_blocks(run, np.arange(10), 4, threads, done=done) == [6, 22, 17]
    assert told == [4, 4, 2]
