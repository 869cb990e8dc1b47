"""A hinge's stiffness and damping come out the same both ways, and right."""

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from labrun_plugins.rigs.hinge.body import hinge_model
from labrun_plugins.rigs.hinge.free_swings import fit_hinge
from labrun_plugins.rigs.hinge.releases import fit_fourier
from swings import DAMPING, GRAVITY, INERTIA, STIFFNESS, dataset_of, swing

from labrun.errors import FitError
from labrun.fit import Dataset, load_dataset
from labrun.models import Model, load_model, parse_model

BODY = """
name = "body"
states = ["angle", "rate"]
[parameters]
inertia = {{ value = {inertia}, tolerance = {inertia_tolerance}, unit = "kg m^2" }}
gravity_torque = {{ value = {gravity}, tolerance = {gravity_tolerance}, unit = "N m" }}
[equations]
angle = "rate"
rate = "-gravity_torque*sin(angle)/inertia"
[outputs]
angle = "angle"
"""
RELEASES_DEG = (10, 20, 30, 40, 50)


def body(
    inertia_tolerance: float | str = 0.0, gravity_tolerance: float | str = 0.0, gravity: float = GRAVITY
) -> Model:
    quoted = [
        f'"{value}"' if isinstance(value, str) else value for value in (inertia_tolerance, gravity_tolerance)
    ]
    text = BODY.format(
        inertia=INERTIA, gravity=gravity, inertia_tolerance=quoted[0], gravity_tolerance=quoted[1]
    )
    return parse_model(text, "body.toml")


def swings(noise_rad: float = 0.0) -> Dataset:
    rng = np.random.default_rng(0)
    made = [swing(np.radians(release_deg)) for release_deg in RELEASES_DEG]
    return dataset_of([(time_s, angle + noise_rad * rng.normal(size=len(angle))) for time_s, angle in made])


def test_on_clean_swings_both_ways_agree_with_the_truth_and_each_other() -> None:
    parameters = fit_hinge(swings(), body(), rng=np.random.default_rng(0)).parameters
    for name, truth in (("stiffness", STIFFNESS), ("damping", DAMPING)):
        assert parameters[name].value == pytest.approx(truth, rel=1e-3)
        assert parameters[f"{name}_fourier"].value == pytest.approx(truth, rel=1e-3)
        assert parameters[name].value == pytest.approx(parameters[f"{name}_fourier"].value, rel=1e-3)
    assert parameters["stiffness"].unit == "N m/rad"
    assert parameters["damping_fourier"].unit == "N m s/rad"


def test_table_3_2_is_recovered_through_the_cameras_noise() -> None:
    result = fit_hinge(swings(noise_rad=1e-3), body(), rng=np.random.default_rng(0))
    parameters = result.parameters
    assert parameters["stiffness"].value == pytest.approx(0.0686, rel=0.003)
    assert parameters["stiffness_fourier"].value == pytest.approx(0.0686, rel=0.003)
    assert parameters["damping"].value == pytest.approx(2.89e-4, rel=0.02)
    assert parameters["damping_fourier"].value == pytest.approx(2.89e-4, rel=0.02)
    assert result.rmse["angle"] == pytest.approx(1e-3, rel=0.05)
    assert not any("disagree" in warning or "eq. (3.5) leaves" in warning for warning in result.warnings)


def test_releases_that_differ_give_the_mean_within_its_interval_and_the_scatter() -> None:
    rng = np.random.default_rng(3)
    made = []
    for release_deg in RELEASES_DEG * 5:
        stiffness = STIFFNESS * (1 + 0.01 * rng.normal())
        damping = DAMPING * (1 + 0.015 * rng.normal())
        time_s, angle = swing(np.radians(release_deg), stiffness=stiffness, damping=damping, duration_s=5.0)
        made.append((time_s, angle + 1e-3 * rng.normal(size=len(angle))))
    result = fit_hinge(dataset_of(made), body(), rng=np.random.default_rng(0))
    for way in ("", "_fourier"):
        for name, truth, relative in (("stiffness", STIFFNESS, 0.01), ("damping", DAMPING, 0.015)):
            parameter = result.parameters[name + way]
            assert parameter.value == pytest.approx(truth, rel=0.02)
            assert parameter.ci95[0] <= truth <= parameter.ci95[1]
            half = 0.5 * (parameter.ci95[1] - parameter.ci95[0])
            assert half == pytest.approx(2.06 * relative * truth / np.sqrt(25), rel=0.5)
    # in phase to the end, although stiffness differs: the residual is the cameras' noise
    assert result.rmse["angle"] == pytest.approx(1e-3, rel=0.05)
    match = re.search(r"stiffness varies by ([\d.]+) % and damping varies by ([\d.]+) %", result.findings[0])
    assert match is not None
    assert float(match[1]) == pytest.approx(1.0, rel=0.35)
    assert float(match[2]) == pytest.approx(1.5, rel=0.35)
    assert result.warnings == ()
    assert len(result.by_trial) == 25


