"""A diagnosis names what is missing, says how far it closes the gap, and is quiet where nothing is missing."""

import json
from dataclasses import replace

import numpy as np
import pytest

from labrun.errors import LabrunError, RequestError
from labrun.gap.diagnose import Options, diagnose_dataset
from labrun.gap.diagnosis import Diagnosis

from .benches import CONDITIONS, among, dry_friction, pendulum, recorded

QUICK = Options(places=False)
FRICTIONS = "coulomb-friction", "stribeck-friction"
FEW = among(*FRICTIONS, "quadratic-drag", "lag")
LEVELS = ("end-stop", "saturation", "rate-limit")
"""Effects that vanish at infinity."""


@pytest.fixture(scope="module")
def with_friction() -> Diagnosis:
    return diagnose_dataset(recorded(dry_friction(0.006)), pendulum(), QUICK)


@pytest.fixture(scope="module")
def without_effect() -> Diagnosis:
    return diagnose_dataset(recorded(), pendulum(), among("saturation", "end-stop", *FRICTIONS))


def names(diagnosis: Diagnosis) -> list[str]:
    return [str(cause.name) for cause in diagnosis.causes]


def test_hidden_dry_friction_is_named_at_its_joint(with_friction: Diagnosis) -> None:
    assert with_friction.verdict == "explained"
    assert names(with_friction) == ["coulomb-friction at hinge"]
    (cause,) = with_friction.causes
    assert cause.closes > 0.8
    assert cause.confidence > 0.5


def test_the_size_of_the_friction_is_found_with_an_interval_about_it(with_friction: Diagnosis) -> None:
    torque = with_friction.causes[0].values["torque"]
    assert torque.value == pytest.approx(0.006, rel=0.1)
    assert torque.low < torque.value < torque.high
    assert torque.unit == "N m"


def test_the_gap_shrinks_to_the_floor_on_conditions_the_fit_did_not_see(with_friction: Diagnosis) -> None:
    gap = with_friction.gap
    assert gap.raw > gap.recalibrated > 1.0
    assert gap.after < 0.2 * gap.recalibrated
    assert with_friction.shrinkage is not None
    assert with_friction.shrinkage.value > 0.95


def test_every_candidate_has_a_verdict_and_the_cause_has_the_first_place(with_friction: Diagnosis) -> None:
    verdicts = [candidate.verdict for candidate in with_friction.candidates]
    assert verdicts[0] == "cause"
    assert set(verdicts) <= {"cause", "rival", "not-needed", "excluded", "not-visible"}
    assert len({candidate.name for candidate in with_friction.candidates}) == len(verdicts) > 20


def test_what_is_excluded_is_told_with_the_range_that_was_searched(with_friction: Diagnosis) -> None:
    play = next(candidate for candidate in with_friction.candidates if candidate.name.effect == "backlash")
    assert play.verdict == "excluded"
    assert play.remark.startswith("searched: gap 0 to ")


@pytest.mark.slow
def test_friction_that_differs_by_direction_is_coulomb_friction_and_a_pull_while_the_joint_moves() -> None:
    def uneven(t: float, q: float, v: float) -> float:
        return float(-(0.006 + 0.002 * np.tanh(v / 0.02)) * np.tanh(v / 0.02))

    dataset = diagnose_dataset(recorded(uneven), pendulum(), QUICK)
    friction, pull = dataset.causes
    assert not any("not tried" in note for note in dataset.notes)
    assert any(candidate.name.effect == "asymmetric-friction" for candidate in dataset.candidates)
    assert str(friction.name) == "coulomb-friction at hinge"
    assert friction.values["torque"].value == pytest.approx(0.006, rel=0.05)
    pulls = {(rival.effect, rival.site) for rival in (pull.name, *pull.rivals)}
    assert pulls & {("constant-force", "hinge"), ("bias", "torque"), ("rest-offset", "hinge")}


def test_bounds_of_what_cannot_be_negative_begin_at_zero(with_friction: Diagnosis) -> None:
    excluded = {
        candidate.name: candidate.upper_bound
        for candidate in with_friction.candidates
        if candidate.verdict == "excluded"
    }
    ends = {
        (name.effect, key): (bound.low, bound.high)
        for name, bounds in excluded.items()
        for key, bound in bounds.items()
        if name.effect not in LEVELS
    }
    assert ends
    for (effect, _), (low, high) in ends.items():
        assert low <= 0.0 <= high
        if effect in ("quadratic-drag", "presliding-friction", "hysteresis", "delay", "lag", "dead-band"):
            assert low == 0.0
    assert any(low < 0.0 for low, _ in ends.values())  # a force or an offset has two sides


def test_levels_that_are_excluded_are_bounded_from_below_near_the_peak_of_the_signal(
    with_friction: Diagnosis,
) -> None:
    bounds = {
        candidate.name: candidate.upper_bound
        for candidate in with_friction.candidates
        if candidate.verdict == "excluded"
    }
    result = {
        (str(name), key): stored
        for name, of_one in bounds.items()
        for key, stored in of_one.items()
        if name.effect in LEVELS
    }
    torque = max(amplitude for amplitude, _ in CONDITIONS)
    steepest = max(2 * np.pi * frequency * amplitude for amplitude, frequency in CONDITIONS)
    angle = max(float(np.max(np.abs(trial.outputs))) for trial in recorded(dry_friction(0.006)).trials)
    for key, peak in {
        ("saturation at torque", "level"): torque,
        ("rate-limit at torque", "rate"): steepest,
        ("saturation at angle", "level"): angle,
        ("end-stop at hinge", "upper"): angle,
    }.items():
        stored = result[key]
        assert 0.85 * peak < stored.value <= 1.05 * peak
        assert stored.low == stored.value < stored.high
    lower = result["end-stop at hinge", "lower"]
    assert lower.low < lower.high == lower.value < -0.85 * angle


