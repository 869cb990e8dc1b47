import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from rig import named

from labrun.models import parse_model, simulate

THROUGH = parse_model('name = "wire"\ninputs = ["u", "w"]\n[outputs]\ny = "u"\nz = "w"', "wire.toml")
TIME = np.linspace(0, 4, 201)
WAVE = np.column_stack([np.sin(5 * TIME), np.cos(3 * TIME)])


def _through(effect, between="linear", substeps=4, wave=WAVE):
    model = THROUGH.with_between({"u": between})
    return simulate(model, TIME, wave, effects=[effect], substeps=substeps).outputs[:, 0]


@pytest.mark.parametrize(("kind", "site"), [("input", "u"), ("output", "y")])
@settings(max_examples=25, deadline=None)
@given(delay=st.floats(0.0, 1.5))
def test_a_delay_is_the_signal_some_time_ago(kind, site, delay):
    late = _through(named("delay", kind, site, delay=delay))
    # a static model gives its output at the samples, between which it is straight
    exact = np.interp(TIME - delay, TIME, WAVE[:, 0])
    tolerance = 1e-9 if kind == "input" else 0.02
    assert late == pytest.approx(exact, abs=tolerance)


@settings(max_examples=25, deadline=None)
@given(lead=st.floats(0.0, 0.1), substeps=st.integers(1, 4))
def test_an_early_clock_shows_what_the_output_is_that_much_later(lead, substeps):
    model = SUMMED.with_between({"u": "linear"})
    start = np.array([-1.0 / 5.0])
    effect = named("early-clock", "output", "y", lead=lead)
    wave = WAVE[:, :1]
    early = simulate(model, TIME, wave, effects=[effect], substeps=substeps, initial_state=start).outputs[
        :, 0
    ]
    inside = TIME + lead < TIME[-1]
    # the integral of sin 5t, of which the input is straight between samples; steps are straight as well
    assert early[inside] == pytest.approx(-np.cos(5 * (TIME + lead))[inside] / 5, abs=1e-3)
    last = (early[-1] - early[-3]) / (TIME[-1] - TIME[-3]) if lead >= 0.04 else np.sin(5 * TIME[-1])
    assert last == pytest.approx(np.sin(5 * TIME[-1]), abs=0.06), "beyond the end it goes on straight"


@given(lead=st.floats(0.0, 0.1), substeps=st.integers(1, 4))
@settings(max_examples=25, deadline=None)
def test_a_held_signal_may_be_stamped_late_by_a_part_of_a_step(lead, substeps):
    held = np.where(TIME >= 1.0, 1.0, 0.0)
    result = _summed(named("late-clock", "input", "u", lead=lead), held, substeps)
    tolerance = 1e-9 if substeps == 1 else 0.02 / 30  # as for a delay
    assert result == pytest.approx(TIME[-1] - 1.0 + lead, abs=tolerance)


TWICE = parse_model(
    """
name = "twice"
states = ["x", "v"]
[inputs]
u = { unit = "1", between = "hold" }
[parameters]
none = { value = 0.0, tolerance = 0.0 }
[equations]
x = "v"
v = "u + none"
[outputs]
x = { equation = "x", unit = "1" }
[initial]
x = 0.0
v = 0.0
""",
    "twice",
)


@given(lead=st.floats(0.0, 0.1), jump_s=st.sampled_from([0.5, 1.0, 1.5]))
@settings(max_examples=25, deadline=None)
def test_a_jump_within_a_step_pushes_a_mass_as_far_as_it_should(lead, jump_s):
    held = np.where(jump_s - 1e-9 <= TIME, 1.0, 0.0)[:, None]
    late = named("late-clock", "input", "u", lead=lead)
    result = simulate(TWICE, TIME, held, effects=[late], substeps=1, initial_state=[0.0, 0.0]).outputs[:, 0]
    begins = TIME[np.argmax(held[:, 0])] - lead
    assert result == pytest.approx(0.5 * np.maximum(TIME - begins, 0.0) ** 2, abs=1e-9)


@given(lead=st.floats(0.0, 0.1))
@settings(max_examples=25, deadline=None)
def test_a_late_clock_shows_what_the_input_is_that_much_later_and_its_last_value_stands(lead):
    result = _through(named("late-clock", "input", "u", lead=lead))
    assert result == pytest.approx(np.interp(TIME + lead, TIME, WAVE[:, 0]), abs=1e-9)


