"""Bodies on hinges with a loop: against closed forms, energy, MuJoCo, and what can be wrong with a file."""

import pickle

import numpy as np
import pytest
from chains import PARALLELOGRAM, PENDULUMS
from scipy.special import ellipk

from labrun.effects import load_effect
from labrun.errors import ModelError
from labrun.models import ClosedChain, Stepper, load_model, parse_model, simulate

TIME_S = np.linspace(0.0, 1.5, 301)
NOTHING = np.empty((len(TIME_S), 0))
SIX_BAR = [f"theta_{number}" for number in range(1, 7)]
TABLE_3_3_SIMULATED = [0.280, 0.056, 0.431, -0.470, -0.157, -0.193]


@pytest.fixture(scope="module")
def parallelogram():
    return parse_model(PARALLELOGRAM, "parallelogram.toml")


@pytest.fixture(scope="module")
def six_bar():
    return load_model("six-bar")


def accelerations(model, state, force=None):
    p, out = model.vector(None, {}), np.zeros(len(state))
    force = np.zeros(len(model.sites)) if force is None else force
    model.derivative.python(0.0, np.array(state), np.zeros(len(model.inputs)), p, force, out)
    return out[len(state) // 2 :]


def from_outside(model, angles):
    """Angles by name, in the order of the model's joints."""
    return np.array([angles[name] for name in model.tree.joints])


def test_a_parallelogram_swings_as_one_pendulum(parallelogram):
    result = simulate(parallelogram, TIME_S, NOTHING, substeps=4)
    pull = 9.81 * 0.2 * (0.5 + 2 * 0.1 / 2)
    inertia = 2 * (3e-4 + 0.1 * 0.1**2) + 0.5 * 0.2**2
    period = 4 * ellipk(np.sin(0.3) ** 2) / np.sqrt(pull / inertia)
    left = result.outputs[:, 0]
    falls = np.flatnonzero((left[:-1] > 0) & (left[1:] <= 0))
    crossings = TIME_S[falls] - left[falls] * np.diff(TIME_S)[falls] / np.diff(left)[falls]
    assert np.diff(crossings).mean() == pytest.approx(period, rel=1e-4)
    count = len(parallelogram.tree.joints)
    angles = dict(zip(parallelogram.tree.joints, result.states[:, :count].T, strict=True))
    np.testing.assert_allclose(angles["right"], angles["left"], atol=1e-7)
    np.testing.assert_allclose(angles["pin"], -angles["left"], atol=1e-7)


def test_energy_stays_and_the_loop_stays_closed(parallelogram):
    outputs = simulate(parallelogram, TIME_S, NOTHING, substeps=4).outputs
    moved = 9.81 * 0.2 * 0.6 * (1 - np.cos(0.6))
    assert np.ptp(outputs[:, 2]) < 1e-6 * moved
    assert outputs[:, 1].max() < 1e-7


@pytest.mark.slow
def test_finer_steps_keep_the_energy_of_the_six_bar_better(six_bar):
    model = six_bar.with_initial({"theta_5": 0.3})
    time_s = np.linspace(0, 1, 361)
    drift = []
    for substeps in (2, 4):
        start = model.initial_state({})
        result = simulate(
            model,
            time_s,
            np.empty((361, 0)),
            parameters={"damping": 0.0},
            initial_state=start,
            substeps=substeps,
        )
        energies = [energy(six_bar, state) for state in result.states[::10]]
        drift.append(np.ptp(energies))
    assert drift[1] < 1e-8
    assert drift[1] < drift[0] / 8


def energy(model, state):
    from labrun.models.chains.dynamics import measures

    out = np.zeros(4)
    measures(model.tree.array, model.numbers(), state, out)
    return out[2] + out[3]


def test_a_tree_without_a_loop_accelerates_as_in_mujoco(tmp_path):
    mujoco = pytest.importorskip("mujoco")
    native = mujoco.MjModel.from_xml_string("""
    <mujoco><option gravity="0 0 -9.81"/><worldbody><body name="upper">
      <joint axis="0 1 0"/>
      <inertial pos="0.02 0 -0.1" mass="0.4" fullinertia="2e-3 3e-3 4e-3 2e-4 -1e-4 3e-4"/>
      <body name="lower" pos="0 0 -0.25">
        <joint axis="1 0.5 0" stiffness="0.5" damping="0.01" springref="5.729577951308232"/>
        <inertial pos="0 0.01 -0.1" mass="0.3" diaginertia="1e-3 1e-3 5e-4"/></body>
    </body></worldbody></mujoco>""")
    data = mujoco.MjData(native)
    model = parse_model(PENDULUMS, "pendulums.toml")
    for state in ([0.3, -0.4, 0.0, 0.0], [1.0, 0.7, 3.0, -5.0]):
        data.qpos[:], data.qvel[:] = state[:2], state[2:]
        mujoco.mj_forward(native, data)
        np.testing.assert_allclose(accelerations(model, state), data.qacc, rtol=1e-9)


def test_inputs_push_where_a_torque_names_them():
    model = parse_model(PENDULUMS, "pendulums.toml")
    pushed = simulate(model, TIME_S[:3], np.full((3, 1), 0.2), initial_state=np.zeros(4), substeps=1)
    by_force = np.zeros(4)
    p, force = model.vector(None, {}), np.array([0.2, 0.0])
    model.derivative.python(0.0, np.zeros(4), np.zeros(1), p, force, by_force)
    step = TIME_S[1]
    assert pushed.outputs[1, 0] == pytest.approx(0.5 * by_force[2] * step**2, rel=0.02)


def six_bar_mjcf(model):
    """The same linkage in MuJoCo: the closing body twice, held together at three points by `connect`."""
    from labrun.models.chains.geometry import FIRST_JOINT, PER_JOINT

    values, tree = model.numbers(), model.tree
    made = {}
    for index, joint in enumerate(tree.joints):
        row = values[FIRST_JOINT + PER_JOINT * index :][:PER_JOINT]
        share = 0.5 if index in (tree.first, tree.second) else 1.0
        text = " ".join
        inertia = text(f"{share * value:.17g}" for value in row[20:26])
        made[index] = (
            f'<body name="b{index}"><joint name="{joint}" axis="{text(f"{value:.17g}" for value in row[:3])}" '
            f'stiffness="{row[12]:.17g}" damping="{row[13]:.17g}"/><inertial mass="{share * row[16]:.17g}" '
            f'pos="{text(f"{value:.17g}" for value in row[17:20])}" fullinertia="{inertia}"/>'
        )

    def nested(parent):
        children = [k for k, above in enumerate(tree.parents) if above == parent]
        return "".join(made[k] + nested(k) + "</body>" for k in children)

    points = ("0.1 0 0", "0 0.1 0", "0 0 0.1")
    connects = "".join(
        f'<connect body1="b{tree.first}" body2="b{tree.second}" anchor="{point}" solref="-250000 -1000" '
        'solimp="0.9999 0.9999 0.001"/>'
        for point in points
    )
    gravity = " ".join(f"{value:.17g}" for value in values[:3])
    return (
        f'<mujoco><option gravity="{gravity}" timestep="1e-4" tolerance="1e-14" iterations="200">'
        '<flag refsafe="disable"/></option>'
        f'<compiler autolimits="true"/><worldbody>{nested(-1)}</worldbody><equality>{connects}</equality></mujoco>'
    )


@pytest.mark.slow
def test_the_six_bar_swings_as_in_mujoco_with_connects(six_bar):
    mujoco = pytest.importorskip("mujoco")
    native = mujoco.MjModel.from_xml_string(six_bar_mjcf(six_bar))
    data = mujoco.MjData(native)
    start = six_bar.with_initial({"theta_5": 0.1}).initial_state({})
    order = [native.joint(name).qposadr[0] for name in six_bar.tree.joints]
    data.qpos[order] = start[:6]
    time_s = np.linspace(0, 0.5, 51)
    theirs = [data.qpos[order].copy()]
    for _ in time_s[1:]:
        for _ in range(100):
            mujoco.mj_step(native, data)
        theirs.append(data.qpos[order].copy())
    ours = simulate(six_bar, time_s, np.empty((51, 0)), initial_state=start, substeps=32).states[:, :6]
    assert np.abs(ours - ours[0]).max() > 0.2
    np.testing.assert_allclose(ours, theirs, atol=1e-3)


def test_the_six_bar_rests_where_the_source_says(six_bar):
    state = six_bar.initial_state({})
    rest = [state[six_bar.states.index(name)] for name in SIX_BAR]
    np.testing.assert_allclose(rest, TABLE_3_3_SIMULATED, atol=0.02)
    assert np.max(six_bar.opening(state[:6])) < 1e-9
    assert np.abs(accelerations(six_bar, state)).max() < 1e-6


def test_a_rough_guess_becomes_a_closed_loop(six_bar):
    rough = six_bar.with_initial(dict(zip(SIX_BAR, ["first"] * 6, strict=True)))
    first = dict(zip(SIX_BAR, np.add(TABLE_3_3_SIMULATED, [0.1, -0.1, 0.1, 0.1, -0.1, 0.1]), strict=True))
    assert np.max(rough.opening(from_outside(rough, first))) > 0.05
    state = rough.initial_state({}, first=first)
    assert np.max(rough.opening(state[:6])) < 1e-9
    assert np.abs(state[:6] - from_outside(rough, first)).max() < 0.3


def test_rates_that_would_tear_the_loop_are_made_to_fit(parallelogram):
    start = parallelogram.with_initial({"left_rate": 1.0}).initial_state({})
    rates = dict(zip(parallelogram.tree.joints, start[4:], strict=True))
    assert rates["right"] == pytest.approx(rates["left"])
    assert rates["left"] > 0.05


def test_an_open_loop_closes_by_itself_while_it_is_stabilised(six_bar):
    state = six_bar.initial_state({})
    state[0] += 0.05
    stepper = Stepper(six_bar, step_s=1e-3, initial_state=state)
    before = np.max(six_bar.opening(stepper.state[:6]))
    stepper.advance(np.empty((301, 0)))
    assert np.max(six_bar.opening(stepper.state[:6])) < 1e-6 * before


def test_a_loop_that_cannot_close_says_how_far_it_stays_open():
    model = parse_model(PARALLELOGRAM.replace("value = 0.3,", "value = 0.9,"), "wide.toml")
    with pytest.raises(
        ModelError, match=r"does not close at joint close: .* coupler stay .* 0\.2"
    ) as problem:
        model.initial_state({})
    assert "left is held by [initial]" in problem.value.hint


def test_a_force_at_a_joint_is_felt_there(six_bar):
    """Power of a force at a joint is the change of energy: the site's coordinate is the joint's own angle."""
    state = six_bar.with_initial({"theta_5_rate": 1.0}).initial_state({})
    rates, still = state[6:], np.zeros(6)
    pushed, free = (
        accelerations(six_bar, state, force) for force in (np.array([0, 0, 1e-3, 0, 0, 0.0]), still)
    )
    stepper_mass = mass_matrix(six_bar, state)
    assert rates @ stepper_mass @ (pushed - free) == pytest.approx(1e-3 * rates[2], rel=1e-6)


def mass_matrix(model, state):
    from labrun.models.chains import starting

    return starting.mass_matrix(model.tree, model.numbers(), state[:6])


def test_friction_at_a_hinge_takes_energy_out(parallelogram):
    free = simulate(parallelogram, TIME_S, NOTHING, substeps=4).outputs[:, 2]
    rubbing = load_effect("coulomb-friction").attach("pin", torque=0.02)
    braked = simulate(parallelogram, TIME_S, NOTHING, substeps=4, effects=[rubbing]).outputs[:, 2]
    assert braked[-1] < free[-1] - 0.01


def test_a_file_on_top_begins_elsewhere(tmp_path):
    (tmp_path / "chain.toml").write_text(PARALLELOGRAM)
    (tmp_path / "other.toml").write_text('base = "chain.toml"\n[initial]\nleft = -0.2\n')
    model = load_model(tmp_path / "other.toml")
    assert isinstance(model, ClosedChain)
    assert dict(zip(model.states, model.initial_state({}), strict=True))["right"] == pytest.approx(-0.2)


def test_a_chain_can_be_pickled(parallelogram):
    again = pickle.loads(pickle.dumps(parallelogram))
    np.testing.assert_array_equal(again.initial_state({}), parallelogram.initial_state({}))


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("fixed = true", "mass_kg = 1", "one body does not move, and says fixed = true; here it is none"),
        ('to = "coupler"\naxis = [0, 1, 0]\nat_m = [0, 0, "-crank"]', 'to = "couplr"\naxis = [0, 1, 0]', "coupler"),
        ('joint = "close"', 'joint = "clos"', "there is no joint 'clos'"),
        ('joint = "close"', 'joint = "pin"\n[joints.a]\nfrom = "right"\nto = "left"\naxis = [0, 1, 0]', "held already"),
        ('[loop]\njoint = "close"', "", "says that it closes the loop"),
        ('from = "right"\nto = "coupler"', 'from = "coupler"\nto = "frame"', "which has no mass to share"),
        ("mass_kg = 0.5\ncenter_m = [\"width/2\", 0, 0]\ninertia_kg_m2 = [1e-5, 4e-3, 4e-3]", "", "neither mass_kg"),
        ('center_m = ["width/2", 0, 0]', 'center_m = ["left/2", 0, 0]', "cannot depend on 'left', which moves"),
        ('"friction"', '"friction + force.left"', "labrun adds the force at every joint"),
        ('left = 0.6', 'lft = 0.6', "there is no state 'lft'"),
        ('left = 0.6', 'left_rate = "rest"', '"rest" is for angles'),
        ("mass_kg = 0.5", "mass_kg = -0.5", "mass_kg = -0.5: -0.5 kg, and a mass is at least 0"),
        ("[1e-5, 4e-3, 4e-3]", "[1e-5, 4e-3, 4e-3, 4e-3]", "has this inertia: about its principal axes it is -"),
        ('axis = [0, 1, 0]\nat_m = [0, 0, "-crank"]', 'axis = [0, "crank - 0.2", 0]', "an axis needs a direction"),
        ("[1e-5, 4e-3, 4e-3]", '["1e-5/(crank - 0.2)", 4e-3, 4e-3]', "bodies.coupler.inertia_kg_m2"),
    ],
)  # fmt: skip
def test_what_does_not_hold_is_told(old, new, message):
    assert old in PARALLELOGRAM
    with pytest.raises(ModelError, match=message.replace("[", r"\[").replace("(", r"\(")):
        parse_model(PARALLELOGRAM.replace(old, new), "chain.toml")


