"""The generator's own physics, against closed forms and against scipy."""

import numpy as np
import pytest
from labrun_plugins.cases.bench import Bench, Drive
from labrun_plugins.cases.forms import FORMS
from labrun_plugins.cases.mixture import DECK, ChannelNoise, choose, kind_of, places
from labrun_plugins.cases.plant import Hidden, Measures, Programme
from labrun_plugins.cases.plants import PLANTS, FreeDecay, HingeDrive, LinearStage, Swimmer
from labrun_plugins.cases.simulate import adaptive, fixed
from labrun_plugins.cases.sizing import Projection, Recalibration, measure, size_of
from scipy.integrate import solve_ivp
from scipy.special import ellipk


def drawn(kind, wanted, start=0):
    """Return the first bench of a kind, by its drawing seed, that is as wanted."""
    for seed in range(start, start + 200):
        plant = kind(np.random.default_rng(seed))
        if wanted(plant):
            return plant
    raise LookupError(kind)


def released(plant, angles, length_s=8.0, rate_hz=100):
    time_s = np.arange(round(length_s * rate_hz) + 1) / rate_hz
    conditions = [{"release_rad": angle} for angle in angles]
    return Programme(time_s, conditions, np.zeros((0, len(time_s), len(angles))))


def plain_measures(**changes):
    usual = {
        "q": 1.0, "v": 6.0, "a": 30.0, "force": 1.0, "stiffness": 1.0, "step_s": 0.01, "length_s": 8.0, "period_s": 1.0,
        "other": 1.0, "top": 1.0,
    }  # fmt: skip
    return Measures(**{**usual, **changes})


def test_a_spring_let_go_follows_the_damped_cosine() -> None:
    plant = drawn(FreeDecay, lambda drawn_plant: not drawn_plant.pendulum and "damping" in drawn_plant.truth)
    p = plant.truth
    programme = released(plant, [0.4, -0.2])
    angle = adaptive(Bench(plant, programme, p))[0]
    decay = p["damping"] / (2 * p["inertia"])
    omega = np.sqrt(p["stiffness"] / p["inertia"] - decay**2)
    t = programme.time_s
    expected = np.exp(-decay * t) * (np.cos(omega * t) + decay / omega * np.sin(omega * t))
    assert np.max(np.abs(angle - expected[:, None] * [0.4, -0.2])) < 1e-7


def test_a_pendulum_swings_with_the_period_of_the_elliptic_integral() -> None:
    plant = drawn(FreeDecay, lambda drawn_plant: drawn_plant.pendulum and "damping" not in drawn_plant.truth)
    p = plant.truth
    programme = released(plant, [1.4])
    angle = adaptive(Bench(plant, programme, p))[0, :, 0]
    t = programme.time_s
    down = np.flatnonzero((angle[:-1] > 0) & (angle[1:] <= 0))
    crossings = t[down] + angle[down] / (angle[down] - angle[down + 1]) * (t[1] - t[0])
    period = 4 * ellipk(np.sin(0.7) ** 2) * np.sqrt(p["inertia"] / p["gravity_torque"])
    assert np.mean(np.diff(crossings)) == pytest.approx(period, rel=2e-4)


def test_an_undamped_pendulum_keeps_its_energy() -> None:
    plant = drawn(FreeDecay, lambda drawn_plant: drawn_plant.pendulum and "damping" not in drawn_plant.truth)
    p = plant.truth
    bench = Bench(plant, released(plant, [1.2], length_s=6.0), p)
    angle = adaptive(bench)[0, :, 0]
    rate = np.gradient(angle, bench.time_s, edge_order=2)
    energy = 0.5 * p["inertia"] * rate**2 - p["gravity_torque"] * np.cos(angle)
    # at the turning points the rate is zero whatever way it is found
    turning = np.flatnonzero(rate[:-1] * rate[1:] < 0)
    assert np.ptp(energy[turning]) < 2e-3 * p["gravity_torque"]


def test_a_body_that_coasts_slows_down_hyperbolically() -> None:
    plant = drawn(Swimmer, lambda drawn_plant: "drag" in drawn_plant.truth and not drawn_plant.tether)
    p = plant.truth
    time_s = np.arange(601) / 100
    bench = Bench(plant, Programme(time_s, [{}], np.zeros((1, 601, 1))), p, start=np.array([[0.0], [0.5]]))
    speed = adaptive(bench)[0, :, 0]
    assert speed == pytest.approx(0.5 / (1 + 0.5 * p["drag"] / p["mass"] * time_s), rel=1e-8)


def test_a_stage_under_a_constant_force_reaches_its_terminal_speed() -> None:
    plant = drawn(
        LinearStage,
        lambda drawn_plant: "stiffness" not in drawn_plant.truth and len(drawn_plant.outputs) == 2,
    )
    p = plant.truth
    time_s = np.arange(1001) / 100
    bench = Bench(plant, Programme(time_s, [{}], np.full((1, 1001, 1), 2.0)), p)
    speed = adaptive(bench)[1, :, 0]
    expected = 2.0 / p["damping"] * (1 - np.exp(-p["damping"] / p["mass"] * time_s))
    assert np.max(np.abs(speed - expected)) < 1e-8


