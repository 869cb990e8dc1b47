"""Work whose results nobody wants any more ends soon."""

import gc
import signal
import threading
import weakref
from collections.abc import Iterator

import pytest

from labrun.fit.simulations import stop_if_told, workers


def endless(event: threading.Event) -> None:
    event.set()
    while True:
        stop_if_told()


@pytest.fixture
def interruptible() -> Iterator[None]:
    """Let Ctrl-C interrupt, also in a process of a test run that ignores it."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)


@pytest.mark.usefixtures("interruptible")
def test_ctrl_c_ends_work_that_would_never_end() -> None:
    def work(number: int) -> None:
        event = threading.Event()
        if number == 0:
            signal.pthread_kill(threading.main_thread().ident, signal.SIGINT)
        endless(event)

    with pytest.raises(KeyboardInterrupt), workers(2) as each:
        each(work, range(8))
    left = [thread for thread in threading.enumerate() if thread.name.startswith("ThreadPoolExecutor")]
    for thread in left:  # a thread that was being started at that moment is nobody's, and ends by itself
        thread.join(30.0)
    assert not any(thread.is_alive() for thread in left)


def test_an_error_of_one_item_ends_the_others() -> None:
    event = threading.Event()

    def work(number: int) -> None:
        if number == 1:
            endless(event)
        event.wait()
        raise ValueError("no")

    with pytest.raises(ValueError, match="no"), workers(2) as each:
        each(work, range(8))


def test_results_come_in_their_order_whatever_the_number_of_workers() -> None:
    for count in (1, 3):
        with workers(count) as each:
            assert each(lambda item: item**2, range(20)) == [item**2 for item in range(20)]


def test_the_main_thread_is_never_told_to_stop() -> None:
    stop_if_told()


def test_work_inside_of_work_is_done_without_waiting_for_another_thread() -> None:
    """As many waiting as there are threads would wait for ever."""
    with workers(2) as each:
        sums = each(lambda start: sum(each(lambda step: start + step, range(10))), range(4))
    assert sums == [45, 55, 65, 75]


def test_what_keeps_the_map_may_use_it_when_the_threads_have_ended() -> None:
    with workers(2) as each:
        pass
    assert each(abs, [-1, 2]) == [1, 2]


def test_what_inner_work_gave_is_let_go_while_the_outer_work_goes_on() -> None:
    """Threads that are busy leave what was queued for them where it is: it must hold no results."""

    class Large:
        pass

    kept = list[weakref.ref[Large]]()

    def inner(_: int) -> Large:
        made = Large()
        kept.append(weakref.ref(made))
        return made

    def outer(_: int) -> int:
        for _ in range(20):
            each(inner, range(4))
        gc.collect()
        return sum(reference() is not None for reference in tuple(kept))

    with workers(2) as each:
        alive = each(outer, range(6))
    assert max(alive) <= 8  # those of the call that another thread is in


def test_who_joins_in_is_told_what_the_outer_work_is_told() -> None:
    joined = threading.Event()

    def inner(number: int) -> None:
        if number == 0:
            joined.wait(10.0)
            raise ValueError("no")
        endless(joined)

    with pytest.raises(ValueError, match="no"), workers(3) as each:
        each(lambda _: each(inner, range(2)), range(1))
