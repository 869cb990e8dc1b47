"""Where thrust meets drag: parabolas through net forces, closed forms, intervals, and what cannot be fitted."""

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from labrun_plugins.rigs.fish.swimming_speed import SwimmingSpeedFit, SwimmingSpeedSettings, crossing

from labrun.errors import FitError
from labrun.fit import FitJob

SPEEDS = np.array([0.1, 0.15, 0.2, 0.25])


@given(thrust=st.floats(0.05, 1.0), falls=st.floats(0.0, 2.0), drag=st.floats(1.0, 10.0))
def test_the_crossing_of_a_parabola_is_its_positive_root(thrust, falls, drag):
    exact = (-falls + np.sqrt(falls**2 + 4 * drag * thrust)) / (2 * drag)
    if exact < 0.5:
        assert crossing(SPEEDS, thrust - falls * SPEEDS - drag * SPEEDS**2) == pytest.approx(exact, rel=1e-6)


def test_a_force_that_never_falls_through_zero_has_no_crossing():
    assert np.isnan(crossing(SPEEDS, 1.0 + SPEEDS))
    assert np.isnan(crossing(SPEEDS, -1.0 - SPEEDS**2))


def _recording(folder: Path, forces, *, name="towed", frequency_hz=1.4):
    """Trials of two poses at four speeds: the net force with a beat on it, and a ramp that must not count."""
    folder = folder / name
    folder.mkdir()
    rng = np.random.default_rng(0)
    text = f'experiment = "{name}"\n\n[channels.force]\nkind = "output"\nunit = "N"\n'
    number = 0
    for pose, force in forces.items():
        for speed in SPEEDS:
            for _ in range(3):
                number += 1
                t = np.arange(0, 5, 0.01)
                values = force(speed) + 0.3 * np.sin(2 * np.pi * 2 * frequency_hz * t) + rng.normal(0, 0.002)
                values[t < speed / 0.5] -= 5.0
                lines = "\n".join(f"{a:.6f},{b:.9f}" for a, b in zip(t, values, strict=True))
                (folder / f"{number}.csv").write_text("time_s,force\n" + lines + "\n")
                condition = f"{{ v = {speed}, f = {frequency_hz}, pose = {pose} }}"
                text += f'\n[[trials]]\nfile = "{number}.csv"\ncondition = {condition}\n'
    (folder / "recording.toml").write_text(text)
    return folder


def _fit(folder, **settings):
    fit = SwimmingSpeedFit(SwimmingSpeedSettings(**settings))
    return fit(FitJob(folder, np.random.default_rng(0), signals={"force": "force"}))


def test_the_speeds_of_two_poses_and_the_gain_of_one_are_found_beside_ramps_and_beats(tmp_path):
    folder = _recording(tmp_path, {0: lambda v: 0.25 - 9 * v**2, 1: lambda v: 0.25 - 6 * v**2})
    found = _fit(folder, names={"0": "neutral", "1": "least drag"})
    for name, drag in (("speed_neutral", 9), ("speed_least_drag", 6)):
        one = found.parameters[name]
        assert one.value == pytest.approx(np.sqrt(0.25 / drag), abs=0.003)
        assert one.ci95[0] < one.value < one.ci95[1]
    (said,) = (one for one in found.findings if "net force against neutral" in one)
    assert said.startswith("at 0.1 m/s least drag has +")
    assert 16 < float(said.split("+")[1].split(" ")[0]) < 22  # (0.25 - 0.06) / (0.25 - 0.09)


@pytest.mark.parametrize(
    ("settings", "said"),
    [
        ({"of": {"pose": 7}}, "no trial has the conditions"),
        ({"speed": "pace"}, "no trial has a number for the condition 'pace'"),
        ({"by": "v"}, "1 speeds are too few"),
    ],
)
def test_what_cannot_be_fitted_is_told(tmp_path, settings, said):
    folder = _recording(tmp_path, {0: lambda v: 0.25 - 9 * v**2})
    with pytest.raises(FitError, match=said):
        _fit(folder, **settings)


def test_a_fish_that_is_towed_too_slowly_to_meet_its_drag_is_told_to_go_faster(tmp_path):
    folder = _recording(tmp_path, {0: lambda v: 0.25 + v})
    with pytest.raises(FitError, match="does not fall through zero") as told:
        _fit(folder)
    assert "tow slower and faster" in str(told.value.hint)
