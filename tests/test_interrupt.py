import os
import signal
import threading

import pytest

from morphofold.sim.run import deferred_interrupt

pytestmark = pytest.mark.usefixtures("usual_signals")


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_is_held_until_the_work_can_stop(number):
    before = signal.getsignal(number)
    done = []
    with pytest.raises(KeyboardInterrupt), deferred_interrupt() as interrupted:
        assert not interrupted()
        os.kill(os.getpid(), number)
        assert interrupted()
        done.append("went on")  # the work that follows the signal
    assert done == ["went on"]
    assert signal.getsignal(number) is before


def test_a_second_signal_acts_at_once():
    with pytest.raises(KeyboardInterrupt), deferred_interrupt():
        os.kill(os.getpid(), signal.SIGINT)
        os.kill(os.getpid(), signal.SIGINT)
        pytest.fail("still running")


def test_without_a_signal_nothing_happens_and_other_threads_hold_none():
    answers = []

    def work():
        with deferred_interrupt() as interrupted:
            answers.append(interrupted())

    work()
    thread = threading.Thread(target=work)
    thread.start()
    thread.join()
    assert answers == [False, False]
