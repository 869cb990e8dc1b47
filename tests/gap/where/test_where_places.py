import numpy as np
import pytest
from scipy.stats import binom
from where_cases import made, replace, share_of

from labrun.effects import load_effect
from labrun.gap.where import find_places
from labrun.gap.where.parts import channel_text


@pytest.mark.parametrize(
    ("name", "message"),
    [("torque_y", "the torque y"), ("angle", "the angle"), ("phi", "phi"), ("theta_2", "theta 2")],
)
def test_a_word_is_said_with_its_article_and_a_symbol_without(name, message):
    assert channel_text(name) == message


def attached(name, kind="joint", site="hinge", **values):
    return load_effect(name, kind).attach(site, **values)


FRICTION = attached("coulomb-friction", torque=0.03, transition_speed=0.02)
CUBIC = attached("cubic-stiffness", coefficient=0.4)


def places_of(difference, seed=0, draws=60, note=lambda _: None):
    return find_places(difference, np.random.default_rng(seed), draws=draws, note=note)


def by(places, kind):
    return [location for location in places if location.by == kind and " | " not in location.at]


def test_what_happens_only_around_reversals_is_found_there():
    def knock(time_s, truth):
        """An output that is wrong within 50 ms of each reversal, whatever the model says of dynamics."""
        turns = time_s[:-1][np.diff(np.sign(truth[:, 1])) != 0]
        near = np.abs(time_s[:, None] - turns[None]).min(axis=1) < 0.05
        return truth + np.outer(near, [0.02, 0.0])

    places = places_of(made(np.random.default_rng(2), disturb=knock))
    near = share_of(places, "reversal", "hinge")
    assert near.share > 0.85
    assert near.p < 0.05
    assert near == by(places, "reversal")[0]
    assert share_of(places, "channel", "angle").share == pytest.approx(1.0, abs=0.1)


def test_a_spring_that_hardens_shows_at_the_ends_of_the_travel():
    def harden(_, truth):
        """A sensor that reads too much where the angle is large: no dynamics between cause and place."""
        return truth + np.stack([0.2 * truth[:, 0] ** 5, 0.0 * truth[:, 1]], axis=1)

    places = places_of(
        made(np.random.default_rng(3), disturb=harden, frequencies=(0.8, 1.0), recalibrate=False)
    )
    ends = share_of(places, "state", "hinge: ends of travel")
    assert ends.share > 0.6
    assert ends.p < 0.05
    assert ends == by(places, "state")[0]


@pytest.mark.slow
def test_a_bias_of_an_output_is_placed_in_its_channel_below_the_drive():
    places = places_of(made(np.random.default_rng(4), disturb=lambda _, y: y + np.array([0.02, 0.0])))
    assert share_of(places, "channel", "angle").share == pytest.approx(1.0, abs=0.05)
    assert share_of(places, "frequency", "below the drive").share > 0.9


def test_an_effect_that_is_there_at_two_of_five_frequencies_is_placed_in_those():
    difference = made(np.random.default_rng(5), [FRICTION], effects_at=(0.5, 0.8))
    places = places_of(difference)
    conditions = by(places, "condition")
    assert {condition.at for condition in conditions[:2]} == {"frequency_hz = 0.5", "frequency_hz = 0.8"}
    assert sum(condition.share for condition in conditions[:2]) > 0.9
    assert sum(condition.share for condition in conditions) == pytest.approx(1.0, abs=0.01)


def test_one_stroke_at_some_conditions_is_placed_in_both():
    def late(time_s, truth):
        fast = np.sum(np.diff(np.sign(truth[:, 0])) != 0) > 2.2 * time_s[-1]
        return truth + np.outer(fast * (truth[:, 1] < 0), [0.03, 0.0])

    difference = made(np.random.default_rng(6), disturb=late, recalibrate=False)
    places = places_of(difference)
    assert share_of(places, "phase", "recovery stroke").share > 0.9
    fast = [f"recovery stroke | frequency_hz = {frequency}" for frequency in (1.3, 1.6)]
    assert sum(share_of(places, "phase", at).share for at in fast) > 0.9
    assert all(share_of(places, "phase", at).p < 0.05 for at in fast)


def test_parts_of_each_way_of_dividing_add_up_to_the_whole():
    places = places_of(made(np.random.default_rng(7), [CUBIC]))
    strokes = [share_of(places, "phase", f"{name} stroke").share for name in ("forward", "recovery")]
    assert sum(location.share for location in by(places, "channel")) == pytest.approx(1.0)
    assert sum(strokes) == pytest.approx(1.0)
    assert sum(location.share for location in by(places, "frequency")) == pytest.approx(1.0)
    assert sum(
        location.share for location in places if location.at.startswith("recovery stroke | ")
    ) == pytest.approx(strokes[1])


@pytest.mark.parametrize("repeats", [2, 5])
def test_noise_alone_is_announced_nowhere_more_often_than_chance_allows(repeats):
    seeds = 25
    alarms = []
    for seed in range(seeds):
        rng = np.random.default_rng(seed)
        difference = made(rng, frequencies=(0.8, 1.3), repeats=repeats, seconds=3.0, rate_hz=40.0)
        places = places_of(difference, seed, draws=40)
        alarms.append(min(location.p for location in places) <= 0.05)
    assert sum(alarms) <= binom.ppf(0.999, seeds, 0.05)


def test_noise_alone_gives_no_shares_and_says_so():
    messages = []
    difference = made(np.random.default_rng(11))
    places = places_of(difference, note=messages.append)
    assert all(location.share == 0.0 and location.p > 0.05 for location in places)
    assert any("nothing to place" in message for message in messages)


def test_without_repeats_shares_are_told_with_the_reservation_that_goes_with_it():
    messages = []
    difference = made(np.random.default_rng(12), [FRICTION], repeats=1, effects_at=(0.5, 0.8))
    assert difference.noise.basis == "residual"
    places = places_of(difference, note=messages.append)
    assert any("Nothing was repeated" in message for message in messages)
    assert {location.at for location in by(places, "condition")[:2]} == {
        "frequency_hz = 0.5",
        "frequency_hz = 0.8",
    }
    assert all(location.p is None for location in by(places, "channel"))


def test_the_same_seed_gives_the_same_places():
    difference = made(np.random.default_rng(13), [FRICTION], frequencies=(0.5, 1.0))
    assert places_of(difference, 3) == places_of(difference, 3)


def test_what_recalibration_takes_out_of_noise_is_not_expected_back():
    """With as many free directions as numbers nothing can be left, and noise must not be expected to leave anything."""
    from labrun.gap.where.significance import NuisanceSubspace

    difference = made(np.random.default_rng(14), frequencies=(1.0,), seconds=0.5, rate_hz=40.0)
    size = difference.residual[0].size
    everything = NuisanceSubspace(replace(difference, jacobian=np.eye(size)))
    noise = [np.random.default_rng(0).standard_normal(difference.residual[0].shape)]
    assert everything.rank == size
    assert np.max(np.abs(everything.left(noise)[0])) < 1e-9
    some = NuisanceSubspace(difference)
    once = some.left(noise)
    assert some.rank == 3
    assert np.allclose(some.left(once)[0], once[0])


def test_a_band_of_frequencies_makes_up_at_least_the_power_that_the_signal_has_there():
    places = places_of(made(np.random.default_rng(5)), draws=5)
    parts = {location.at: location.part for location in places if location.by == "frequency"}
    assert parts["at the drive"] > 0.9  # a sine
    assert all(0.0 <= part <= 1.0 for part in parts.values())
