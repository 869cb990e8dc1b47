"""Where two fitted curves cross: closed forms, intervals that hold the truth, and what cannot be crossed."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from labrun.errors import FitError, RequestError
from labrun.fit import FitJob
from labrun.fit import crossing as module
from labrun.fit.crossing import CrossingFit, CrossingSettings, Measured, crossing
from labrun.store import TrialOutcome

SPEEDS = np.repeat([0.1, 0.15, 0.2, 0.25, 0.3], 4)


def rng(seed=0):
    return np.random.default_rng(seed)


@settings(max_examples=25)
@given(thrust=st.floats(0.1, 1.0), falls=st.floats(0.0, 2.0), drag=st.floats(2.0, 12.0))
def test_the_crossing_of_a_falling_line_and_a_drag_is_the_root_of_their_equation(thrust, falls, drag):
    exact = (-falls + np.sqrt(falls**2 + 4 * drag * thrust)) / (2 * drag)
    measured = Measured(SPEEDS, thrust - falls * SPEEDS, (0, 1))
    other = Measured(SPEEDS, drag * SPEEDS**2, (2,))
    result = crossing(measured, other, rng(), 10)
    if 0.1 < exact < 0.3:
        assert result.at == pytest.approx(exact, abs=1e-5)
        assert result.value == pytest.approx(drag * exact**2, rel=1e-3)
        assert result.ci95 == pytest.approx((exact, exact), abs=1e-5)  # nothing scatters
    else:
        assert result is None


def test_curves_of_different_places_are_crossed_where_both_were_measured():
    measured = Measured(np.linspace(0.0, 0.2, 9), np.linspace(0.0, 0.2, 9), (0, 1))
    other = Measured(np.linspace(0.1, 0.4, 9), np.full(9, 0.15), (0,))
    assert crossing(measured, other, rng(), 10).at == pytest.approx(0.15, abs=1e-5)
    apart = Measured(np.linspace(0.3, 0.4, 9), np.full(9, 0.15), (0,))
    assert crossing(measured, apart, rng(), 10) is None


def _coverage(repeats, runs=80):
    truth, holds = (-0.5 + np.sqrt(0.25 + 4 * 5 * 0.3)) / 10, 0
    places = np.repeat([0.1, 0.15, 0.2, 0.25, 0.3], repeats)
    noise = rng(1)
    for _ in range(runs):
        measured = Measured(places, 0.3 - 0.5 * places + noise.normal(0, 0.02, len(places)), (0, 1))
        other = Measured(places, 5 * places**2 + noise.normal(0, 0.02, len(places)), (2,))
        low, high = crossing(measured, other, noise, 150).ci95
        holds += low <= truth <= high
    return holds / runs


@pytest.mark.parametrize("repeats", [1, 3, 8])
def test_the_interval_holds_the_truth_about_as_often_as_it_says(repeats):
    assert 0.86 <= _coverage(repeats) <= 1.0


def test_resampling_keeps_trials_at_their_place():
    curve = Measured(
        np.repeat([1.0, 2.0, 3.0], 5), np.repeat([10.0, 20.0, 30.0], 5) + rng().normal(0, 0.1, 15)
    )
    drawn = curve.resampled(rng(), 500)
    np.testing.assert_allclose(drawn.mean(axis=0), np.repeat([10.0, 20.0, 30.0], 5), atol=0.3)
    of_means = drawn.reshape(500, 3, 5).mean(axis=2).std(axis=0)
    expected = [curve.y[index : index + 5].std(ddof=1) / np.sqrt(5) for index in (0, 5, 10)]
    np.testing.assert_allclose(of_means, expected, rtol=0.15)


def test_resamples_that_do_not_cross_open_the_interval_and_are_counted():
    places = np.repeat([1.0, 2.0, 3.0], 4)
    curve = Measured(places, 2.9 - places + rng(3).normal(0, 0.3, 12), (0, 1))
    result = crossing(curve, 0.05, rng())
    assert result.open > 0.05
    assert result.ci95[1] == 3.0


class FakeRun:
    """A run of two poses, with its own name and units."""

    def __init__(self, name, force):
        self.name = name
        noise = rng(len(name))
        self.outcomes = [
            TrialOutcome(
                index, {"v": v, "pose": pose}, 0, objectives={"net": force(v, pose) + noise.normal(0, 0.002)}
            )
            for index, (v, pose, _) in enumerate(
                (v, pose, n) for v in (0.1, 0.15, 0.2, 0.25) for pose in (0.0, 1.0) for n in range(4)
            )
        ]

    def __enter__(self):
        return self

    def __exit__(self, *_):
        return None

    def units(self):
        return {"v": "m/s", "net": "N"}


@pytest.fixture
def fit(monkeypatch, tmp_path):
    known = {
        "towed": FakeRun("towed", lambda v, pose: 0.25 - (9 - 3 * pose) * v**2),
        "drag": FakeRun("drag", lambda v, _: -6 * v**2),
    }
    monkeypatch.setattr(module, "open_run", lambda path: known[path.name])
    monkeypatch.setattr(module, "is_recording", lambda path: path.name == "recording")

    def run(*more, target="towed", **keys):
        job = FitJob(tmp_path / target, rng(), tuple(tmp_path / run for run in more))
        return CrossingFit(CrossingSettings(over="v", **keys))(job)

    return run


def test_every_level_has_its_crossing_and_one_is_held_against_the_other(fit):
    result = fit(one={"objective": "net"}, by="pose", names={"0": "neutral", "1": "least drag"}, gain_at=0.1)
    for name, drag in (("at_neutral", 9), ("at_least_drag", 6)):
        parameter = result.parameters[name]
        assert parameter.value == pytest.approx(np.sqrt(0.25 / drag), abs=0.003)
        assert parameter.ci95[0] < parameter.value < parameter.ci95[1]
        assert parameter.unit == "m/s"
    drawn = [curve for curve in result.figure_data().rows[0][0].panels[0].curves if curve.bold]
    assert [tuple(curve.x) for curve in drawn] == [parameter.ci95 for parameter in result.parameters.values()]
    assert all((curve.y == 0.0).all() for curve in drawn)
    (message,) = (finding for finding in result.findings if "net against neutral" in finding)
    assert 16 < float(message.split("+")[1].split(" ")[0]) < 22  # (0.25 - 0.06) / (0.25 - 0.09)
    assert "pose" in result.to_text(100)


def test_a_curve_of_another_run_is_crossed_with_one_of_this(fit):
    result = fit(
        "drag",
        one={"objective": "net", "where": {"pose": 1.0}},
        other={"objective": "net", "experiment": "drag", "powers": [2], "scale": -1},
    )
    # 0.25 - 6 v^2 = 6 v^2
    assert result.parameters["at"].value == pytest.approx(np.sqrt(0.25 / 12), abs=0.002)


@pytest.mark.parametrize(
    ("keys", "error", "message"),
    [
        ({"one": {"objective": "nett"}}, RequestError, "no objective 'nett'"),
        ({"one": {"objective": "net", "where": {"pose": 7}}}, FitError, "no trial of towed that counts"),
        ({"one": {"objective": "net"}, "by": "fin"}, RequestError, "no trial has the condition 'fin'"),
        ({"one": {"objective": "net"}, "by": "v"}, FitError, "too few for a curve of 3 terms"),
        ({"one": {"objective": "net"}, "level": 7.0}, FitError, "does not meet 7"),
        (
            {"one": {"objective": "net"}, "other": {"objective": "net", "experiment": "drag"}},
            RequestError,
            "is that of drag, and only towed was given",
        ),
    ],
)
def test_what_cannot_be_crossed_is_told(fit, keys, error, message):
    with pytest.raises(error, match=message):
        fit(**keys)


def test_a_condition_without_a_number_and_a_recording_are_told(fit):
    with pytest.raises(RequestError, match="is a recording"):
        fit(target="recording", one={"objective": "net"})
