"""What is told as a rival of a cause."""

from types import SimpleNamespace

import numpy as np
import pytest
from labrun.gap.rating import least_to_remove, more_common, preferred, rivals_of

from labrun.effects import Scale, load_effect
from labrun.gap.diagnosis import Name
from labrun.gap.held_out import ExcessResidual

SCALE = Scale(coordinate=1.0, rate=1.0, acceleration=1.0, force=1.0, signal=1.0, time_s=1.0)


def rated(effect: str, score: float):
    attached = load_effect(effect, "joint").attach("strip", SCALE)
    candidate = SimpleNamespace(name=Name(kind="effect", effect=effect, site="strip"), attached=attached)
    return SimpleNamespace(candidate=candidate, score=score, evidence=5.0, share=0.95, left=0.05)


def names(best, others):
    return [one.candidate.name.effect for one, _ in rivals_of(best, [best, *others], relative=False)[0]]


def test_two_forms_that_contain_each_other_are_rivals_whichever_fits_better():
    # pulled one way only, a strip does not tell how a force with a memory would turn round
    for first, second in (("presliding-friction", "hysteresis"), ("hysteresis", "presliding-friction")):
        assert names(rated(first, 50.0), [rated(second, 40.0)]) == [second]


def test_a_richer_form_that_earns_nothing_is_the_best_again_and_no_rival():
    assert names(rated("coulomb-friction", 50.0), [rated("hysteresis", 49.5)]) == []


def test_a_richer_form_of_a_rival_that_earns_nothing_is_that_rival_again():
    dry, stribeck = rated("coulomb-friction", 48.0), rated("stribeck-friction", 47.5)
    assert names(rated("load-dependent-friction", 50.0), [dry, stribeck]) == ["coulomb-friction"]


def test_a_simpler_form_that_does_nearly_as_well_is_the_kin_that_is_told():
    # dry friction that yields 2.5 mrad first: a person mends it by the friction their simulator has
    best, bouc_wen = rated("presliding-friction", 900.0), rated("hysteresis", 600.0)
    dry = SimpleNamespace(**{**vars(rated("coulomb-friction", 200.0)), "share": 0.9})
    assert names(best, [bouc_wen, dry]) == ["coulomb-friction"]
    dry.share = 0.8
    assert names(best, [bouc_wen, dry]) == ["hysteresis"]


def test_of_what_is_the_same_to_the_data_the_most_common_is_named_and_the_next_told_first():
    # a tensile test at one speed: an offset of the force, wherever it comes from, is an offset
    rest, pull, damping = (
        rated("rest-offset", 534788.4),
        rated("constant-force", 534787.9),
        rated("viscous-damping", 534761.1),
    )
    for best in (rest, pull):
        assert more_common(best, [rest, pull, damping], relative=False) is pull
    assert names(pull, [rest, damping]) == ["rest-offset", "viscous-damping"]


def test_a_gears_efficiency_and_friction_under_load_are_told_beside_each_other():
    level, gear = rated("load-dependent-friction", 1330.0), rated("gear-efficiency", 1471.0)
    assert names(gear, [level]) == ["load-dependent-friction"]
    assert names(level, [gear]) == ["gear-efficiency"]


def test_the_common_form_that_withheld_conditions_put_beside_a_better_fit_weighs_as_much_there():
    # six motions of a servo that sticks: play gains more, and leaves no less of any motion that was withheld
    def seen(effect: str, score: float, left: float):
        values = left * np.random.default_rng(int(left)).uniform(0.9, 1.1, (6, 1))
        held_out = ExcessResidual(values, np.full(6, 1 / 6), ())
        return SimpleNamespace(**{**vars(rated(effect, score)), "held_out": held_out})

    friction, play = seen("coulomb-friction", 58.0, 62.0), seen("backlash", 68.0, 69.0)
    ((rival, weight),), own = rivals_of(friction, [play, friction], relative=True)
    assert rival is play
    assert own == pytest.approx(0.5, abs=0.05)
    assert own + weight == pytest.approx(1.0)


def excess(total: float) -> ExcessResidual:
    return ExcessResidual(np.array([[total]]), np.ones(1), ())


def test_a_second_cause_may_be_half_of_what_the_first_leaves_and_a_third_may_not():
    whole, left = excess(900.0), excess(63.0)
    assert least_to_remove(left, whole) == pytest.approx(0.04 * 900 / 63)
    assert least_to_remove(left, whole, beside=2) == pytest.approx(0.8)


def test_however_little_of_the_whole_is_left_what_removes_nearly_all_of_it_is_a_cause():
    assert least_to_remove(excess(250.0), excess(1.2e6)) == pytest.approx(0.8)
    assert least_to_remove(excess(0.5), excess(1.2e6)) > 1.0  # no more than a sensor's noise


def test_of_what_disturbances_leave_a_second_cause_has_to_remove_what_can_be_learned():
    left, whole = excess(10.0), excess(100.0)
    assert least_to_remove(left, whole) == pytest.approx(0.5)
    assert least_to_remove(left, whole, learnable=0.3) == pytest.approx(0.24)
    assert least_to_remove(left, whole, learnable=0.05) == pytest.approx(0.5)  # no more than a sensor's noise
    assert least_to_remove(left, whole, beside=2, learnable=0.3) == pytest.approx(0.8)


def test_with_repeats_a_second_cause_may_be_whatever_is_plainly_left():
    left, whole = excess(0.6**2), excess(200.0)
    assert least_to_remove(left, whole, small=0.37) == pytest.approx(0.8)
    assert least_to_remove(left, whole, beside=2, small=0.37) > 1.0  # a third one mends what forms leave


def test_without_repeats_one_condition_where_all_fail_does_not_outvote_the_others():
    # a spring that hardens, and a stop that stands in for it; the second condition has a resonance of its own
    spring, stop = rated("cubic-stiffness", 240.0), rated("end-stop", 175.0)
    for one, share, left in (
        (spring, 0.72, [9, 13200, 12, 90, 4, 110, 5]),
        (stop, 0.83, [32, 7300, 225, 160, 15, 83, 92]),
    ):
        one.share, one.conditions, one.candidate.variables = share, 6.9, 1
        one.held_out = ExcessResidual(np.array(left, dtype=float)[:, None], np.full(7, 1 / 7), ())
    before = ExcessResidual(np.full((7, 1), 5700.0), np.full(7, 1 / 7), ())
    assert preferred([spring, stop], before, relative=True) is spring
    assert preferred([spring, stop], before, relative=False) is stop


def test_without_repeats_a_richer_form_that_leaves_half_as_much_in_every_condition_is_no_less_probable():
    # Stribeck friction beside a bias: 99.3 % of the gap, and 98.3 % by dry friction
    simple, rich = rated("coulomb-friction", 264.6), rated("stribeck-friction", 268.1)

    def weight(ratios):
        left = np.array([0.04, 0.1, 0.06, 0.07, 0.05, 0.09])
        for one, values in ((rich, left), (simple, left * ratios)):
            one.held_out = ExcessResidual(values[:, None], np.full(6, 1 / 6), ())
        ((rival, weight),) = rivals_of(simple, [simple, rich], relative=True)[0]
        assert rival is rich
        return weight

    assert weight(np.array([2.4, 2.0, 2.6, 2.2, 2.5, 2.3])) > 0.5
    assert weight(np.array([1.0, 1.1, 0.9, 1.05, 0.95, 1.0])) == 0.0  # told as its kin only
