import numpy as np
import pytest
from where_cases import compared, made

from labrun.effects import load_effect
from labrun.fit.dataset import FitTrial
from labrun.gap.where import missing_forces
from labrun.models import parse_model


def hidden(name, **values):
    return load_effect(name, "joint").attach("hinge", **values)


def correlation(result, law):
    """Correlation of the force that was found with a law, once what recalibration takes is taken out of both."""
    force, true = np.concatenate(result.force), []
    columns = []
    for q, rate in zip(result.coordinate, result.rate, strict=True):
        true.append(law(q, rate))
        columns.append(np.stack([q, rate, np.gradient(rate)], axis=1))
    free = np.linalg.qr(np.concatenate(columns))[0]
    both = [values - free @ (free.T @ values) for values in (force, np.concatenate(true))]
    return np.corrcoef(*both)[0, 1]


@pytest.mark.parametrize(
    ("effect", "law"),
    [
        (
            hidden("coulomb-friction", torque=0.05, transition_speed=0.2),
            lambda q, rate: -0.05 * np.tanh(rate / 0.2),
        ),
    ],
    ids=["friction"],
)
def test_the_force_that_is_missing_is_the_hidden_one(effect, law):
    difference = made(np.random.default_rng(1), [effect], sd=np.array([0.003, 0.02]))
    (force,) = missing_forces(difference)
    assert force.site == "hinge"
    assert (force.unit, force.coordinate_unit, force.load_unit) == ("N m", "rad", "N m")
    assert force.share > 0.95
    assert correlation(force, law) > 0.8
    assert [len(values) for values in force.force] == [len(values) for values in force.time_s]
    assert len(force.load) == len(force.force)


def test_without_recalibration_the_force_is_the_hidden_one_in_size_too():
    effect = hidden("cubic-stiffness", coefficient=0.4)
    difference = made(
        np.random.default_rng(2),
        [effect],
        frequencies=(0.8, 1.3),
        recalibrate=False,
        sd=np.array([0.003, 0.02]),
    )
    (result,) = missing_forces(difference)
    force, true = np.concatenate(result.force), -0.4 * np.concatenate(result.coordinate) ** 3
    assert np.sqrt(np.mean((force - true) ** 2)) < 0.15 * np.sqrt(np.mean(true**2))


def test_where_nothing_is_missing_no_force_is_shown():
    assert missing_forces(made(np.random.default_rng(3), frequencies=(0.8, 1.3))) == ()


def test_repeats_that_begin_differently_each_have_their_own_force():
    model = parse_model(
        """
name = "swing"
states = ["angle", "rate"]
[parameters]
k = { value = 40.0, tolerance = 0.02 }
[equations]
angle = "rate"
rate = "force.pin - k*sin(angle)"
[outputs]
angle = { equation = "angle", unit = "rad" }
[sites.pin]
kind = "joint"
coordinate = "angle"
rate = "rate"
[initial]
angle = "start"
rate = 0.0
""",
        "swing.toml",
    )
    from labrun.models import simulate

    rng = np.random.default_rng(4)
    trials = []
    for number, start in enumerate((0.4, 0.7)):
        time_s = np.linspace(0, 3, 150)
        damping = load_effect("viscous-damping", "joint").attach("pin", coefficient=0.3)
        truth = simulate(
            model, time_s, np.empty((150, 0)), initial_state=[start, 0.0], effects=[damping], substeps=8
        )
        for repeat in range(3):
            outputs = truth.outputs + 0.005 * rng.standard_normal(truth.outputs.shape)
            trials.append(
                FitTrial(str(number), {"start": start}, repeat, time_s, np.empty((150, 0)), outputs)
            )
    (result,) = missing_forces(compared(model, trials, recalibrate=False))
    rate, force = np.concatenate(result.rate), np.concatenate(result.force)
    assert result.share > 0.95
    assert float(rate @ force / (rate @ rate)) == pytest.approx(-0.3, abs=0.05)
    assert result.load == ()


def test_models_without_sites_lack_no_force():
    model = parse_model(
        'name = "line"\ninputs = ["u"]\n[parameters]\ngain = 1.0\n[outputs]\ny = "gain*u"', "line.toml"
    )
    time_s = np.linspace(0, 1, 50)
    trials = [FitTrial("a", {}, r, time_s, time_s[:, None], time_s[:, None] ** 2) for r in range(3)]
    assert missing_forces(compared(model, trials)) == ()
