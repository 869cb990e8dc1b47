"""Loops whose steps are compiled do what the loops in Python do."""

import math

import numpy as np
import pytest

from labrun.control.compiled.law import Channels, law_of, straight_gait, wiring_of
from labrun.control.compiled.stepping import CLAMPED, GOOD, LOST_ORIENTATION, NOT_FINITE, SAMPLES, take_step
from labrun.control.feedbacks import LatestFeedback, OrientationFeedback
from labrun.control.making import OneForEach
from labrun.control.network import NetworkController
from labrun.control.pid import FeedforwardPid, PidController
from labrun.control.protocol import LoopContext, Step
from labrun.devices import Limits
from labrun.errors import SpecError
from labrun.learned import LearnedModel, Network, Scaling, SlidingAffine, to_table

pytestmark = pytest.mark.xdist_group("compiled loops")  # a loop is compiled once, by one worker

PERIOD_S = 0.001
CHANNELS = Channels(("s", "m"), {"s.a": 0, "s.b": 1, "m.u": 2, "m.v": 3})
WEIGHTS = np.array([[2.0, -1.0], [0.5, 3.0]])
UNITS = {"s.a": "N", "s.b": "N"}
NO_LIMITS = (Limits(), Limits())


def context(**changes):
    keys = {"components": ("a", "b"), "drives": {"u": "1", "v": "1"}, "rig": "bench"}
    return LoopContext(PERIOD_S, -50.0, 50.0, 0.0, **{**keys, **changes})


def wiring(gait=((1.0, 0.0, 0.0), (0.0, 1.0, 0.0)), limits=NO_LIMITS, most=math.inf, of=context):
    feedbacks = [LatestFeedback({"channel": name}, UNITS) for name in UNITS]
    return wiring_of(feedbacks, of(), CHANNELS, {}, most, np.array(gait), limits)


def network(history_s=0.0, learn=True):
    scaling = Scaling(np.array([0.1, -0.2]), np.array([1.5, 0.7]))
    one = Network((WEIGHTS,), (np.array([0.3, -0.1]),), "identity", scaling, Scaling(np.zeros(2), np.ones(2)))
    table = to_table(LearnedModel(one, {"a": "N", "b": "N"}, {"u": "1", "v": "1"}, rig="bench"))
    learning = {"learn": {"measured": {"u": "m.u", "v": "m.v"}}, "history_s": history_s} if learn else {}
    return NetworkController({"model": table, **learning}, context()), one


class Run:
    """Steps a loop by hand, with one sample of everything a step."""

    def __init__(self, law, angles=2):
        self.law, self.drives, self.angles = law, np.zeros(2), np.zeros(angles)
        self.record, self.number = np.empty(3 * 4 + 2 * 2 + 5), 0

    def step(self, latest, reference=(0.0, 0.0), missed=None, missed_s=-math.inf):
        now_s = self.number * PERIOD_S
        self.number += 1
        made_s, row = np.array([now_s, now_s]), np.array(latest, dtype=float)
        return take_step(
            self.law, now_s, PERIOD_S, np.array(reference), row, made_s,
            row if missed is None else np.array(missed, dtype=float), missed_s, self.drives, self.angles, self.record,
        )  # fmt: skip


@pytest.mark.parametrize("window", [None, 40])
def test_learning_at_every_step_is_exact_least_squares_over_the_history(window):
    controller, one = network(0.0 if window is None else window * PERIOD_S)
    run = Run(law_of(controller, context(), wiring(), CHANNELS))
    exact = SlidingAffine(one.collapsed(), window, 1e-4)
    rng = np.random.default_rng(1)
    for _ in range(300):
        inputs = rng.normal(size=2)
        outputs = inputs @ np.array([[1.0, 0.4], [-2.0, 0.9]]) + 0.01 * rng.normal(size=2)
        assert run.step([*inputs, *outputs], (0.5, -0.4)) == GOOD
        exact.add(inputs[None, :], outputs[None, :])
    wanted = exact.solved()
    assert run.law.affine.weights[:-1] == pytest.approx(wanted.weights[0], rel=1e-9)
    assert run.law.affine.weights[-1] == pytest.approx(wanted.biases[0], rel=1e-9)
    assert run.drives == pytest.approx(wanted.point((0.5, -0.4)), rel=1e-9)


def test_a_sample_is_learned_from_once():
    run = Run(law_of(network()[0], context(), wiring(), CHANNELS))
    for _ in range(5):
        run.number = 1
        run.step([1.0, 2.0, 3.0, 4.0])
    assert run.law.affine.counts[SAMPLES] == 1


def test_a_step_made_up_for_a_sample_that_came_with_a_newer_one_learns_from_that():
    drives = [3.0, 4.0]
    one, other = (Run(law_of(network()[0], context(), wiring(), CHANNELS)) for _ in range(2))
    for run in (one, other):
        run.step([0.1, 0.2, *drives])
    one.step([1.0, 2.0, *drives])
    one.step([5.0, 6.0, *drives])
    other.number = 2
    other.step([5.0, 6.0, *drives])
    other.number = 2
    other.step([5.0, 6.0, *drives], missed=[1.0, 2.0, *drives], missed_s=PERIOD_S)
    assert other.law.affine.counts[SAMPLES] == 3
    assert other.law.affine.weights == pytest.approx(one.law.affine.weights, rel=1e-12)


def test_measurements_that_are_no_numbers_teach_nothing_and_weights_stay():
    run = Run(law_of(network()[0], context(), wiring(), CHANNELS))
    run.step([1.0, 2.0, 3.0, 4.0])
    before = run.law.affine.weights.copy()
    assert run.step([1.1, 2.0, math.nan, 4.0]) == GOOD
    assert (run.law.affine.weights == before).all()