def test_filters_around_a_late_clock_act_in_their_order():
    late, delay = named("late-clock", "input", "u", lead=0.05), named("delay", "input", "u", delay=0.05)
    bias = named("bias", "input", "u", offset=1.0)
    outputs = simulate(THROUGH, TIME, WAVE, effects=[delay, bias, late], substeps=2).outputs
    inside = TIME[-1] > TIME + 0.05
    assert outputs[inside, 0] == pytest.approx(WAVE[inside, 0] + 1.0, abs=1e-9)
    assert np.array_equal(outputs[:, 1], WAVE[:, 1])


def test_filters_after_an_early_clock_see_what_it_makes():
    early, gain = (
        named("early-clock", "output", "y", lead=0.07),
        named("gain-error", "output", "y", error=1.0),
    )
    clipped = named("saturation", "output", "y", level=0.5)
    alone = simulate(THROUGH, TIME, WAVE, effects=[early], substeps=2).outputs[:, 0]
    both = simulate(THROUGH, TIME, WAVE, effects=[gain, early, clipped], substeps=2).outputs
    assert both[:, 0] == pytest.approx(np.clip(2 * alone, -0.5, 0.5))
    assert np.array_equal(both[:, 1], WAVE[:, 1])


def test_a_delayed_jump_stays_a_jump_to_within_half_a_step():
    held = np.column_stack([np.where(TIME >= 1.0, 1.0, 0.0), TIME])
    late = _through(named("delay", "input", "u", delay=0.1), between="hold", wave=held)
    assert late[TIME < 1.1 - 1e-9] == pytest.approx(0.0)
    assert late[TIME > 1.1 + 1e-9] == pytest.approx(1.0)


SUMMED = parse_model(
    'name = "sum"\nstates = ["x"]\ninputs = ["u"]\n[equations]\nx = "u"\n[outputs]\ny = "x"\n[initial]\nx = 0.0',
    "sum.toml",
)


def _summed(effect, wave, substeps=1):
    """Return what a held signal behind an effect adds up to: an integrator sees every part of every step."""
    model = SUMMED.with_between({"u": "hold"})
    return simulate(model, TIME, wave[:, None], effects=[effect], substeps=substeps).outputs[-1, 0]


@given(delay=st.floats(0.0, 0.5), substeps=st.integers(1, 4))
@settings(max_examples=25, deadline=None)
def test_a_held_signal_may_be_late_by_a_part_of_a_step(delay, substeps):
    held = np.where(TIME >= 1.0, 1.0, 0.0)
    late = _summed(named("delay", "input", "u", delay=delay), held, substeps)
    # exact with single steps; two that are taken as one weigh their middles by a fifteenth more
    tolerance = 1e-9 if substeps == 1 else 0.02 / 30
    assert late == pytest.approx(TIME[-1] - 1.0 - delay, abs=tolerance)


@given(constant=st.floats(1e-4, 0.3))
@settings(max_examples=25, deadline=None)
def test_a_lag_shorter_than_a_step_is_not_lost(constant):
    held = np.where(TIME >= 1.0, 1.0, 0.0)
    lagging = _summed(named("lag", "input", "u", time_constant=constant), held)
    rest = TIME[-1] - 1.0
    assert lagging == pytest.approx(rest - constant * (1 - np.exp(-rest / constant)), abs=1e-9)


@given(rate=st.floats(0.5, 500.0))
@settings(max_examples=25, deadline=None)
def test_a_limited_rate_within_a_step_is_not_lost(rate):
    held = np.where(TIME >= 1.0, 1.0, 0.0)
    limited = _summed(named("rate-limit", "input", "u", rate=rate), held)
    # exact, but for a ramp that ends just in the middle of a step: Simpson's rule knows no corner there
    assert limited == pytest.approx(TIME[-1] - 1.0 - 0.5 / rate, abs=1e-9 + rate * 0.02**2 / 24)


