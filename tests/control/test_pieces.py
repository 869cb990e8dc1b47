"""The command of a steered gait, piece by piece."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from labrun.control.closed_loop import Pieces
from labrun.experiment import GaitTable
from labrun.gaits import make_gait, steering_of

SINE = make_gait(GaitTable(plugin="sine", joints={"tail": {"amplitude_deg": "a", "frequency_hz": 1.4}}))


class Sender(Pieces):
    """Sends every piece as soon as it is made."""

    def first(self):
        piece = super().first()
        self.sent()
        return piece

    def next(self, time_s, goals):
        piece = super().next(time_s, goals)
        self.sent()
        return piece


def pieces(start=20.0, slew=None, duration_s=10.0, period_s=0.05):
    return Sender(
        steering_of(SINE, "sine", {}, ["a"]),
        ("tail",),
        {"a": start},
        slew_per_s={} if slew is None else {"a": slew},
        period_s=period_s,
        rate_hz=100.0,
        duration_s=duration_s,
        cycle_s=1 / 1.4,
    )


@given(st.lists(st.tuples(st.floats(20, 60), st.floats(0.0, 0.3)), min_size=1, max_size=40))
def test_the_command_never_jumps_however_late_the_steps_come(steps):
    """A jump would be a speed that no gait of these amplitudes has; lateness is anything up to six periods."""
    made = pieces(slew=100.0, duration_s=1000.0)
    made.first()
    time_s = 0.0
    for goal, late_s in steps:
        made.next(time_s, {"a": goal})
        time_s += 0.05 + late_s
    command = made.command()
    fastest = np.degrees(command.peak_speed_rad_s()[0])
    assert fastest <= np.hypot(2 * np.pi * 1.4 * 60, 100.0) * 1.02 + 1.0


def test_on_time_the_command_is_the_gait_with_straight_drives_between_the_steps():
    made = pieces()
    made.first()
    goals = 20 + 20 * np.random.default_rng(3).random(100)
    for number, goal in enumerate(goals):
        made.next(0.05 * number, {"a": goal})
    command = made.command()
    steps_s = 0.05 * np.arange(101)
    amplitude = np.interp(command.time_s, steps_s, [20.0, *goals])
    inside = command.time_s <= 5.0
    expected = amplitude * np.sin(2 * np.pi * 1.4 * command.time_s)
    np.testing.assert_allclose(np.degrees(command.angle_rad[inside, 0]), expected[inside], atol=1e-9)


def test_a_piece_bridges_one_step_that_does_not_come_and_then_stands_still():
    made = pieces()
    made.first()
    piece = made.next(0.0, {"a": 40.0})
    assert piece.duration_s == pytest.approx(0.1)
    np.testing.assert_allclose(piece.at([0.1, 5.0]), np.repeat(piece.at(0.1), 2, axis=0))


def test_after_a_stall_the_gait_goes_on_from_where_it_stopped():
    made = pieces()
    made.first()
    piece = made.next(0.0, {"a": 20.0})
    late = made.next(3.0, {"a": 20.0})
    assert late.angle_rad[0, 0] == piece.angle_rad[-1, 0]
    np.testing.assert_allclose(np.degrees(late.at(0.02)), 20 * np.sin(2 * np.pi * 1.4 * 0.12), atol=1e-9)


def test_no_piece_goes_on_after_the_recording():
    made = pieces(duration_s=1.0)
    made.first()
    for number in range(20):
        made.next(0.05 * number, {"a": 30.0})
    assert made.command().duration_s == pytest.approx(1.0)


def test_the_slew_rate_holds_from_where_the_variable_stands():
    made = pieces(slew=10.0)
    made.first()
    made.next(0.0, {"a": 60.0})
    assert made.goals["a"] == pytest.approx(20.5)
    assert made.drives(0.025)["a"] == pytest.approx(20.25)
    made.next(0.025, {"a": 60.0})
    assert made.goals["a"] == pytest.approx(20.75)


def test_a_piece_that_was_refused_is_not_part_of_the_command():
    made = pieces()
    made.first()
    made.next(0.0, {"a": 20.0})
    Pieces.next(made, 0.05, {"a": 50.0})
    np.testing.assert_allclose(
        np.degrees(made.command().angle_rad[:, 0]),
        20 * np.sin(2 * np.pi * 1.4 * made.command().time_s),
        atol=1e-9,
    )
