"""A hinge's stiffness and damping come out the same both ways, and right."""

import numpy as np
import pytest
from swings import DAMPING, GRAVITY, INERTIA, STIFFNESS, dataset_of, swing

from labrun.errors import FitError
from labrun.fit.dataset import Dataset
from labrun.fit.fourier import fit_fourier
from labrun.fit.hinge import fit_hinge, hinge_model
from labrun.models import Model, parse_model

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


def swings(noise_rad: float = 0.0, repeats: int = 1, seed: int = 0, scatter: bool = False) -> Dataset:
    rng = np.random.default_rng(seed)
    made = []
    for release_deg in RELEASES_DEG * repeats:
        # Table 3.2: 2.3 % and 3.2 % from test to test
        stiffness = STIFFNESS * (1 + 0.023 * rng.normal() * scatter)
        damping = DAMPING * (1 + 0.032 * rng.normal() * scatter)
        time_s, angle = swing(np.radians(release_deg), stiffness=stiffness, damping=damping)
        made.append((time_s, angle + noise_rad * rng.normal(size=len(angle))))
    return dataset_of(made)


def test_on_clean_swings_both_ways_agree_with_the_truth_and_each_other() -> None:
    found = fit_hinge(swings(), body(), rng=np.random.default_rng(0)).parameters
    for name, truth in (("stiffness", STIFFNESS), ("damping", DAMPING)):
        assert found[name].value == pytest.approx(truth, rel=1e-3)
        assert found[f"{name}_fourier"].value == pytest.approx(truth, rel=1e-3)
        assert found[name].value == pytest.approx(found[f"{name}_fourier"].value, rel=1e-3)
    assert found["stiffness"].unit == "N m/rad"
    assert found["damping_fourier"].unit == "N m s/rad"


def test_table_3_2_is_recovered_through_the_cameras_noise() -> None:
    result = fit_hinge(swings(noise_rad=1e-3), body(), rng=np.random.default_rng(0))
    found = result.parameters
    assert found["stiffness"].value == pytest.approx(0.0686, rel=0.003)
    assert found["stiffness_fourier"].value == pytest.approx(0.0686, rel=0.003)
    assert found["damping"].value == pytest.approx(2.89e-4, rel=0.02)
    assert found["damping_fourier"].value == pytest.approx(2.89e-4, rel=0.02)
    assert result.rmse["angle"] == pytest.approx(1e-3, rel=0.05)
    assert not any("disagree" in warning or "eq. (3.5) leaves" in warning for warning in result.warnings)


def test_specimens_that_differ_from_release_to_release_widen_both_intervals() -> None:
    found = fit_hinge(
        swings(noise_rad=1e-3, repeats=2, seed=3, scatter=True), body(), rng=np.random.default_rng(0)
    )
    for way in ("", "_fourier"):
        for name, truth, relative in (("stiffness", STIFFNESS, 0.023), ("damping", DAMPING, 0.032)):
            low, high = found.parameters[name + way].ci95
            assert low <= truth <= high
            assert 0.5 * (high - low) == pytest.approx(1.96 * relative * truth / np.sqrt(10), rel=0.8)


def test_an_uncertain_body_makes_both_intervals_as_uncertain() -> None:
    found = fit_hinge(swings(noise_rad=1e-3), body(0.03, 0.03), rng=np.random.default_rng(0)).parameters
    for name in ("stiffness", "stiffness_fourier"):
        low, high = found[name].ci95
        assert low <= STIFFNESS <= high
        assert 0.02 < 0.5 * (high - low) / STIFFNESS < 0.25


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
    found = fit_hinge(
        dataset_of(made), body(0.0, "free", gravity=0.05), rng=np.random.default_rng(0)
    ).parameters
    assert found["gravity_torque"].value == pytest.approx(GRAVITY, rel=5e-3)
    assert found["stiffness"].value == pytest.approx(STIFFNESS, rel=5e-3)
    assert found["gravity_torque_fourier"].value == pytest.approx(GRAVITY, rel=5e-3)


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
    found = fit_fourier(time_s, wave.real)
    inside = np.isin(time_s, found.time_s)
    assert 0 < np.count_nonzero(~inside) < 0.15 * len(time_s)
    np.testing.assert_allclose(found.angle, wave.real[inside], atol=1e-5)
    np.testing.assert_allclose(found.rate, ((-decay + 1j * omega) * wave).real[inside], atol=1e-3)
    np.testing.assert_allclose(
        found.acceleration, ((-decay + 1j * omega) ** 2 * wave).real[inside], atol=0.05
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