def test_an_uncertain_body_is_told_and_not_dragged_along() -> None:
    hinge = fit_hinge(swings(noise_rad=1e-3), body(0.03, 0.02), rng=np.random.default_rng(0))
    assert hinge.fixed["inertia"] == INERTIA
    assert hinge.fixed["gravity_torque"] == GRAVITY
    message = next(warning for warning in hinge.warnings if "taken as stated" in warning)
    # k = I w^2 - m g r: what a heavier body would have given, to first order
    heavier = np.hypot(0.03 * (STIFFNESS + GRAVITY), 0.02 * GRAVITY) / STIFFNESS
    assert f"stiffness by up to {196 * heavier:.2g} %, damping by up to 5.9 %" in message


def test_intervals_cover_a_body_that_is_off_by_as_much_as_its_tolerance_says() -> None:
    wrong = parse_model(
        BODY.format(
            inertia=1.03 * INERTIA, gravity=0.97 * GRAVITY, inertia_tolerance=0.03, gravity_tolerance=0.03
        ),
        "b",
    )
    rng = np.random.default_rng(0)
    parameters = fit_hinge(swings(noise_rad=1e-3), wrong, rng=rng).parameters
    exact = fit_hinge(swings(noise_rad=1e-3), wrong, rng=rng, body_in_intervals=False).parameters
    for way in ("", "_fourier"):
        for name, truth in (("stiffness", STIFFNESS), ("damping", DAMPING)):
            low, high = parameters[name + way].ci95
            assert low < truth < high
            assert not exact[name + way].ci95[0] < truth < exact[name + way].ci95[1]


def test_the_told_effect_of_the_body_is_what_a_wrong_body_does() -> None:
    heavy = parse_model(
        BODY.format(inertia=1.03 * INERTIA, gravity=GRAVITY, inertia_tolerance=0.0, gravity_tolerance=0.0),
        "b",
    )
    made = [swing(release, duration_s=5.0) for release in (0.1, 0.12)]
    parameters = fit_hinge(dataset_of(made), heavy, rng=np.random.default_rng(0)).parameters
    for way in ("", "_fourier"):
        shift = parameters["stiffness" + way].value - STIFFNESS
        assert shift == pytest.approx(0.03 * (STIFFNESS + GRAVITY), rel=0.03)
        assert parameters["damping" + way].value / DAMPING == pytest.approx(1.03, rel=3e-3)


def test_air_drag_shows_as_damping_that_grows_with_the_release() -> None:
    rng = np.random.default_rng(1)
    made = [
        swing(np.radians(release), extra=lambda angle, rate: -4e-6 * abs(rate) * rate)
        for release in RELEASES_DEG * 2
    ]
    noisy = [(time_s, angle + 3e-4 * rng.normal(size=len(angle))) for time_s, angle in made]
    result = fit_hinge(dataset_of(noisy), body(), rng=np.random.default_rng(0))
    message = next(warning for warning in result.warnings if warning.startswith("damping grows"))
    assert "air drag" in message
    shown = re.search(r"from (\d+) and from (\d+) deg", message)
    assert shown is not None
    assert [float(angle) for angle in shown.groups()] == pytest.approx([10, 50], rel=0.05)
    # the line through all releases leads back to the damping that is there without drag
    extrapolated = re.search(r"small swings it is (\S+)", message)
    assert extrapolated is not None
    assert float(extrapolated[1]) == pytest.approx(DAMPING, rel=0.03)
    assert result.parameters["damping"].value > 1.03 * DAMPING
    assert result.parameters["stiffness"].value == pytest.approx(STIFFNESS, rel=2e-3)


def test_a_release_that_is_no_swing_is_left_out_and_named() -> None:
    dataset = swings(noise_rad=1e-3)
    wrong = dataset.trials[2]
    # the camera lost the body for two seconds, and the swing went on elsewhere
    jumped = np.where(wrong.time_s[:, None] > 2.0, 0.4 * np.sin(5.0 * wrong.time_s[:, None]), wrong.outputs)
    trials = (*dataset.trials[:2], replace(wrong, outputs=jumped), *dataset.trials[3:])
    result = fit_hinge(replace(dataset, trials=trials), body(), rng=np.random.default_rng(0))
    assert len(result.dataset.trials) == len(result.simulated) == 4
    assert result.dataset.left_out == 1
    assert any("left out" in warning and wrong.label in warning for warning in result.warnings)
    assert result.parameters["stiffness"].value == pytest.approx(STIFFNESS, rel=2e-3)


