"""A law for what the library lacks: the terms of a law that was put in, at their size; none for noise."""

from dataclasses import replace

import gap_examples
import numpy as np
import pytest
from swings import MODEL, dataset_of, swing

from labrun.gap import save_with_law
from labrun.gap.averaging import averaged
from labrun.gap.recalibration import recalibrate
from labrun.gap.rest_law import explain_rest
from labrun.models import load_model, parse_model
from labrun.report.gap_text import gap_lines


def law_of(extra, trials=4):
    rng = np.random.default_rng(1)
    made = []
    for release in np.linspace(1.2, 0.3, trials):
        time_s, angle = swing(release, duration_s=3.0, rate_hz=120.0, extra=extra)
        made.append((time_s, angle + 2e-3 * rng.standard_normal(len(angle))))
    model = parse_model(MODEL, "hinge.toml")
    recalibrated = recalibrate(
        model, averaged(dataset_of(made), model), np.random.default_rng(0), lambda _: None
    )
    return explain_rest(recalibrated.problem, recalibrated.z, recalibrated.noise, np.random.default_rng(0))


def coefficient(term):
    """Return the factor of a monomial, whatever typical motion its terms are multiples of."""
    return term.size * eval(term.formula, {"q": 1.0, "rate": 1.0, "abs": abs})


@pytest.fixture(scope="module")
def cubic():
    # a torque that is no effect of the library: drag with the third power of the rate
    return law_of(lambda _, rate: -2e-5 * rate**3)


def test_a_law_of_one_term_is_found_at_its_size(cubic):
    (term,) = replace(
        cubic, terms=tuple(replace(other, formula=other.formula.replace("^", "**")) for other in cubic.terms)
    ).terms
    assert "rate" in term.formula
    assert "**3" in term.formula
    assert coefficient(term) == pytest.approx(-2e-5, rel=0.02)
    assert term.unit == "N m"
    assert term.chosen > 0.9
    assert cubic.share > 0.95


def test_a_law_of_two_terms_is_found_and_a_third_is_not_added():
    law = law_of(lambda angle, rate: -3e-6 * rate**3 - 0.01 * angle * abs(angle))
    assert len(law.terms) == 2
    assert {term.formula.count("abs") for term in law.terms} == {0, 1}


def test_of_noise_alone_there_is_no_law():
    law = law_of(lambda *_: 0.0)
    assert law.terms == ()
    assert "predicts what is left" in law.sentence


def test_one_trial_is_withheld_block_by_block():
    law = law_of(lambda _, rate: -2e-5 * rate**3, trials=1)
    assert len(law.terms) == 1
    assert law.share > 0.9


def test_the_law_is_written_as_an_effect_and_the_model_carries_it(cubic, tmp_path):
    diagnosis = replace(gap_examples.unexplained(), law=cubic, source=str(tmp_path))
    (tmp_path / "hinge.toml").write_text(MODEL)
    save_with_law(
        diagnosis, tmp_path / "hinge.toml", tmp_path / "rest-law.toml", tmp_path / "rest-model.toml"
    )
    carried = load_model(tmp_path / "rest-model.toml").effects
    assert [effect.values for effect in carried] == [cubic.values]
    assert load_model(tmp_path / "rest-model.toml").origin.model.endswith("hinge.toml")
    lines = [line.plain for line in gap_lines(diagnosis, 100)]
    assert any(line.startswith("law") and "Missing force at hinge" in line for line in lines)
    assert len(lines) <= 20
    assert diagnosis.to_json()["rest"]["law"]["terms"][0]["unit"] == "N m"
