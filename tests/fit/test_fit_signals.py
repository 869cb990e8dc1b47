"""Signals of a fit: channels of runs and recordings on one even time base, tared, scaled, averaged."""

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from pydantic import ValidationError

from labrun.app.run import run as execute
from labrun.errors import FitError, RequestError
from labrun.experiment import load_named
from labrun.fit.signals import SignalTable, load_signals, trailing_mean
from labrun.store import open_run


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    results = tmp_path_factory.mktemp("results")
    loaded = load_named("fin-step", results, ("trial.duration_s=13", "trial.repeats=1"))
    return execute(loaded, results=results, dry_run=True, seed=3, draw=False).run


def table(channel: str, **keys: object) -> SignalTable:
    return SignalTable.model_validate({"channel": channel, **keys})


def test_a_channel_comes_tared_scaled_and_per_length_on_an_even_base(run):
    force = table("wrench.torque_y", scale=-1.0, divide_by_m=0.4)
    signals = load_signals(run, {"force": force}, where={"b_after": 0})
    (trial,) = signals.trials
    stored = open_run(run)
    outcome = next(other for other in stored.outcomes if other.condition["b_after"] == 0)
    stream = stored.signals(outcome.index)["wrench"]
    expected = -(stream.column("torque_y") - outcome.tare["wrench.torque_y"]) / 0.4
    assert signals.units == {"force": "N"}
    assert np.ptp(np.diff(trial.time_s)) < 1e-9
    assert trial.values["force"] == pytest.approx(np.interp(trial.time_s, stream.time_s, expected), abs=1e-12)


def test_what_the_gait_means_by_a_name_is_a_signal_too(run):
    signals = load_signals(run, {"a": table("gait.a"), "tail": table("command.tail")}, where={"b_after": 0})
    (trial,) = signals.trials
    before = trial.time_s < 10.0
    assert np.all(trial.values["a"][before] == 0.0)
    assert np.all(trial.values["a"][~before] == 40.0)
    assert np.max(np.degrees(trial.values["tail"])) == pytest.approx(40.0, rel=0.01)


def test_a_vector_is_averaged_before_its_size_and_direction_are_taken(run):
    parts = {
        "channel": "wrench.torque_y",
        "side_channel": "wrench.torque_x",
        "scale": -1.0,
        "average": "cycle",
    }
    signals = load_signals(
        run,
        {
            "size": SignalTable.model_validate({"take": "magnitude", **parts}),
            "angle": SignalTable.model_validate({"take": "direction", **parts}),
            "forward": table("wrench.torque_y", scale=-1.0, average="cycle"),
        },
    )
    assert signals.units == {"size": "N m", "angle": "deg", "forward": "N m"}
    for trial in signals.trials:
        along = trial.values["size"] * np.cos(np.radians(trial.values["angle"]))
        assert along == pytest.approx(trial.values["forward"], abs=1e-12)


@given(st.lists(st.floats(-1e3, 1e3), min_size=1, max_size=40), st.integers(1, 50))
def test_a_trailing_mean_is_the_mean_of_what_has_passed(values, samples):
    mean = trailing_mean(np.array(values), samples)
    expected = [np.mean(values[max(0, i - samples + 1) : i + 1]) for i in range(len(values))]
    assert mean == pytest.approx(expected, abs=1e-9)


@pytest.mark.parametrize(
    ("channel", "says"),
    [("wrench.torque_yy", "wrench.torque_y"), ("gait.aa", "gait.a"), ("rench.torque_y", "wrench.torque_y")],
)
def test_a_wrong_name_is_told_with_the_nearest(run, channel, says):
    with pytest.raises(RequestError) as error:
        load_signals(run, {"y": table(channel)})
    assert says in str(error.value.hint)


def test_no_trial_of_the_wanted_condition_is_an_error_that_names_it(run):
    with pytest.raises(FitError, match="b_after"):
        load_signals(run, {"y": table("wrench.torque_y")}, where={"b_after": 7})


@pytest.mark.parametrize("keys", [{"take": "magnitude"}, {"side_channel": "wrench.torque_x"}, {"scal": 1.0}])
def test_a_table_that_makes_no_signal_is_refused(keys):
    with pytest.raises(ValidationError):
        table("wrench.torque_y", **keys)


def test_channels_of_a_recording_are_signals_by_their_names(tmp_path):
    folder = tmp_path / "spring"
    folder.mkdir()
    (folder / "recording.toml").write_text(
        'experiment = "spring"\n[channels.force]\nkind = "input"\nunit = "N"\nbetween = "linear"\n'
        '[channels.way]\nkind = "output"\nunit = "m"\n[[trials]]\nfile = "one.csv"\nrepeat = 1\n'
        "condition = { load = 2.0 }\n"
    )
    time_s = np.arange(50) / 10
    rows = [f"{t},{np.sin(t)},{np.cos(t)}" for t in time_s]
    (folder / "one.csv").write_text("\n".join(["time_s,force,way", *rows]) + "\n")
    signals = load_signals(folder, {"u": table("force", scale=2.0), "y": table("way")}, rate_hz=20.0)
    (trial,) = signals.trials
    assert signals.units == {"u": "N", "y": "m"}
    assert len(trial.time_s) == 99
    assert trial.values["u"] == pytest.approx(2 * np.interp(trial.time_s, time_s, np.sin(time_s)))
