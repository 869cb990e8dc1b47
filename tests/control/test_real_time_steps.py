"""Steps in real time: when one is taken, which sample it sees, and what ends the loop."""

import math
import threading
import time

import numpy as np
import pytest

from labrun.compiled import native
from labrun.control.compiled.law import Channels, law_of, wiring_of
from labrun.control.compiled.real_time import MORE, WATCHED_NS, LiveBench, await_step, run_steps
from labrun.control.compiled.stepping import FULL, GOOD, UNWATCHED
from labrun.control.feedbacks import LatestFeedback
from labrun.control.making import OneForEach
from labrun.control.network import NetworkController
from labrun.control.pid import PidController
from labrun.control.protocol import LoopContext
from labrun.devices import Limits, Samples
from labrun.devices.listening import Bell, Newest
from labrun.learned import LearnedModel, Network, Scaling, to_table

PERIOD_S = 0.2
"""So long that a busy machine takes no step for another one."""
SEEN = np.zeros(1, dtype=np.int64)


def _say_sent(t, x, u, p, force, out):
    out[0] = 0.0


SENDING = native("model", _say_sent)


class Wired:
    """A loop of one drive that goes where its one sensor says, and a wire that takes everything."""

    def __init__(self, free_s=0.0, period_s=PERIOD_S):
        self.period_s, self.bell = period_s, Bell()
        self.newest = Newest(1, self.bell)
        keys = {"components": ("a",), "drives": {"u": "1"}, "rig": "bench"}
        context = LoopContext(period_s, -50.0, 50.0, 0.0, **keys)
        channels = Channels(("s",), {"s.a": 0})
        feedback = LatestFeedback({"channel": "s.a"}, {"s.a": "N"})
        wiring = wiring_of([feedback], context, channels, {}, math.inf, np.eye(1, 2), [Limits()])
        pid = PidController({"p": -1.0, "i": 0.0, "d": 0.0}, context)
        self.law = law_of(OneForEach([pid]), context, wiring, channels)
        view = self.newest.view
        self.bench = LiveBench(
            (view.number,), (view.made_s,), (view.heard_s,), (view.values,), np.array([0, 1]),
            self.bell.file, SENDING.address, np.array([0.0, 0.0, free_s]), np.zeros(1),
        )  # fmt: skip

    def sample(self, *values):
        now = time.monotonic() - 1e-6 * np.arange(len(values))[::-1]
        self.newest.put(Samples(now, now, np.array(values)[:, None]))

    def wait(self, due_in_s=PERIOD_S, number=5, before_s=-math.inf, owed_until_s=-math.inf):
        """Return how long before the step was due it is taken; not above 0 if it was not taken sooner."""
        due_s = time.monotonic() + due_in_s
        start_s = due_s - number * self.period_s
        rest = (start_s, self.period_s, number, before_s, owed_until_s)
        return due_s - await_step(self.law, self.bench, SEEN, *rest)

    def run(self, steps, watched_for_s, rows=64, references=None, later=()):
        shared = np.zeros(5, dtype=np.int64)
        ring = np.empty((rows, MORE + 1 + 3 + 2 + 5))
        for count in (0, steps):  # the first one compiles
            for in_s, values in later if count else ():
                threading.Timer(in_s, self.sample, values).start()
            shared[WATCHED_NS] = time.monotonic_ns() + int(1e9 * watched_for_s)
            status = run_steps(
                self.law, self.bench, np.zeros((steps, 1)) if references is None else references,
                time.monotonic(), self.period_s, count, np.zeros(1), np.zeros(1), ring, shared,
            )  # fmt: skip
        return status, ring[: shared[0]]


@pytest.fixture(scope="module", autouse=True)
def compiled():
    Wired().wait(0.0)


def test_without_a_sample_a_step_waits_until_it_is_due():
    assert Wired().wait(0.02) <= 0.0


def test_a_sample_that_no_step_has_seen_is_not_kept_waiting():
    wired = Wired()
    wired.sample(1.0)
    assert wired.wait() > 0.0


def test_a_sample_that_comes_while_the_loop_sleeps_wakes_it():
    wired = Wired(period_s=5.0)
    threading.Timer(0.01, wired.sample, [1.0]).start()
    assert wired.wait(5.0) > 0.0


def test_a_step_is_not_taken_before_the_wire_has_room():
    free_s = time.monotonic() + 0.05
    wired = Wired(free_s)
    wired.sample(1.0)
    wired.wait()
    assert time.monotonic() >= free_s


