"""Work is ended by Ctrl-C and by a time limit, whether it listens or not."""

import os
import signal
import threading
import time

import pytest

from glucoloop.storage.trials.query import UNSTOPPED, has_unstopped_work, stoppable


class Work:
    """Waits until it is told to go on; a deaf one does not hear that it should stop."""

    def __init__(self, deaf):
        self.goes_on, self.begun, self.asked, self.deaf = threading.Event(), threading.Event(), 0, deaf

    def __call__(self):
        self.begun.set()
        self.goes_on.wait(60)

    def stop(self):
        self.asked += 1
        if not self.deaf:
            self.goes_on.set()


@pytest.fixture(params=[False, True], ids=["listens", "deaf"])
def work(request):
    work = Work(request.param)
    yield work
    work.goes_on.set()
    for thread in threading.enumerate():
        if thread.name == UNSTOPPED:
            thread.join(60)
    assert not has_unstopped_work()


def test_answers_and_errors_are_those_of_the_work():
    assert stoppable(lambda: 3, lambda: None) == 3
    with pytest.raises(ZeroDivisionError):
        stoppable(lambda: 1 // 0, lambda: None)


@pytest.mark.parametrize("seconds", [0.05, -1.0])
def test_time_limit_ends_the_work(work, seconds):
    with pytest.raises(TimeoutError):
        stoppable(work, work.stop, time.monotonic() + seconds)
    assert work.asked
    assert has_unstopped_work() == work.deaf


@pytest.fixture
def _ctrl_c():
    """Ctrl-C raises, whatever a program that ran before in this process made of it."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)


@pytest.mark.usefixtures("_ctrl_c")
def test_interrupt_ends_the_work(work):
    def press():
        work.begun.wait(60)
        os.kill(os.getpid(), signal.SIGINT)

    presses = threading.Thread(target=press)
    presses.start()
    with pytest.raises(KeyboardInterrupt):
        stoppable(work, work.stop)
    presses.join()
    assert work.asked
    assert has_unstopped_work() == work.deaf