def test_the_answer_for_scripts_is_plain_json_without_nan(with_friction: Diagnosis) -> None:
    answer = json.loads(json.dumps(with_friction.to_json(), allow_nan=False))
    assert answer["causes"][0]["effect"] == "coulomb-friction"
    assert set(answer["gap"]) == {"raw", "recalibrated", "after", "floor"}


def test_the_same_data_and_seed_give_the_same_answer() -> None:
    data = recorded(dry_friction(0.006), repeats=2, conditions=CONDITIONS[:2])
    first, second = (
        diagnose_dataset(
            data, pendulum(), replace(among("coulomb-friction", "lag"), workers=workers)
        ).to_json()
        for workers in (1, 2)
    )
    assert {**first, "seconds": 0} == {**second, "seconds": 0}


@pytest.mark.parametrize("seed", [1, 2])
def test_wrong_parameters_alone_are_not_blamed_on_an_effect(seed: int, without_effect: Diagnosis) -> None:
    again = seed != 1  # which the fixture has diagnosed
    diagnosis = diagnose_dataset(recorded(seed=seed), pendulum(), FEW) if again else without_effect
    assert diagnosis.verdict == "no-gap"
    assert diagnosis.differs == ()
    assert diagnosis.gap.raw > 3.0 * diagnosis.gap.recalibrated
    assert diagnosis.causes == ()
    assert diagnosis.gap.recalibrated <= diagnosis.gap.floor
    assert diagnosis.rest.within_noise


def test_a_delayed_sensor_is_told_from_everything_in_the_joint() -> None:
    def late(angle: np.ndarray) -> np.ndarray:
        return np.interp(np.arange(len(angle)) - 2.5, np.arange(len(angle)), angle)

    diagnosis = diagnose_dataset(recorded(seen=late), pendulum(), among("delay", "lag", *FRICTIONS))
    first = diagnosis.causes[0]
    named = {(rival.effect, rival.site) for rival in (first.name, *first.rivals)}
    # with one output, a late sensor and a late drive are the same
    assert named & {("delay", "angle"), ("delay", "torque")}


@pytest.mark.slow
@pytest.mark.parametrize("exponent", [2.5, 3.4])
def test_a_spring_that_hardens_with_another_power_than_three_is_one_cause_with_its_exponent(
    exponent: float,
) -> None:
    """What the cube leaves of it looks like a force that comes back along the way, of a very long period."""
    hardening = recorded(lambda t, q, v: -0.06 * abs(q) ** (exponent - 1) * q, noise=0.002)
    (cause,) = diagnose_dataset(hardening, pendulum(), among("cubic-stiffness", "cogging", "end-stop")).causes
    assert str(cause.name) == "cubic-stiffness at hinge"
    assert cause.values["exponent"].value == pytest.approx(exponent, abs=0.05)
    assert cause.values["coefficient"].value == pytest.approx(0.06, rel=0.05)


def test_an_effect_taken_out_of_the_library_is_not_blamed_on_a_neighbour() -> None:
    stiffening = recorded(lambda t, q, v: -0.12 * q**3, noise=0.002, conditions=CONDITIONS[:3])
    neighbours = "quadratic-drag", "end-stop", "coulomb-friction"
    known = diagnose_dataset(stiffening, pendulum(), among("cubic-stiffness", "end-stop"))
    assert names(known) == ["cubic-stiffness at hinge"]
    unknown = diagnose_dataset(stiffening, pendulum(), among(*neighbours))
    assert unknown.verdict != "explained"
    assert not unknown.rest.within_noise
    assert any("cubic-stiffness" in text for text in unknown.limitations)


def test_withholding_an_effect_that_does_not_exist_names_the_nearest() -> None:
    with pytest.raises(RequestError, match="coulomb-frction") as caught:
        diagnose_dataset(recorded(repeats=1), pendulum(), Options(withhold=("coulomb-frction",)))
    assert "coulomb-friction" in (caught.value.hint or "")


def test_one_trial_is_answered_with_its_limits() -> None:
    diagnosis = diagnose_dataset(recorded(repeats=1, conditions=CONDITIONS[:1]), pendulum(), FEW)
    assert any("One trial only" in limitation for limitation in diagnosis.limitations)
    assert any(
        "how much of what is left is noise is not known" in limitation for limitation in diagnosis.limitations
    )
    assert any("One condition only" in limitation for limitation in diagnosis.limitations)


def test_numbers_that_are_not_finite_are_refused_with_their_place() -> None:
    dataset = recorded(repeats=1)
    dataset.trials[2].outputs[17, 0] = np.nan
    with pytest.raises(LabrunError, match="sample 18"):
        diagnose_dataset(dataset, pendulum(), QUICK)


def test_a_clock_that_went_backwards_is_refused() -> None:
    dataset = recorded(repeats=1)
    dataset.trials[0].time_s[10] = dataset.trials[0].time_s[8]
    with pytest.raises(LabrunError, match="does not increase"):
        diagnose_dataset(dataset, pendulum(), QUICK)


def test_an_output_that_never_moves_is_refused() -> None:
    dataset = recorded(repeats=2)
    for trial in dataset.trials:
        trial.outputs[:] = 0.0
    with pytest.raises(LabrunError, match="zero throughout"):
        diagnose_dataset(dataset, pendulum(), QUICK)