def test_a_knee_rounds_the_corner_of_a_saturation_and_nothing_else():
    wave = np.column_stack([np.linspace(-2, 2, 201), TIME])
    soft = _through(named("saturation", "input", "u", level=1.0, knee=0.3), wave=wave, substeps=1)
    hard = np.clip(wave[:, 0], -1, 1)
    corner = np.abs(np.abs(wave[:, 0]) - 1.0) < 0.3
    assert soft[~corner] == pytest.approx(hard[~corner], abs=1e-12)
    assert np.all(np.abs(soft[corner]) <= np.abs(hard[corner]))
    assert np.max(np.abs(soft - hard)) == pytest.approx(0.3 / 4)  # where the corner was
    slopes = np.diff(soft) / np.diff(wave[:, 0])
    assert np.all(slopes >= 0)
    assert np.max(np.abs(np.diff(slopes))) < 0.05  # no corner is left


@pytest.mark.parametrize(("kind", "site"), [("input", "u"), ("output", "y")])
def test_a_lag_follows_a_wave_as_a_first_order_filter_does(kind, site):
    tau, omega = 0.2, 5.0
    lagging = _through(named("lag", kind, site, time_constant=tau), substeps=8)
    forced = (np.sin(omega * TIME) - omega * tau * np.cos(omega * TIME)) / (1 + (omega * tau) ** 2)
    exact = forced + omega * tau / (1 + (omega * tau) ** 2) * np.exp(-TIME / tau)
    assert lagging == pytest.approx(exact, abs=2e-3)


def test_a_lag_of_a_step_is_exact():
    held = np.column_stack([np.where(TIME >= 1.0, 1.0, 0.0), TIME])
    lagging = _through(named("lag", "input", "u", time_constant=0.3), between="hold", wave=held, substeps=1)
    start = TIME[np.argmax(TIME >= 1.0)]
    assert lagging == pytest.approx(
        np.where(start <= TIME, 1 - np.exp(-(TIME - start) / 0.3), 0.0), abs=1e-12
    )


@pytest.mark.parametrize(
    ("effect", "change"),
    [
        (named("gain-error", "input", "u", error=0.2), lambda u: 1.2 * u),
        (named("bias", "input", "u", offset=-0.3), lambda u: u - 0.3),
        (named("saturation", "input", "u", level=0.6), lambda u: np.clip(u, -0.6, 0.6)),
        (named("gain-error", "output", "y", error=-0.1), lambda u: 0.9 * u),
        (named("bias", "output", "y", offset=0.3), lambda u: u + 0.3),
        (named("saturation", "output", "y", level=0.6), lambda u: np.clip(u, -0.6, 0.6)),
    ],
    ids=lambda case: getattr(getattr(case, "effect", None), "id", ""),
)
def test_a_filter_without_memory_changes_each_value(effect, change):
    result = simulate(THROUGH, TIME, WAVE, effects=[effect], substeps=2).outputs
    assert result[:, 0] == pytest.approx(change(WAVE[:, 0]), abs=1e-14)
    assert np.array_equal(result[:, 1], WAVE[:, 1])


def test_filters_of_one_signal_act_in_their_order():
    gain, offset = named("gain-error", "input", "u", error=1.0), named("bias", "input", "u", offset=1.0)
    first = simulate(THROUGH, TIME, WAVE, effects=[gain, offset], substeps=1).outputs[:, 0]
    second = simulate(THROUGH, TIME, WAVE, effects=[offset, gain], substeps=1).outputs[:, 0]
    assert first == pytest.approx(2 * WAVE[:, 0] + 1)
    assert second == pytest.approx(2 * (WAVE[:, 0] + 1))


def test_a_single_sample_is_filtered_too():
    simulated = simulate(
        THROUGH, np.zeros(1), np.ones((1, 2)), effects=[named("bias", "input", "u", offset=0.5)], substeps=1
    )
    assert simulated.outputs[0] == pytest.approx([1.5, 1.0])
    early = named("early-clock", "output", "y", lead=0.1)
    assert simulate(THROUGH, np.zeros(1), np.ones((1, 2)), effects=[early], substeps=1).outputs[
        0
    ] == pytest.approx(1.0)


def test_uneven_sampling_does_not_disturb_a_delay():
    rng = np.random.default_rng(5)
    time_s = np.concatenate([[0.0], np.cumsum(rng.uniform(0.001, 0.05, 300))])
    wave = np.column_stack([np.sin(3 * time_s), time_s])
    late = simulate(
        THROUGH, time_s, wave, effects=[named("delay", "input", "u", delay=0.4)], substeps=2
    ).outputs[:, 0]
    assert late == pytest.approx(np.interp(time_s - 0.4, time_s, wave[:, 0]), abs=1e-9)
