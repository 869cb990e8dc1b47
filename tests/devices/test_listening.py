import threading

import pytest

from labrun.devices import DeviceError, Listener, SampleBuffer


def test_a_listener_hears_until_it_is_stopped():
    heard = threading.Event()
    listener = Listener("ear", lambda: (heard.set(), None)[1])
    listener.start()
    assert heard.wait(5)
    assert listener.running
    listener.stop()
    assert not listener.running
    listener.check()


def test_what_the_thread_met_is_raised_in_the_thread_that_asks():
    def receive():
        raise DeviceError("ear", "was unplugged")

    listener = Listener("ear", receive)
    listener.start()
    listener._thread.join(5)
    with pytest.raises(DeviceError, match="device ear: was unplugged"):
        listener.check()


def test_a_new_start_forgets_the_failure_before_it():
    failing = [True]
    heard = threading.Event()

    def receive():
        if failing[0]:
            raise OSError("gone")
        heard.set()

    listener = Listener("ear", receive)
    listener.start()
    listener._thread.join(5)
    failing[0] = False
    listener.start()
    assert heard.wait(5)
    listener.check()
    listener.stop()


def test_what_breaks_because_the_port_was_closed_under_the_thread_is_no_failure():
    closed = threading.Event()

    def receive():
        closed.wait(5)
        raise OSError("bad file descriptor")

    listener = Listener("ear", receive)
    listener.start()
    listener._ending.set()
    closed.set()
    listener.stop()
    listener.check()


def test_a_thread_that_hangs_when_it_is_stopped_does_not_keep_the_next_one_from_hearing():
    let_go, again = threading.Event(), threading.Event()
    heard_by = []

    def receive():
        heard_by.append(threading.current_thread())
        if len(heard_by) == 1:
            let_go.wait(10)
            raise OSError("too late to matter")
        again.set()

    listener = Listener("ear", receive)
    listener.start()
    while not heard_by:
        pass
    listener.stop(patience_s=0.01)
    listener.start()
    assert again.wait(5)
    let_go.set()
    heard_by[0].join(5)
    assert listener.running
    listener.check()
    listener.stop()


def test_what_was_heard_before_a_failure_is_handed_over_before_the_failure_is_told():
    buffer = SampleBuffer(1)

    def receive():
        buffer.put(1.0, 1.0, [5.0])
        raise DeviceError("ear", "was unplugged")

    listener = Listener("ear", receive)
    listener.start()
    listener._thread.join(5)
    assert listener.deliver(buffer).values.tolist() == [[5.0]]
    with pytest.raises(DeviceError, match="was unplugged"):
        listener.deliver(buffer)