@pytest.mark.parametrize(
    "effect", ["coulomb-friction", "asymmetric-friction", "end-stop", "added-inertia", "viscoelastic-creep"]
)
def test_what_is_hidden_is_integrated_as_scipy_does_with_tighter_tolerance(effect: str) -> None:
    plant = drawn(
        HingeDrive,
        lambda drawn_plant: (
            drawn_plant.inputs[0].between == "hold" and drawn_plant.parameters[0].tolerance == 0.0
        ),
    )
    programme = plant.programme(np.random.default_rng(0), 2)
    programme.time_s, programme.inputs = programme.time_s[:100], programme.inputs[:, :100]
    bare = Bench(plant, programme, plant.truth)
    measures = measure(bare, fixed(bare), "joint", "hinge")
    hidden = [Hidden(FORMS["joint", effect]("hinge", measures, np.random.default_rng(1)), 0.3)]
    bench = Bench(plant, programme, plant.truth, hidden)
    outputs = adaptive(bench)
    y = bench.initial()
    shape = y.shape
    worst = 0.0
    for index, (begin, end) in enumerate(zip(programme.time_s[:-1], programme.time_s[1:], strict=True)):
        inside = 0.5 * (begin + end)

        def rates(t, flat, inside=inside):
            return bench.rates(t, flat.reshape(shape), inside).ravel()

        y = (
            solve_ivp(rates, (begin, end), y.ravel(), method="LSODA", rtol=1e-11, atol=1e-13)
            .y[:, -1]
            .reshape(shape)
        )
        worst = max(worst, float(np.max(np.abs(outputs[0, index + 1] - y[0]))))
    assert worst < 2e-6 * float(np.max(np.abs(outputs[0])))


def test_a_delay_shifts_the_signal_by_just_so_much() -> None:
    plant = drawn(
        LinearStage,
        lambda drawn_plant: len(drawn_plant.outputs) == 2 and drawn_plant.inputs[0].between == "linear",
    )
    programme = plant.programme(np.random.default_rng(0), 2)
    delay = FORMS["output", "delay"]("speed_sensor", plain_measures(row=1), np.random.default_rng(0))
    shift = 5 * float(programme.time_s[1])
    plain = adaptive(Bench(plant, programme, plant.truth))
    late = adaptive(Bench(plant, programme, plant.truth, [Hidden(delay, shift)]))
    assert np.allclose(late[0], plain[0], atol=1e-9)
    assert np.max(np.abs(late[1, 5:] - plain[1, :-5])) < 1e-7 * np.max(np.abs(plain[1]))


def test_a_delay_of_the_input_delays_every_output_of_a_linear_bench() -> None:
    plant = drawn(
        LinearStage,
        lambda drawn_plant: (
            "stiffness" in drawn_plant.truth
            and len(drawn_plant.outputs) == 2
            and drawn_plant.inputs[0].between == "hold"
        ),
    )
    programme = plant.programme(np.random.default_rng(0), 2)
    delay = FORMS["input", "delay"]("force", plain_measures(), np.random.default_rng(0))
    shift = 7 * float(programme.time_s[1])
    programme.inputs[:, 0] = 0.0
    plain = adaptive(Bench(plant, programme, plant.truth))
    late = adaptive(Bench(plant, programme, plant.truth, [Hidden(delay, shift)]))
    assert np.max(np.abs(late[:, 7:] - plain[:, :-7])) < 1e-6 * np.max(np.abs(plain))


def test_a_held_input_jumps_at_its_samples_and_a_linear_one_does_not() -> None:
    time_s = np.array([0.0, 0.1, 0.2])
    inputs = np.array([[[1.0], [3.0], [2.0]], [[1.0], [3.0], [2.0]]])
    drive = Drive(time_s, inputs, ["hold", "linear"])
    assert drive.at(0.1, 0.05)[:, 0] == pytest.approx([1.0, 3.0])
    assert drive.at(0.1, 0.15)[:, 0] == pytest.approx([3.0, 3.0])
    assert drive.at(0.15, 0.15)[:, 0] == pytest.approx([3.0, 2.5])
    assert drive.at(-0.3, -0.3)[:, 0] == pytest.approx([1.0, 1.0])
    assert drive.at(0.2, 0.2)[:, 0] == pytest.approx([2.0, 2.0])