def test_one_release_alone_is_fitted_with_intervals_from_its_pieces_that_mostly_hold_the_truth() -> None:
    rng = np.random.default_rng(5)
    time_s, angle = swing(np.radians(30.0))
    held = {"": 0, "_fourier": 0}
    for _ in range(12):
        noisy = dataset_of([(time_s, angle + 1e-3 * rng.normal(size=len(angle)))])
        result = fit_hinge(noisy, body(), rng=np.random.default_rng(0))
        assert any("one trial only" in warning for warning in result.warnings)
        for way in held:
            low, high = result.parameters["stiffness" + way].ci95
            held[way] += low < STIFFNESS < high
    # 95 % intervals: nine or more of twelve, except once in several thousand times
    assert min(held.values()) >= 9


def test_a_pendulum_without_spring_shows_a_stiffness_around_zero() -> None:
    made = [swing(release, stiffness=0.0, duration_s=8.0) for release in (0.4, 0.7, 1.0, 1.3, 1.6)]
    rng = np.random.default_rng(4)
    dataset = dataset_of([(time_s, angle + 1e-3 * rng.normal(size=len(angle))) for time_s, angle in made])
    result = fit_hinge(dataset, body(0.0, "free"), rng=np.random.default_rng(0))
    assert result.parameters["stiffness"].contains_zero
    assert result.parameters["gravity_torque"].value == pytest.approx(GRAVITY, rel=0.01)
    assert any(
        warning.startswith("stiffness is not distinguishable from zero") for warning in result.warnings
    )
    assert any("without any spring" in warning for warning in result.warnings)


def test_large_swings_tell_gravity_from_a_spring() -> None:
    made = [swing(release, duration_s=6.0) for release in (0.6, 0.9, 1.2, 1.5)]
    parameters = fit_hinge(
        dataset_of(made), body(0.0, "free", gravity=0.05), rng=np.random.default_rng(0)
    ).parameters
    assert parameters["gravity_torque"].value == pytest.approx(GRAVITY, rel=5e-3)
    assert parameters["stiffness"].value == pytest.approx(STIFFNESS, rel=5e-3)
    assert parameters["gravity_torque_fourier"].value == pytest.approx(GRAVITY, rel=5e-3)


def test_dry_friction_that_the_model_lacks_is_reported() -> None:
    made = [
        swing(np.radians(release), extra=lambda angle, rate: -1e-3 * np.tanh(rate / 0.01))
        for release in RELEASES_DEG
    ]
    rng = np.random.default_rng(0)
    dataset = dataset_of([(time_s, angle + 2e-4 * rng.normal(size=len(angle))) for time_s, angle in made])
    result = fit_hinge(dataset, body(), rng=np.random.default_rng(0))
    assert any("the swing has forces that it lacks" in warning for warning in result.warnings)


def test_the_series_follows_a_decaying_swing_and_both_its_derivatives() -> None:
    time_s = np.arange(0, 8, 1 / 360)
    decay, omega = 0.3, 9.0
    wave = np.exp((-decay + 1j * omega) * time_s)
    fourier = fit_fourier(time_s, wave.real)
    inside = np.isin(time_s, fourier.time_s)
    assert 0 < np.count_nonzero(~inside) < 0.15 * len(time_s)
    np.testing.assert_allclose(fourier.angle, wave.real[inside], atol=1e-5)
    np.testing.assert_allclose(fourier.rate, ((-decay + 1j * omega) * wave).real[inside], atol=1e-3)
    np.testing.assert_allclose(
        fourier.acceleration, ((-decay + 1j * omega) ** 2 * wave).real[inside], atol=0.05
    )


def test_the_series_tells_the_noise_of_the_sensor() -> None:
    time_s, angle = swing(0.5)
    noisy = angle + 2e-3 * np.random.default_rng(0).normal(size=len(angle))
    assert fit_fourier(time_s, noisy).noise == pytest.approx(2e-3, rel=0.05)


def test_a_record_of_less_than_three_swings_is_refused() -> None:
    time_s, angle = swing(0.5, duration_s=1.0)
    with pytest.raises(FitError, match="too little for a Fourier series"):
        fit_fourier(time_s, angle)


def test_without_the_bodys_inertia_nothing_is_fitted() -> None:
    with pytest.raises(FitError, match="inertia and gravity_torque"):
        hinge_model(None)


def test_an_inertia_that_is_left_free_is_refused() -> None:
    with pytest.raises(FitError, match="inertia, which the model leaves free"):
        hinge_model(body(inertia_tolerance="free"))


def test_the_pendulums_stiffness_is_not_distinguishable_from_zero(recordings: Path) -> None:
    folder = recordings / "ring-down"
    model = load_model(folder / "model.toml")
    result = fit_hinge(load_dataset(folder, model), model, rng=np.random.default_rng(0))
    assert result.parameters["stiffness"].contains_zero
    assert result.parameters["stiffness_fourier"].contains_zero
    assert any("stiffness is not distinguishable from zero" in warning for warning in result.warnings)
