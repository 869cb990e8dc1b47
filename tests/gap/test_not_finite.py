"""What gives no finite numbers is said to, and never taken for a change of the outputs."""

import math

import numpy as np
import pytest

import labrun.effects
from labrun.effects import Effect, EffectParameter, Scale, force_law
from labrun.errors import FitError
from labrun.fit import Dataset, FitTrial, silent
from labrun.fit.problem import Problem
from labrun.gap.averaging import averaged
from labrun.gap.candidates import Candidate
from labrun.gap.diagnose import Options, diagnose_dataset
from labrun.gap.diagnosis import Name
from labrun.gap.recalibration import recalibrate, stated_problem, unsearched
from labrun.gap.screening import Base, screen_all, survey
from labrun.models import parse_model
from labrun.store import SignalInfo

from .benches import CONDITIONS, PENDULUM, dry_friction, pendulum, recorded


def never(t, q, rate, acceleration, load, stiffness, values, z, dz):
    """Return no number at all."""
    return values[0] * (math.inf - math.inf)


def when_small(t, q, rate, acceleration, load, stiffness, values, z, dz):
    """Return a drag whose formula breaks down for sizes above 0.5."""
    return -0.01 * math.sqrt(0.5 - values[0]) * rate


def stiff(t, q, rate, acceleration, load, stiffness, values, z, dz):
    """Return a drag that wants steps of a quarter of the base's where it is large."""
    return -2.0 * values[0] * rate


def effect(name, law) -> Effect:
    torque = EffectParameter("torque", "force", neutral=0.0, lower=0.0, upper=2.0, starts=(0.4,))
    return Effect(id=name, kind="joint", parameters=(torque,), function=force_law(law), form="-", source="-")


NEVER, WHEN_SMALL = effect("no-number", never), effect("breaks-when-large", when_small)


@pytest.fixture(scope="module")
def base() -> Base:
    problem = stated_problem(pendulum(), averaged(recorded(repeats=1, conditions=CONDITIONS[:2]), pendulum()))
    return Base.of(problem, problem.priors.stated)


def candidate(library_effect: Effect) -> Candidate:
    name = Name(library_effect.id, "hinge")
    return Candidate(name, library_effect.attach("hinge"), Scale(), ((0.4,), (0.1,), (1.2,)))


def test_starts_that_give_no_finite_numbers_are_dropped(base: Base) -> None:
    looked = survey(base, candidate(WHEN_SMALL))
    assert sorted(float(z[base.problem.size]) for z in looked.starts) == [0.1, 0.4]
    assert looked.directions.shape[1] == 2
    assert np.all(np.isfinite(looked.directions))


def test_a_candidate_without_any_finite_start_promises_nothing_and_is_not_fitted(base: Base) -> None:
    looked = survey(base, candidate(NEVER))
    assert looked.starts == []
    assert looked.potential == 0.0
    assert looked.lines.shape[1] == 0
    fitted = screen_all(base, [looked, survey(base, candidate(WHEN_SMALL))])
    assert [screened.candidate.name.effect for screened in fitted] == ["breaks-when-large"]


def test_a_candidate_that_wants_shorter_steps_keeps_them_after_its_fit(base: Base) -> None:
    attached = effect("stiff", stiff).attach("hinge")
    looked = survey(base, Candidate(Name("stiff", "hinge"), attached, Scale(), ((0.4,),)))
    assert looked.problem.finite_residuals(looked.starts[0]) is None
    (fitted,) = screen_all(base, [looked])
    assert fitted.problem.substeps > base.problem.substeps
    assert fitted.squares == fitted.problem.squares(fitted.z)
    assert fitted.problem.finite_residuals(fitted.z) is not None


def test_an_effect_that_gives_no_numbers_is_not_ruled_out_but_said_not_to_have_been_tried(
    monkeypatch,
) -> None:
    library = [other for other in labrun.effects.effects() if other.id in ("coulomb-friction", "bias")]
    monkeypatch.setattr("labrun.gap.candidates.effects", lambda **_: (*library, NEVER))
    data = recorded(dry_friction(0.006), conditions=CONDITIONS[:3])
    dataset = diagnose_dataset(data, pendulum(), Options(places=False))
    assert "no-number" not in {other.name.effect for other in dataset.candidates}
    assert "effect no-number at hinge gives no finite numbers at any size: it was not tried" in dataset.notes
    assert str(dataset.causes[0].name) == "coulomb-friction at hinge"


def with_equation(addition: str) -> object:
    return parse_model(PENDULUM.replace("- gravity*sin(angle)", f"- gravity*sin(angle) {addition}"), "m.toml")


def problem_of(model) -> Problem:
    return stated_problem(model, averaged(recorded(repeats=1, conditions=CONDITIONS[:1]), model))


def test_ends_of_what_is_believed_that_do_not_simulate_are_named() -> None:
    problem = problem_of(
        with_equation("+ 0*log(gravity - 0.058)")
    )  # stated 0.06, three tolerances below: 0.0546
    messages = unsearched(problem, problem.priors.stated)
    assert "with gravity = 0.0546," in messages[0]
    assert "was not searched" in messages[0]


def test_simulations_that_left_the_finite_numbers_are_counted() -> None:
    problem = problem_of(pendulum())
    assert unsearched(problem, problem.priors.stated) == ()
    broken = problem.priors.values.copy()
    broken[0] = 0.0
    before = problem.simulations.made
    assert problem.simulate(broken, 0, np.empty(0)) is None
    assert (problem.simulations.made, problem.simulations.broken) == (before + 1, 1)
    assert f"1 of {before + 1} simulations of the model" in problem.simulations.remarks[0]


def test_a_model_that_never_simulates_is_refused_with_a_hint_that_helps() -> None:
    model = with_equation("+ 1/(inertia - inertia)")
    with pytest.raises(FitError, match="finite numbers") as caught:
        diagnose_dataset(recorded(repeats=1, conditions=CONDITIONS[:1]), model, Options(places=False))
    assert "labrun fit" not in (caught.value.hint or "")
    assert "units of its parameters" in (caught.value.hint or "")


def test_stated_values_that_want_shorter_steps_than_fitted_ones_are_simulated_all_the_same(tmp_path):
    text = """
name = "decay"
states = ["x"]
[parameters]
rate = { value = 500.0, tolerance = "free", lower = 0.0 }
[equations]
x = "-rate*x"
[outputs]
x = "x"
[initial]
x = 1.0
"""
    time_s, rng = np.linspace(0.0, 1.0, 101), np.random.default_rng(2)
    trials = [
        FitTrial(f"trial {k}", {"k": float(k)}, 1, time_s, np.empty((101, 0)), np.exp(-5.0 * time_s)[:, None]
                 + 1e-3 * rng.standard_normal((101, 1)))
        for k in range(3)
    ]  # fmt: skip
    data = Dataset("decay", tmp_path, "recording", (), (SignalInfo("x", "1"),), tuple(trials))
    model = parse_model(text, "decay.toml")
    recalibrated = recalibrate(model, averaged(data, model), rng, silent)
    assert np.isfinite(np.concatenate(recalibrated.problem.simulated(recalibrated.raw))).all()