def test_two_steps_are_a_quarter_of_a_period_apart():
    wired = Wired()
    wired.sample(1.0)
    before_s = time.monotonic()
    wired.wait(before_s=before_s)
    assert time.monotonic() >= before_s + PERIOD_S / 4


def test_a_step_comes_no_more_than_twelve_periods_early():
    wired = Wired(period_s=0.01)
    wired.sample(1.0)
    assert wired.wait(0.15) <= 0.12


def test_a_loop_far_ahead_of_its_rate_makes_up_for_no_step():
    wired, before_s = Wired(period_s=0.01), time.monotonic()
    assert wired.wait(0.12, before_s=before_s, owed_until_s=math.inf) <= 0.08


def test_a_step_that_is_owed_comes_soon_after_the_one_before():
    wired, before_s = Wired(), time.monotonic()
    early_s = wired.wait(before_s=before_s, owed_until_s=math.inf)
    assert early_s > 0.0
    assert time.monotonic() >= before_s + 0.4 * PERIOD_S


def test_a_step_that_is_owed_waits_for_the_next_sample_once_the_newest_is_old():
    before_s = time.monotonic()
    assert Wired().wait(before_s=before_s, owed_until_s=before_s + 0.3 * PERIOD_S) <= 0.0


@pytest.mark.slow
def test_of_samples_that_come_at_once_each_has_its_step_in_the_end():
    wired = Wired(period_s=0.05)
    wired.sample(0.0)
    status, records = wired.run(6, 1000.0, later=[(0.12, (1.0, 3.0))])
    assert status == GOOD
    assert records[:, MORE] == pytest.approx([0.0, 0.0, 0.0, 3.0, 3.0, 3.0])
    assert np.diff(records[:, 0])[3] == pytest.approx(0.02, abs=0.005)


@pytest.mark.slow
def test_of_samples_that_come_at_once_each_is_learned_from():
    wired = Wired(period_s=0.05)
    scaling = Scaling(np.zeros(1), np.ones(1))
    network = Network((np.eye(1),), (np.zeros(1),), "identity", scaling, scaling)
    table = to_table(LearnedModel(network, {"a": "N"}, {"u": "1"}, rig="bench"))
    context = LoopContext(0.05, -50.0, 50.0, 0.0, components=("a",), drives={"u": "1"}, rig="bench")
    learning = NetworkController(
        {"model": table, "learn": {"measured": {"u": "s.a"}}, "history_s": 0.0}, context
    )
    wired.law = law_of(learning, context, wired.law.wiring, Channels(("s",), {"s.a": 0}))
    wired.sample(0.0)
    status, records = wired.run(6, 1000.0, later=[(0.12, (1.0, 2.0, 3.0))])
    assert status == GOOD
    assert records[:, -2] == pytest.approx([1.0, 1.0, 1.0, 2.0, 3.0, 4.0])
    assert wired.law.affine.gram[1, 0] == pytest.approx(0.0 + 1.0 + 2.0 + 3.0)


@pytest.mark.slow
def test_a_step_that_is_early_follows_the_reference_of_its_time():
    wired = Wired(period_s=0.05)
    wired.sample(0.0)
    status, records = wired.run(6, 1000.0, references=np.arange(6.0)[:, None], later=[(0.12, (0.0,))])
    assert status == GOOD
    assert records[3, 0] < 0.15  # it was due then
    assert records[:, MORE + 1] == pytest.approx([0.0, 1.0, 2.0, 2.0, 4.0, 5.0])


@pytest.mark.slow
def test_the_first_step_of_a_sample_tells_how_long_it_had_been_there():
    wired = Wired(period_s=0.002)
    wired.sample(3.0)
    status, records = wired.run(3, 1000.0)
    assert status == GOOD
    assert np.isfinite(records[0, 2])
    assert np.isnan(records[1:, 2]).all()
    assert records[:, MORE] == pytest.approx(3.0)


@pytest.mark.slow
def test_a_loop_that_nobody_looks_after_ends():
    wired = Wired(period_s=0.002)
    wired.sample(3.0)
    status, records = wired.run(1000, 0.0)
    assert status == UNWATCHED
    assert len(records) > 0


@pytest.mark.slow
def test_a_loop_whose_records_nobody_takes_ends():
    wired = Wired(period_s=0.002)
    wired.sample(3.0)
    assert wired.run(1000, 1000.0, rows=8)[0] == FULL
