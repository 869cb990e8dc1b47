"""Which sets of causes are chosen, on small benches whose truth an independent integrator made."""

import json
from collections.abc import Mapping

import numpy as np
import pytest
from swings import MODEL, dataset_of, swing

from labrun.gap import Diagnosis, diagnose_dataset
from labrun.models import parse_model
from labrun.report.gap_page import diagnosis_page
from labrun.report.gap_text import gap_lines

from .benches import CONDITIONS, among, dry_friction, pendulum, recorded

FEW = among("coulomb-friction", "stribeck-friction", "quadratic-drag", "lag")

THREE = among("coulomb-friction", "quadratic-drag", "lag")


def causes(diagnosis: Diagnosis) -> set[str]:
    return {str(cause.name) for cause in diagnosis.causes}


@pytest.fixture(scope="module")
def friction_and_more() -> Diagnosis:
    """Dry friction beside a force over the angle, which the library of the search does not have."""
    rub = dry_friction(0.009)
    data = recorded(
        lambda t, q, v: rub(t, q, v) + 0.004 * float(np.sin(9.0 * q)), conditions=CONDITIONS[:4], repeats=2
    )
    return diagnose_dataset(data, pendulum(), THREE)


# --- none, two -----------------------------------------------------------------------------------------


def test_a_control_that_was_never_repeated_has_no_cause_and_what_is_left_is_not_called_noise() -> None:
    dataset = diagnose_dataset(recorded(conditions=CONDITIONS[:4], repeats=1), pendulum(), FEW)
    assert dataset.causes == ()
    assert dataset.verdict == "cannot-tell"
    assert not dataset.rest.within_noise
    assert "no gap" not in dataset.sentence.lower()


def test_dry_friction_and_drag_that_help_only_together_are_both_named() -> None:
    """In a free decay, the model's own damping takes the place of either of them alone."""
    rng, swings = np.random.default_rng(3), []
    for release in (0.5, 0.8, 1.1):
        time_s, angle = swing(
            release,
            duration_s=4.0,
            rate_hz=60.0,
            extra=lambda _, rate: -6e-4 * float(np.tanh(rate / 0.02)) - 1.2e-5 * abs(rate) * rate,
        )
        swings.append((time_s, angle + 5e-4 * rng.standard_normal(len(angle))))
    dataset = diagnose_dataset(dataset_of(swings), parse_model(MODEL, "hinge.toml"), THREE)
    assert causes(dataset) == {"coulomb-friction at hinge", "quadratic-drag at hinge"}
    sizes: Mapping[str, float] = {
        cause.name.effect: next(iter(cause.values.values())).value for cause in dataset.causes
    }
    assert sizes["coulomb-friction"] == pytest.approx(6e-4, rel=0.1)
    assert dataset.verdict == "explained"


# --- a cause beside something unknown --------------------------------------------------------------------------------


def test_a_cause_that_closes_a_part_is_named_and_the_rest_is_described(friction_and_more: Diagnosis) -> None:
    diagnosis = friction_and_more
    assert "coulomb-friction at hinge" in causes(diagnosis)
    assert diagnosis.verdict in ("mostly-explained", "partly-explained")
    assert 0.1 < diagnosis.rest.share_of_gap < 1.0
    assert diagnosis.rest.predictable is not None
    assert diagnosis.rest.predictable > 0.3
    assert "position of hinge" in diagnosis.rest.depends_on or "angle" in diagnosis.rest.depends_on


def test_the_rungs_of_the_ladder_and_the_rest_add_up_to_the_gap(friction_and_more: Diagnosis) -> None:
    diagnosis = friction_and_more
    assert [rung.step for rung in diagnosis.ladder[:2]] == ["as stated", "recalibrated"]
    assert [rung.cause for rung in diagnosis.ladder[2:]] == [cause.name for cause in diagnosis.causes]
    assert sum(rung.closes for rung in diagnosis.ladder) + diagnosis.rest.share_of_gap == pytest.approx(1.0)
    assert diagnosis.ladder[-1].in_noise == diagnosis.rest.in_noise == diagnosis.gap.after
    assert diagnosis.ladder[1].in_noise == diagnosis.gap.recalibrated
    errors = [rung.errors["angle"] for rung in diagnosis.ladder]
    assert errors == sorted(errors, reverse=True)


def test_text_page_and_json_tell_the_same_errors(friction_and_more: Diagnosis) -> None:
    diagnosis = friction_and_more
    answer = json.loads(json.dumps(diagnosis.to_json(), allow_nan=False))
    page = diagnosis_page(diagnosis)
    text = "\n".join(line.plain for line in gap_lines(diagnosis, 140))
    assert [rung["step"] for rung in answer["ladder"]] == [rung.step for rung in diagnosis.ladder]
    for rung in answer["ladder"]:
        assert rung["errors"]["angle"]["unit"] == "rad"
        assert f"{rung['errors']['angle']['value']:.2g}" in text
        assert f"{rung['errors']['angle']['value']:.3g}" in page
    assert answer["rest"]["share_of_gap"] == diagnosis.rest.share_of_gap
    assert f"{100 * diagnosis.rest.share_of_gap:.0f} % of the gap" in text.replace("\u00a0", " ")


def test_every_candidate_has_a_status_and_causes_come_first(friction_and_more: Diagnosis) -> None:
    statuses = [row.verdict for row in friction_and_more.candidates]
    assert statuses[: len(friction_and_more.causes)] == ["cause"] * len(friction_and_more.causes)
    assert set(statuses) <= {"cause", "rival", "not-needed", "excluded", "not-visible"}
    for row in friction_and_more.candidates:
        assert bool(row.upper_bound) == (row.verdict == "excluded")
        assert row.verdict != "rival" or row.same_as


def test_what_parameters_imitate_is_not_visible() -> None:
    dataset = diagnose_dataset(
        recorded(dry_friction(0.006), conditions=CONDITIONS[:3], repeats=2),
        pendulum(),
        among("coulomb-friction", "viscous-damping"),
    )
    damping = next(row for row in dataset.candidates if row.name.effect == "viscous-damping")
    assert damping.verdict == "not-visible"  # the model's own damping is free