def test_without_a_ridge_weights_stay_until_the_samples_fix_them_and_are_learned_then():
    controller, one = network(0.0)
    law = law_of(controller, context(), wiring(), CHANNELS)
    run = Run(law._replace(affine=law.affine._replace(ridge=0.0)))
    assert run.step([0.0, 0.0, 3.0, 4.0]) == GOOD
    start = one.collapsed()
    assert (run.law.affine.weights[:-1] == start.weights[0]).all()
    rng = np.random.default_rng(1)
    for _ in range(20):
        inputs = rng.normal(size=2)
        run.step([*inputs, *(inputs @ np.array([[1.0, 0.4], [-2.0, 0.9]]) + (3.0, 4.0))])
    assert run.step([0.0, 0.0, 3.0, 4.0], (1.0, 1.0)) == GOOD
    assert run.drives == pytest.approx([2.0, 5.3], rel=1e-6)


@pytest.mark.parametrize("windup", ["none", "conditional", "back-calculation"])
@pytest.mark.parametrize("on", ["error", "measurement"])
def test_a_compiled_pid_is_the_pid(windup, on):
    keys = {"p": 2.0, "i": 300.0, "d": 0.01, "bias": 0.1, "anti_windup": windup, "derivative_on": on}
    of = lambda: LoopContext(PERIOD_S, -1.0, 1.0, 0.0, components=("a", "b"), drives={"u": "1", "v": "1"})  # noqa: E731
    both = OneForEach([PidController(keys, of()) for _ in range(2)])
    run = Run(law_of(both, of(), wiring(of=of), CHANNELS))
    plain = PidController(keys, of())
    rng = np.random.default_rng(2)
    drive = 0.0
    for number in range(100):
        feedback = rng.normal()
        run.step([feedback, 0.0, 0.0, 0.0], (0.4, 0.0))
        wanted = plain.update(Step(number * PERIOD_S, PERIOD_S, 0.4, feedback, drive, lambda _: 0.4))
        drive = min(max(wanted, -1.0), 1.0)
        plain.applied(drive)
        assert run.drives[0] == pytest.approx(drive, abs=1e-12)


def test_the_command_stays_within_the_joints_limits_and_the_run_can_say_so():
    limits = (Limits(angle_deg=(-10.0, 10.0)), Limits(speed_deg_s=100.0))
    law = law_of(network(learn=False)[0], context(), wiring(limits=limits), CHANNELS)
    run = Run(law)
    run.step([0.0] * 4, (20.0, 20.0))
    assert np.degrees(run.angles) == pytest.approx([10.0, 0.1])
    assert law.wiring.counts[CLAMPED] == 1


@pytest.mark.parametrize("drive", [0, 1])
def test_a_network_of_no_numbers_leaves_the_command_where_it_is_and_its_drive_can_be_named(drive):
    controller, _ = network(learn=False)
    law = law_of(controller, context(), wiring(), CHANNELS)
    law.affine.weights[0, law.affine.place[drive]] = math.nan
    run = Run(law)
    assert run.step([0.0] * 4, (1.0, 1.0)) == NOT_FINITE + drive
    assert (run.angles == 0.0).all()


def test_a_body_that_is_lost_leaves_the_command_where_it_is():
    units = {f"s.body_{part}": "1" for part in ("qw", "qx", "qy", "qz")}
    channels = Channels(("s",), {name: place for place, name in enumerate(units)})
    of = context(components=("qw", "qx", "qy", "qz"))
    feedback = OrientationFeedback({"body": "s.body"}, units)
    seen = wiring_of([feedback], of, channels, {}, math.inf, np.eye(2, 3), NO_LIMITS)
    run = Run(law_of(network(learn=False)[0], context(), seen, channels))
    for quaternion in ([0.0] * 4, [math.nan] * 4):
        assert run.step(quaternion, (1.0, 1.0, 0.0, 0.0)) == LOST_ORIENTATION
    assert run.step([-0.5, 0.5, 0.5, 0.5], (1.0, 1.0, 0.0, 0.0)) == GOOD
    assert run.record[4:8] == pytest.approx([0.5, -0.5, -0.5, -0.5])


def test_what_has_no_compiled_form_is_refused_in_words():
    with pytest.raises(SpecError, match="a gait that moves by itself, or bends"):
        straight_gait(lambda t, values: np.sin(values["u"] + t)[:, None], ["u"], (-1.0, 1.0))
    ahead = FeedforwardPid({"model": {"gain": 2.0}}, context())
    with pytest.raises(SpecError, match="network, inverse and pid have a compiled form"):
        law_of(OneForEach([ahead, ahead]), context(), wiring(), CHANNELS)
    with pytest.raises(SpecError, match="latest"):
        wiring_of([object()], context(), CHANNELS, {}, 1.0, np.eye(2, 3), NO_LIMITS)


@pytest.mark.parametrize(
    "angle",
    [
        lambda t, u: u + (t > 20.0),
        lambda t, u: u * (1.0 + (t > 20.0)),
        lambda t, u: np.clip(u, -10.0, 10.0),
    ],
)
def test_a_gait_that_moves_late_or_bends_far_out_is_not_straight(angle):
    with pytest.raises(SpecError, match="a gait that moves by itself, or bends"):
        straight_gait(lambda t, v: angle(t, v["u"])[:, None], ["u"], (-60.0, 60.0))


def test_a_straight_gait_is_its_slopes_and_its_constant():
    found = straight_gait(
        lambda t, v: np.column_stack([0.1 + 2.0 * v["u"], v["v"] - v["u"]]), ["u", "v"], (-60.0, 60.0)
    )
    assert found == pytest.approx(np.array([[2.0, 0.0, 0.1], [-1.0, 1.0, 0.0]]))
