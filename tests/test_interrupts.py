"""Signals ask to stop: once or often, at any moment, with one end."""

import os
import signal
import threading

import pytest
from hypothesis import given
from hypothesis import strategies as st

from labrun.interrupts import SIGNALS, Interrupted, StopSignal, handled, installed

ANY = st.sampled_from(SIGNALS)


def send(number: int) -> None:
    os.kill(os.getpid(), number)


@given(number=ANY, later=st.lists(ANY, max_size=5))
def test_the_first_signal_is_raised_and_later_ones_change_nothing(number, later):
    with handled():
        with pytest.raises(StopSignal) as raised:
            send(number)
        for other in later:
            send(other)
    assert raised.value.number == number


@given(number=ANY, later=st.lists(ANY, max_size=5))
def test_a_held_signal_stops_the_actuators_at_once_and_is_seen_at_the_next_look(number, later):
    stops = []
    with handled() as interrupts, interrupts.held(lambda: stops.append("stop")):
        for other in (number, *later):
            send(other)
        assert stops
        with pytest.raises(Interrupted, match="actuators are stopped, data is kept") as asked:
            interrupts.check()
    assert asked.value.exit_code == 128 + number


def test_a_flood_of_signals_during_the_stop_neither_nests_nor_raises():
    depth = []

    def stop() -> None:
        depth.append(1)
        for _ in range(50):
            send(signal.SIGINT)
        assert len(depth) == 1

    with handled() as interrupts, interrupts.held(stop):
        send(signal.SIGTERM)
        assert interrupts.number == signal.SIGTERM


def test_a_signal_that_came_while_it_was_held_is_raised_where_it_may_be():
    with handled() as interrupts, interrupts.held():
        send(signal.SIGHUP)
        with pytest.raises(StopSignal, match="terminal was closed"), interrupts.raising():
            pytest.fail("it was to be raised at once")


def test_a_signal_that_compiled_code_dropped_is_raised_again():
    with handled() as interrupts:
        with pytest.raises(StopSignal):
            send(signal.SIGTERM)
        with pytest.raises(StopSignal) as again:
            interrupts.raise_again()
    assert again.value.number == signal.SIGTERM


def test_a_signal_that_other_code_wrapped_in_an_error_of_its_own_is_still_the_signal():
    class Field:
        def __set_name__(self, owner, name):
            send(signal.SIGINT)

    with handled() as interrupts, pytest.raises(StopSignal), interrupts.raising():
        type("Table", (), {"field": Field()})


def test_handlers_are_put_back_and_inner_blocks_go_on_with_the_outer_one():
    before = [signal.getsignal(number) for number in SIGNALS]
    with handled() as outer:
        with handled() as inner:
            assert inner is outer
        assert installed() is outer
    assert [signal.getsignal(number) for number in SIGNALS] == before


def test_a_terminal_that_may_close_under_nohup_ends_nothing():
    before = signal.signal(signal.SIGHUP, signal.SIG_IGN)
    try:
        with handled():
            send(signal.SIGHUP)
    finally:
        signal.signal(signal.SIGHUP, before)


def test_another_thread_than_the_main_one_installs_nothing():
    numbers = []

    def look() -> None:
        with handled() as interrupts:
            numbers.append(interrupts.number)

    thread = threading.Thread(target=look)
    thread.start()
    thread.join()
    assert numbers == [None]
