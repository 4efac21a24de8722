"""Requests to stop wait for the work, and the third one does not."""

from __future__ import annotations

import os
import signal
import threading

import pytest
from command_line import run_python

from polarmap.interrupts import SIGNALS, EndRequests, Stopped, StopRequests, raise_stopped, stopped_status, was_stopped


@pytest.fixture(autouse=True)
def handlers():
    before = {number: signal.getsignal(number) for number in SIGNALS}
    yield
    for number, handler in before.items():
        signal.signal(number, handler)


def send(number):
    os.kill(os.getpid(), number)


@pytest.mark.parametrize("number", SIGNALS)
def test_a_request_is_raised_where_the_work_says_so(number):
    raise_stopped()
    assert not was_stopped()
    done = []
    with pytest.raises(Stopped) as caught, StopRequests() as stop:
        stop.check()
        send(number)
        done.append("the frame")
        assert stop.requested
        stop.check()
    assert done == ["the frame"] and caught.value.number == number
    assert was_stopped() and stopped_status() == 128 + number


def test_a_second_request_does_not_disturb_the_end():
    raise_stopped()
    told = []
    with pytest.raises(Stopped), StopRequests(told.append) as stop:
        send(signal.SIGTERM)
        try:
            stop.check()
        finally:
            send(signal.SIGINT)
            stop.check()
            told.append("written")
    assert told == [1, 2, "written"]
    assert stopped_status() == 128 + signal.SIGTERM


def test_a_request_after_the_last_check_is_not_forgotten():
    raise_stopped()
    with pytest.raises(Stopped), StopRequests():
        send(signal.SIGINT)


def test_another_error_goes_before_the_request():
    raise_stopped()
    with pytest.raises(ValueError, match="of its own"), StopRequests():
        send(signal.SIGINT)
        raise ValueError("of its own")


def test_handlers_are_as_before():
    raise_stopped()
    before = [signal.getsignal(number) for number in SIGNALS]
    with StopRequests():
        assert [signal.getsignal(number) for number in SIGNALS] != before
    assert [signal.getsignal(number) for number in SIGNALS] == before


def test_what_is_ignored_stays_ignored():
    """As under nohup."""
    signal.signal(signal.SIGHUP, signal.SIG_IGN)
    raise_stopped()
    with StopRequests() as stop:
        send(signal.SIGHUP)
        assert not stop.requested
    assert signal.getsignal(signal.SIGHUP) is signal.SIG_IGN


def test_another_thread_may_use_it():
    problems = []

    def work():
        try:
            with StopRequests() as stop:
                stop.check()
        except BaseException as problem:
            problems.append(problem)

    thread = threading.Thread(target=work)
    thread.start()
    thread.join()
    assert not problems


def test_the_third_request_quits():
    program = (
        "import os, signal\n"
        "from polarmap.interrupts import StopRequests, raise_stopped\n"
        "raise_stopped()\n"
        "with StopRequests():\n"
        "    for i in range(5):\n"
        "        os.kill(os.getpid(), signal.SIGTERM)\n"
        "        print(i, flush=True)\n"
    )
    ended = run_python(program, timeout=60)
    assert ended.status == -signal.SIGTERM
    assert ended.out.split() == ["0", "1"]


def test_requests_to_end_are_noted_and_never_raised():
    asked = []
    with EndRequests(asked.append) as end:
        assert not end.requested
        send(signal.SIGINT)
        end.check()
        assert end.requested and asked == [1]
    assert signal.getsignal(signal.SIGINT) != end._note
