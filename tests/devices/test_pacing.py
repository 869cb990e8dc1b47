import threading

import numpy as np
import pytest

from labrun.devices import CommandStream, Trajectory
from labrun.runner import RealClock

CLOCK = RealClock()


def ramp(duration_s=0.3):
    return Trajectory(("a",), np.array([0.0, duration_s]), np.array([[0.0], [1.0]]))


def wait_until(true, within_s=5.0):
    deadline_s = CLOCK.now() + within_s
    while not true() and CLOCK.now() < deadline_s:
        CLOCK.sleep(0.002)
    assert true()


class Wire:
    def __init__(self):
        self.sent = []

    def __call__(self, angles):
        self.sent.append((CLOCK.now(), float(angles[0])))


@pytest.fixture
def wire():
    return Wire()


@pytest.fixture
def stream(wire):
    stream = CommandStream(CLOCK, 100.0, wire)
    yield stream
    stream.end()


def test_set_points_lie_on_the_trajectory_from_its_first_to_its_last_point(stream, wire):
    start_s = CLOCK.now() + 0.02
    stream.follow(ramp(), start_s)
    wait_until(lambda: wire.sent and wire.sent[-1][1] == 1.0)
    assert wire.sent[0][1] == pytest.approx(0.0, abs=0.2)
    for sent_s, angle in wire.sent:
        # a set-point is never sent early, and says where the joint should be at the moment it was due
        assert angle <= (sent_s - start_s) / 0.3 + 1e-6


def test_a_stream_counts_what_it_sent_and_what_it_had_to_skip(stream, wire):
    stream.follow(ramp(), CLOCK.now())
    wait_until(lambda: wire.sent and wire.sent[-1][1] == 1.0)
    timing = stream.timing
    assert timing.sent == len(wire.sent)
    assert timing.sent + timing.missed == 31
    assert 0 <= timing.late_median_s <= timing.late_p99_s <= timing.late_worst_s


def test_timing_is_told_since_its_restart_however_many_motions_there_were(stream, wire):
    stream.follow(ramp(10.0), CLOCK.now())
    wait_until(lambda: len(wire.sent) > 3)
    stream.follow(ramp(0.05), CLOCK.now())
    wait_until(lambda: wire.sent[-1][1] == 1.0)
    CLOCK.sleep(0.03)
    assert stream.timing.sent == len(wire.sent)
    stream.restart_timing()
    assert stream.timing.sent == 0


def test_after_the_last_set_point_nothing_more_is_sent_but_the_watchdog_is_fed():
    wire, fed = Wire(), []
    stream = CommandStream(CLOCK, 100.0, wire, idle=lambda: fed.append(CLOCK.now()), idle_every_s=0.01)
    stream.follow(ramp(0.05), CLOCK.now())
    wait_until(lambda: wire.sent and wire.sent[-1][1] == 1.0)
    count, fed_before = len(wire.sent), len(fed)
    wait_until(lambda: len(fed) >= fed_before + 5)
    assert len(wire.sent) == count
    stream.end()


def test_a_motion_that_begins_later_feeds_the_watchdog_meanwhile():
    wire, fed = Wire(), []
    stream = CommandStream(CLOCK, 100.0, wire, idle=lambda: fed.append(CLOCK.now()), idle_every_s=0.01)
    stream.follow(ramp(), CLOCK.now() + 0.2)
    wait_until(lambda: wire.sent)
    assert len(fed) >= 3
    stream.end()


def test_a_halt_ends_the_motion_at_once(stream, wire):
    stream.follow(ramp(10.0), CLOCK.now())
    wait_until(lambda: len(wire.sent) > 3)
    stream.halt()
    halted_s = CLOCK.now()
    CLOCK.sleep(0.1)
    assert all(sent_s <= halted_s + 0.02 for sent_s, _ in wire.sent)


def test_a_halt_works_while_a_set_point_hangs_on_the_wire():
    hanging, go = threading.Event(), threading.Event()

    def send(_angles):
        hanging.set()
        go.wait(5)

    stream = CommandStream(CLOCK, 100.0, send)
    stream.follow(ramp(10.0), CLOCK.now())
    assert hanging.wait(5)
    stream.halt()
    go.set()
    sent = stream.timing.sent
    stream.end()
    assert sent <= 1


def test_a_new_motion_takes_the_place_of_the_one_before(stream, wire):
    stream.follow(ramp(10.0), CLOCK.now())
    wait_until(lambda: len(wire.sent) > 3)
    hold = Trajectory(("a",), np.zeros(1), np.array([[-5.0]]))
    stream.follow(hold, CLOCK.now())
    wait_until(lambda: wire.sent[-1][1] == -5.0)
    CLOCK.sleep(0.05)
    assert wire.sent[-1][1] == -5.0
    assert stream.set_point().tolist() == [-5.0]


def test_what_the_wire_raises_is_raised_where_the_stream_is_asked():
    def send(_angles):
        raise OSError("unplugged")

    stream = CommandStream(CLOCK, 100.0, send)
    stream.follow(ramp(), CLOCK.now())
    wait_until(lambda: not stream.running)
    with pytest.raises(OSError, match="unplugged"):
        stream.check()


def test_set_points_of_a_slow_wire_are_skipped_rather_than_sent_late_for_ever():
    sent = []

    def send(angles):
        CLOCK.sleep(0.05)
        sent.append(float(angles[0]))

    stream = CommandStream(CLOCK, 100.0, send)
    stream.follow(ramp(0.5), CLOCK.now())
    wait_until(lambda: sent and sent[-1] == 1.0)
    timing = stream.timing
    stream.end()
    assert timing.missed > 20
    assert timing.sent + timing.missed == 51


def test_a_set_point_whose_time_is_over_before_it_leaves_gives_way_to_the_one_that_is_due(stream, wire):
    class Paused(Trajectory):
        """A computer that is busy elsewhere once, while a set-point is being made."""

        asked = 0

        def at(self, time_s):
            Paused.asked += 1
            if Paused.asked == 1:
                CLOCK.sleep(0.05)
            return super().at(time_s)

    motion = ramp()
    stream.follow(Paused(motion.joints, motion.time_s, motion.angle_rad), CLOCK.now())
    wait_until(lambda: wire.sent and wire.sent[-1][1] == 1.0)
    assert wire.sent[0][1] >= 0.04 / 0.3
    assert stream.timing.sent + stream.timing.missed == 31
