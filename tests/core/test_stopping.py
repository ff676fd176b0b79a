"""Stopping where it suits: asked once, a block ends where it looks; asked twice, at once."""

from __future__ import annotations

import os
import signal
from threading import Event

import pytest

from kncal.core.stopping import check_stop, stop_where_it_suits, stoppable


def test_a_first_signal_only_asks_and_a_second_interrupts() -> None:
    before = signal.getsignal(signal.SIGINT)
    with pytest.raises(KeyboardInterrupt), stop_where_it_suits() as stop:
        assert not stop()
        os.kill(os.getpid(), signal.SIGINT)
        assert stop()
        os.kill(os.getpid(), signal.SIGINT)
        pytest.fail("the second Ctrl-C did not interrupt")
    assert signal.getsignal(signal.SIGINT) is before
    with pytest.raises(KeyboardInterrupt):
        os.kill(os.getpid(), signal.SIGINT)


def test_what_stops_a_thread_is_only_told_inside() -> None:
    event = Event()
    with stoppable(event):
        with stop_where_it_suits() as stop:
            event.set()
            check_stop()
            assert stop()
        with pytest.raises(KeyboardInterrupt):
            check_stop()


def test_an_ignored_signal_stays_ignored() -> None:
    before = signal.signal(signal.SIGHUP, signal.SIG_IGN)
    try:
        with stop_where_it_suits() as stop:
            os.kill(os.getpid(), signal.SIGHUP)
            assert not stop()
    finally:
        signal.signal(signal.SIGHUP, before)


def test_a_signal_after_the_last_look_is_not_forgotten() -> None:
    with pytest.raises(KeyboardInterrupt), stop_where_it_suits():
        os.kill(os.getpid(), signal.SIGINT)