def test_an_axis_that_a_condition_leaves_without_direction_is_told():
    given, tilted = (f'axis = [0, {name}, 0]\nat_m = [0, 0, "-crank"]' for name in ("1", '"tilt"'))
    assert given in PARALLELOGRAM
    model = parse_model(PARALLELOGRAM.replace(given, tilted), "chain.toml")
    assert np.isfinite(model.initial_state({"tilt": 1.0})).all()
    with pytest.raises(ModelError, match="not determined where the bodies of model parallelogram are"):
        model.initial_state({"tilt": 0.0})


def test_a_joint_without_inertia_ends_the_simulation_and_not_the_process():
    text = PENDULUMS.replace("inertia_kg_m2 = [1e-3, 1e-3, 5e-4]", "").replace(
        "center_m = [0, 0.01, -0.35]", "center_m = [0, 0, -0.25]"
    )
    result = simulate(
        parse_model(text, "p.toml"), TIME_S, np.zeros((301, 1)), initial_state=[0.1, 0, 0, 0], substeps=1
    )
    assert not result.finite


def test_a_state_to_begin_in_belongs_to_whoever_asked_for_it(parallelogram):
    first = parallelogram.initial_state({})
    kept = first.copy()
    first[:] = 0.0
    np.testing.assert_array_equal(parallelogram.initial_state({}), kept)
    leaning = parallelogram.with_initial({"left": 0.3})
    assert leaning.initial_state({})[leaning.tree.joints.index("left")] == pytest.approx(0.3)