def test_added_inertia_slows_a_spring_as_its_formula_says() -> None:
    plant = drawn(
        FreeDecay, lambda drawn_plant: not drawn_plant.pendulum and "damping" not in drawn_plant.truth
    )
    p = plant.truth
    measures = plain_measures(force=p["inertia"] * 30.0, q=1e6)  # a wide stroke: the inertia is even
    extra = FORMS["joint", "added-inertia"]("hinge", measures, np.random.default_rng(0))
    programme = released(plant, [0.3])
    angle = adaptive(Bench(plant, programme, p, [Hidden(extra, 0.4)]))[0, :, 0]
    inertia = p["inertia"] * (1 + 0.4 * (1 + extra.values(0.4)["unevenness"]))
    assert np.max(np.abs(angle - 0.3 * np.cos(np.sqrt(p["stiffness"] / inertia) * programme.time_s))) < 1e-6


@pytest.mark.parametrize("key", list(FORMS), ids=lambda key: "-at-".join(reversed(key)))
def test_every_effect_vanishes_with_its_size_and_grows_with_it(key: tuple[str, str]) -> None:
    kind, _ = key
    for seed in range(400):
        plant = PLANTS[seed % len(PLANTS)](np.random.default_rng(seed))
        fitting = [location for location in places(plant) if location[:2] == key]
        if fitting:
            break
    site = fitting[0][2]
    programme = plant.programme(np.random.default_rng(seed), 2)
    programme.time_s, programme.inputs = programme.time_s[:125], programme.inputs[:, :125]
    bare = Bench(plant, programme, plant.truth)
    plain = fixed(bare)
    mechanism = FORMS[key](site, measure(bare, plain, kind, site), np.random.default_rng(5))
    sd = np.std(plain, axis=(1, 2))
    moved = [
        size_of(
            fixed(Bench(plant, programme, plant.truth, [Hidden(mechanism, share * mechanism.start)])) - plain,
            sd,
        )
        for share in (0.1, 0.4, 1.0)
    ]
    assert moved[0] < moved[1] < moved[2]
    assert moved[0] < 0.3 * moved[2]
    assert np.isfinite(list(mechanism.values(mechanism.start).values())).all()


def test_recalibration_finds_the_truth_of_a_bare_bench() -> None:
    plant = drawn(HingeDrive, lambda drawn_plant: len(drawn_plant.outputs) == 2)
    programme = plant.programme(np.random.default_rng(0), 4)
    truth = fixed(Bench(plant, programme, plant.truth))
    sd = 0.01 * np.std(truth, axis=(1, 2))
    stated = {
        parameter.name: parameter.true * (1.2 if parameter.tolerance == "free" else 1.0)
        for parameter in plant.parameters
    }
    left = Recalibration(plant, programme, stated).run(truth, sd)
    assert size_of(left.raw, sd) > 1
    assert size_of(left.residual, sd) < 1e-2
    for name, value in left.parameters.items():
        assert value == pytest.approx(plant.truth[name], rel=1e-3)


def test_what_only_shifts_an_output_leaves_no_gap_where_every_trial_has_a_zero_of_its_own() -> None:
    plant = drawn(HingeDrive, lambda drawn_plant: len(drawn_plant.outputs) == 2)
    programme = plant.programme(np.random.default_rng(0), 4)
    plain = fixed(Bench(plant, programme, plant.truth))
    sd = 0.01 * np.std(plain, axis=(1, 2))
    shifted = plain + (5.0 * sd)[:, None, None]
    alike, apart = (Projection(plant, programme, plant.truth, sd, zeros=zeros) for zeros in (True, False))
    assert alike.left(shifted) < 1e-9
    assert apart.left(shifted) > 1.0
    left = Recalibration(plant, programme, plant.truth, zeros=True).run(shifted, sd)
    assert size_of(left.residual, sd) < 1e-2


@pytest.mark.parametrize("colour", ["white", "ar1", "counts"])
def test_noise_has_the_standard_deviation_it_says(colour: str) -> None:
    rng = np.random.default_rng(0)
    signal = np.sin(np.arange(40000) / 50)
    noise = ChannelNoise(colour, 0.02, 0.8 if colour == "ar1" else 0.0, 0.0)
    error = noise.apply(signal, rng) - signal
    assert np.std(error) == pytest.approx(0.02, rel=0.05)
    expected = 0.8 if colour == "ar1" else 0.0
    assert np.corrcoef(error[1:], error[:-1])[0, 1] == pytest.approx(expected, abs=0.05)


def test_every_sixty_cases_have_the_mixture_that_is_told() -> None:
    for block in (0, 3):
        kinds = [kind_of(5, 60 * block + index) for index in range(60)]
        assert {kind: kinds.count(kind) for kind in DECK} == DECK
    assert [kind_of(5, index) for index in range(60)] != [kind_of(6, index) for index in range(60)]
    assert DECK["control"] / 60 == pytest.approx(1 / 3)
    assert DECK["outside"] / 60 > 0.1


def test_every_effect_of_the_library_comes_up() -> None:
    rng = np.random.default_rng(0)
    seen = {choose("effect", rng).hidden[0][:2] for _ in range(600)}
    assert seen == set(FORMS)
