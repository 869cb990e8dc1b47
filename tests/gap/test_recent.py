"""Candidates at outputs share one simulation, and are what they would be without sharing."""

from dataclasses import dataclass, field

import numpy as np
import pytest

from labrun.effects import load_effect
from labrun.fit.simulations import Simulations
from labrun.gap.averaging import averaged
from labrun.gap.candidates import site_scales
from labrun.gap.recalibration import stated_problem
from labrun.models import Unfiltered, filtered, prepare, simulate, simulate_unfiltered

from .benches import TRUE, pendulum, recorded

TIME_S = np.arange(200) / 100.0
TORQUE = (0.03 * np.sin(2 * np.pi * 0.9 * TIME_S))[:, None]
INSIDE = [
    load_effect("coulomb-friction", "joint").attach("hinge", torque=0.004),
    load_effect("lag", "input").attach("torque", time_constant=0.02),
]
SHOWN = [
    load_effect("delay", "output").attach("angle", delay=0.013),
    load_effect("lag", "output").attach("angle", time_constant=0.03),
    load_effect("drift", "output").attach("angle", slope=0.01),
]


@pytest.mark.parametrize("substeps", [1, 2, 3, 4])
@pytest.mark.parametrize("inside", [[], INSIDE], ids=["plain", "with effects inside"])
def test_a_simulation_made_in_two_parts_is_the_whole_one(substeps, inside):
    model = pendulum()
    driven = prepare(model, TIME_S, TORQUE, substeps)
    before = simulate_unfiltered(model, driven, parameters=TRUE, initial_state=[0.1, 0.0], effects=inside)
    for effects in ([effect] for effect in SHOWN):
        whole = simulate(
            model, TIME_S, driven, parameters=TRUE, initial_state=[0.1, 0.0], effects=[*inside, *effects]
        )
        parts = filtered(model, before, [*inside, *effects])
        np.testing.assert_array_equal(parts.outputs, whole.outputs)
        np.testing.assert_array_equal(parts.states, whole.states)


def test_what_blows_up_inside_is_not_finite_behind_its_outputs_either():
    model = pendulum()
    driven = prepare(model, TIME_S, TORQUE, 1)
    wild = {**TRUE, "damping": -1e3}
    before = simulate_unfiltered(model, driven, parameters=wild, initial_state=[0.1, 0.0])
    assert not filtered(model, before, SHOWN[:1]).finite


def test_candidates_at_an_output_share_one_simulation_per_unit(monkeypatch):
    dataset = recorded(conditions=((0.02, 0.6), (0.03, 0.9)), repeats=1)
    problem = stated_problem(pendulum(), averaged(dataset, pendulum()))
    z = problem.priors.stated
    scale = site_scales(problem, z)["output", "angle"]
    made = []
    simulated = simulate_unfiltered
    monkeypatch.setattr(
        "labrun.fit.problem.simulate_unfiltered",
        lambda *given, **named: made.append(1) or simulated(*given, **named),
    )
    for effect in SHOWN:
        at_output = problem.with_effects([effect], [scale])
        sizes = [
            value / scale.of(p.quantity)
            for value, p in zip(effect.values, effect.effect.parameters, strict=True)
        ]
        outputs = at_output.simulated(np.concatenate([z, sizes]))
        for index, trial in enumerate(problem.data.trials):
            alone = simulate(
                problem.model,
                trial.time_s,
                problem.drives[index],
                parameters=problem.model_parameters(z),
                condition=trial.condition,
                effects=at_output.attached(at_output.parameters(np.concatenate([z, sizes]))),
            )
            np.testing.assert_array_equal(outputs[index], alone.outputs)
    assert len(made) == len(problem.data.trials)


@dataclass
class Maker:
    """Makes something of a size, and counts how often."""

    bytes: int
    made: list[int] = field(default_factory=list)

    def __call__(self) -> Unfiltered:
        self.made.append(1)
        return Unfiltered(None, np.empty(self.bytes // 8), np.empty((1, 1)), 0, 1)


def test_what_was_used_last_is_kept_and_memory_stays_bounded():
    kept, often = Simulations(), Maker(60_000_000)
    kept.get("often", often)
    for number in range(5):
        kept.get(number, Maker(60_000_000))
        kept.get("often", often)
    assert len(often.made) == 1
    again = Maker(60_000_000)
    kept.get(0, again)
    assert len(again.made) == 1  # it had given way
