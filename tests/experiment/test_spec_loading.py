"""Loading: what holds is an experiment; what does not is told, all of it, where it stands."""

import sys
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from labrun.errors import RequestError, SpecError
from labrun.experiment import load_experiment, loads_experiment
from labrun.gaits import make_gait
from labrun.toml import suggest


def test_a_file_that_holds_is_an_experiment_named_after_the_file(load):
    loaded = load()
    assert loaded.name == "thrust"
    assert loaded.experiment.trial.repeats.min == loaded.experiment.trial.repeats.max == 3
    assert loaded.experiment.goal == ("thrust", "maximise")


def test_the_resolved_text_gives_an_equal_experiment_and_the_same_text_again(load):
    loaded = load(overrides=["trial.repeats=5", "rig.scene.noise=0", "objectives.thrust.scale=-1"])
    again = loads_experiment(loaded.resolved_toml, loaded.name)
    assert again.experiment == loaded.experiment
    assert again.resolved_toml == loaded.resolved_toml
    assert again.experiment.trial.repeats.max == 5


def test_defaults_are_written_out_in_the_resolved_text(load):
    assert "hold_s = 2.0" in load().resolved_toml


def test_a_misspelt_key_is_named_with_line_column_and_the_nearest_key(problems, write):
    (problem,) = problems(("repeats = 3", "repeat = 3"))
    assert (problem.line, problem.column) == (24, 1)
    assert (
        str(problem)
        == f'{write().parent / "thrust.toml"}:24:1: trial.repeat = 3: unknown key; did you mean "repeats"?'
    )


@pytest.mark.parametrize("name", ["w.x", "w/x", ""])
def test_a_device_name_that_its_channels_cannot_carry_is_the_only_problem(problems, name):
    (problem,) = problems(
        ("rig.devices.wrench", f'rig.devices."{name}"'),
        ('channel = "wrench.force_x", timeout', f'channel = "{name}.force_x", timeout'),
        ('channel = "wrench.force_x"', f'channel = "{name}.force_x"'),
    )
    assert problem.line == 12
    assert problem.message == (
        "invalid device name: use letters, digits, '-' and '_'; its channels are named device.channel"
    )


@pytest.mark.parametrize(
    ("old", "new", "key", "says"),
    [
        (
            'amplitude_deg = "a"',
            "amplitude_rad = 1.0",
            "gait.joints.tail.amplitude_rad",
            "write amplitude_deg = 57.2958",
        ),
        (
            "timeout_s = 60",
            "timeout_ms = 60000",
            "trial.settle.timeout_ms",
            "wrong unit ms: timeout is given in s; write timeout_s = 60",
        ),
        (
            "force_n = 300",
            "force_kn = 0.3",
            "rig.devices.wrench.limits.force_kn",
            "wrong unit kN: force is given in N; write force_n = 300",
        ),
        (
            "timeout_s = 60",
            "timeout = 60",
            "trial.settle.timeout",
            "the unit is missing: timeout is given in s; write timeout_s",
        ),
        (
            "speed_deg_s = 528",
            "speed_rad_s = 9",
            "rig.devices.tail.limits.speed_rad_s",
            "write speed_deg_s = 515.662",
        ),
    ],
)
def test_a_wrong_unit_says_which_is_expected_and_what_the_value_would_be(problems, old, new, key, says):
    (problem,) = problems((old, new))
    assert problem.key == key
    assert says in problem.message


@pytest.mark.parametrize(
    ("old", "new", "key", "says"),
    [
        ('"arduino-servo"', '"arduino-srvo"', "rig.devices.tail.plugin", 'did you mean "arduino-servo"?'),
        ('"caudal-tank"', '"caudal-tnk"', "rig.scene", 'did you mean "caudal-tank"?'),
        ('"caudal-tank"', '"arm.xlm"', "rig.scene", "a robot's file ends in .xml, .mjcf, .urdf"),
        ('"sine"', '"sin"', "gait.plugin", 'did you mean "sine"?'),
        ('"cycle-mean"', '"cyclemean"', "objectives.thrust.plugin", 'did you mean "cycle-mean"?'),
        ("joints.tail", "joints.tial", "gait.joints.tial", 'did you mean "tail"?'),
        ('"wrench.force_x", t', '"wrnch.force_x", t', "trial.settle.channel", 'did you mean "wrench.force_x"?'),
        ('"wrench.force_x", t', '"wrench.force_w", t', "trial.settle.channel", 'did you mean "wrench.force_'),
        ('"wrench.force_x"\n', '"wrench.torqe_x"\n', "objectives.thrust.channel", 'did you mean "wrench.torque_x"?'),
        ('frequency_hz = "f"', 'frequency_hz = "freq"', "gait.joints.tail.frequency_hz", 'did you mean "f"?'),
        ("a * f <= 84", "a * fr <= 84", "sweep.where[0]", 'did you mean "f"?'),
        ("a * f <= 84", "abbs(a) <= 84", "sweep.where[0]", 'did you mean "abs"?'),
        ("goal = ", "gaol = ", "objectives.thrust.gaol", 'did you mean "goal"?'),
        ("[objectives.thrust]", '[units]\nff = "Hz"\n[objectives.thrust]', "units.ff", 'did you mean "f"?'),
        ('kind = "sweep"', 'kind = "swep"', "kind", 'did you mean "sweep"?'),
        ('port = "/dev/ttyUSB0"', 'prt = "/dev/ttyUSB0"', "rig.devices.wrench.prt", 'did you mean "port"?'),
    ],
)  # fmt: skip
def test_a_misspelt_name_comes_with_the_nearest_valid_one(problems, old, new, key, says):
    (problem,) = problems((old, new))
    assert problem.key == key
    assert says in problem.message


@pytest.mark.parametrize(
    ("extra", "key", "says"),
    [
        ('outliers = { objective = "trust" }', "trial.outliers.objective", 'did you mean "thrust"?'),
        ("repeats = { min = 1, max = 2, standard_error = { thrst = 1 } }", "trial.repeats.standard_error.thrst", "thr"),
        ("reference = { every = 9, condition = { a = 1, g = 1 } }", "trial.reference.condition.g", 'did you mean "f"?'),
        ("reference = { every = 9, condition = { a = 1 } }", "trial.reference.condition", "has no value for f"),
        ('carriage = { device = "tial", speed_m_s = 1, to_m = 1 }', "trial.carriage.device", "no device of this name"),
        ('carriage = { device = "wrench", speed_m_s = 1, to_m = 1 }', "trial.carriage.device", "cannot travel"),
        ("safe_pose_deg = { tial = 0 }", "trial.safe_pose_deg.tial", 'did you mean "tail"?'),
        ('tare = { devices = ["wrnch"] }', "trial.tare.devices[0]", 'did you mean "wrench"?'),
        ("duration_s = 3", "trial.duration_s", "give one of cycles, duration_s and until"),
    ],
)  # fmt: skip
def test_what_does_not_fit_together_is_told(problems, extra, key, says):
    (problem,) = problems(("repeats = 3\n", f"{extra}\n"))
    assert problem.key == key
    assert says in problem.message


def test_a_bound_comes_with_its_unit_and_the_value_found(problems):
    (problem,) = problems(("timeout_s = 60", "timeout_s = -60"))
    assert str(problem).endswith("trial.settle.timeout_s = -60: expected more than 0 s")


def test_text_is_not_a_number_and_a_number_is_not_true(problems):
    result = problems(
        ("cycles = 5", 'cycles = "5"'), ("force_n = 300", 'force_n = "300"'), ("from = 10", "from = true")
    )
    assert {problem.key for problem in result} == {
        "trial.cycles",
        "rig.devices.wrench.limits.force_n",
        "sweep.axes.a.from",
    }


def test_all_errors_are_told_at_once_in_the_order_of_their_lines(problems):
    result = problems(
        ('"caudal-tank"', '"caudal-tnk"'),
        ("force_n = 300", "force_kn = 0.3"),
        ("joints.tail", "joints.tial"),
        ("cycles = 5", "cycles = 0"),
        ("repeats = 3", "repeat = 3"),
        ("to = 60, step = 5", "to = 6, step = 5"),
        ("f = [0.5, 1.0, 1.5]", "f = { from = 1, to = 2 }"),
        ("a * f <= 84", "a * g <= 84"),
        ('"cycle-mean"', '"cycle-men"'),
    )
    assert [problem.line for problem in result] == sorted(problem.line for problem in result)
    assert [problem.key for problem in result] == [
        "rig.scene", "rig.devices.wrench.limits.force_kn", "gait.joints.tial", "trial.cycles", "trial.repeat",
        "sweep.axes.a.to", "sweep.axes.f", "sweep.where[0]", "objectives.thrust.plugin",
    ]  # fmt: skip


def test_an_error_is_not_followed_by_errors_that_only_follow_from_it(problems):
    assert len(problems(("cycles = 5", "cycle = 5"))) == 1
    assert len(problems(("cycles = 5", 'cycles = "x"'))) == 1
    assert len(problems(("to = 60", "too = 60"))) == 1


def test_a_missing_key_is_told_where_its_table_stands(problems):
    (problem,) = problems(('port = "/dev/ttyUSB0"\n', ""))
    assert (problem.line, problem.message) == (12, 'the key "port" is missing')


def test_conditions_of_a_run_have_the_same_names(problems):
    result = problems(
        ('kind = "sweep"', 'kind = "run"'),
        (
            "[objectives.thrust]",
            "[run]\nconditions = [{ a = 1, f = 1 }, { a = 1, ff = 1 }]\n[objectives.thrust]",
        ),
    )
    assert [problem.key for problem in result] == ["run.conditions[1].ff"]


def test_parts_of_let_that_need_each_other_are_refused(problems):
    result = problems(('plugin = "sine"', 'plugin = "sine"\nlet = { p = "q + 1", q = "p" }'))
    assert [problem.key for problem in result] == ["gait.let"]
    assert "circle" in result[0].message


def test_cycles_need_a_gait_that_has_them(problems):
    result = problems(
        ('plugin = "sine"', 'plugin = "formula"'),
        ('amplitude_deg = "a", frequency_hz = "f"', 'angle_deg = "a * sin(f*t)"'),
    )
    assert [problem.key for problem in result] == ["trial.cycles"]


def test_a_file_that_is_not_toml_says_where_it_stops_being_so(problems):
    (problem,) = problems(("cycles = 5", "cycles = = 5"))
    assert (problem.line, problem.column) == (22, 10)
    (problem,) = problems(('goal = "maximise"\n', "goal = ["))
    assert problem.line == 34


def test_a_plugin_that_does_not_import_is_told_with_its_cause(problems, tmp_path, monkeypatch):
    (tmp_path / "broken_fin.py").write_text("import a_library_nobody_has\n")
    monkeypatch.syspath_prepend(str(tmp_path))
    (problem,) = problems(('"arduino-servo"', '"broken_fin:Servo"'))
    assert problem.key == "rig.devices.tail.plugin"
    assert "a_library_nobody_has" in problem.message


def test_a_file_that_is_not_there_is_a_request_gone_wrong(tmp_path):
    with pytest.raises(RequestError, match="cannot be read"):
        load_experiment(tmp_path / "nothing.toml")


def test_a_file_that_is_no_text_is_a_request_gone_wrong(tmp_path: Path):
    (tmp_path / "x.toml").write_bytes(b"\xff\xfe\x00")
    with pytest.raises(RequestError, match="UTF-8"):
        load_experiment(tmp_path / "x.toml")


_TREE = st.recursive(
    st.one_of(st.integers(), st.booleans(), st.floats(), st.text(max_size=8)),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=6), inner, max_size=3),
    max_leaves=8,
)


@settings(max_examples=30)
@given(
    st.dictionaries(
        st.sampled_from(
            [
                "kind",
                "title",
                "rig",
                "gait",
                "trial",
                "sweep",
                "run",
                "cmaes",
                "objectives",
                "fit",
                "units",
                "leaders",
                "x",
            ]
        ),
        _TREE,
    )
)
def test_whatever_a_file_holds_it_is_refused_with_places_and_never_with_a_crash(tree):
    import tomli_w

    with pytest.raises(SpecError) as caught:
        loads_experiment(tomli_w.dumps(tree), "odd")
    assert caught.value.details["problems"]
    assert all(problem["line"] is not None for problem in caught.value.details["problems"])


SEARCH = (
    ('kind = "sweep"', 'kind = "cmaes"'),
    ("[sweep]", "[cmaes]"),
    (
        "axes = { a = { from = 10, to = 60, step = 5 }, f = [0.5, 1.0, 1.5] }",
        "population = 10\nvariables = { a = { from = 1, to = 6 }, f = { from = 1, to = 2 } }",
    ),
)


@pytest.mark.parametrize(
    ("old", "new", "key", "says"),
    [
        ("population = 10", "population = 10\nparents = 6", "cmaes.parents", "at most 5"),
        ("population = 10", "population = 10\nreevaluate = 9", "cmaes.reevaluate", "no room for new candidates"),
        ("population = 10", "parents = 4", "cmaes.parents", "the population of 6"),
    ],
)  # fmt: skip
def test_sizes_of_a_search_that_do_not_fit_are_told_with_their_place(problems, old, new, key, says):
    (problem,) = problems(*SEARCH, (old, new))
    assert problem.key == key
    assert problem.line is not None
    assert says in problem.message


def test_a_search_over_one_variable_is_refused_with_what_would_do(problems):
    (problem,) = problems(*SEARCH, (", f = { from = 1, to = 2 }", ""), ('"f"', "1"), ("a * f", "a"))
    assert problem.key == "cmaes.variables"
    assert 'kind = "sweep"' in problem.message


def test_a_kind_that_there_is_not_is_refused_with_the_kinds_there_are(problems):
    (problem,) = problems(('kind = "sweep"', 'kind = "optimise"'))
    assert 'expected "run" or "sweep" or "cmaes" or "track" or "design"' in problem.message


@pytest.mark.parametrize(
    ("fit", "key", "says"),
    [
        ('method = "hing"', "fit.method", 'did you mean "hinge"?'),
        ('model = "models/hinge.toml"', "fit.model", "no such model file"),
        ('model = "hinge-pendulm"', "fit.model", 'did you mean "hinge-pendulum"?'),
        ('model = "nothing_here:model"', "fit.model", "cannot be imported"),
    ],
)
def test_what_a_fit_lacks_is_told_before_the_experiment_is_run(problems, fit, key, says):
    (problem,) = problems(("[objectives.thrust]", f"[fit]\n{fit}\n[objectives.thrust]"))
    assert problem.key == key
    assert says in problem.message


def test_a_stored_experiment_is_read_without_the_model_file_beside_the_original(good):
    text = good.replace("[objectives.thrust]", '[fit]\nmodel = "gone.toml"\n[objectives.thrust]')
    assert loads_experiment(text, "thrust").experiment.fit.model == "gone.toml"


@pytest.mark.parametrize(
    ("units", "says"),
    [
        ('a = "parsecs"', "unknown unit"),
        ('a = "Hz"', "gait.joints.tail.amplitude_deg takes a in deg"),
        ('f = "hz"', 'did you mean "Hz"?'),
    ],
)
def test_a_unit_is_one_that_exists_and_that_the_gait_takes(problems, units, says):
    (problem,) = problems(("[objectives.thrust]", f"[units]\n{units}\n[objectives.thrust]"))
    assert problem.key == f"units.{units[0]}"
    assert says in problem.message


def test_a_wrong_key_hides_neither_a_channel_nor_a_rule_over_other_keys_of_its_table(problems):
    result = problems(
        ("repeats = 3", "retries = -1"),
        ("discard_cycles = 1", "discard_cycles = 5"),
        ('{ channel = "wrench.force_x", timeout_s = 60 }', '{ channel = "wrench.force_q", hold_s = -1 }'),
    )
    assert {problem.key for problem in result} == {
        "trial.retries", "trial.discard_cycles", "trial.settle.channel", "trial.settle.hold_s",
    }  # fmt: skip


@pytest.mark.parametrize(
    ("old", "new", "key", "says"),
    [
        ("speed_deg_s = 528", "speed_rpm = 90", "rig.devices.tail.limits.speed_rpm", "write speed_deg_s = 540"),
        ("[-60, 60]", "[60, -60]", "rig.devices.tail.limits.angle_deg", "60 is not below -60"),
        ("repeats = 3", 'repeats = "abc"', "trial.repeats", "a whole number, or a table { min = 3, max = 10 }"),
        ("repeats = 3", "repeats = 1e9", "trial.repeats", "a whole number, or"),
        (
            "repeats = 3",
            "repeats = { min = 1, max = 3, standard_error = 0.001 }",
            "trial.repeats.standard_error",
            "{ thrust = 0.001 }",
        ),
        ("step = 5", "step = -5", "sweep.axes.a.step", "more than 0"),
    ],
)  # fmt: skip
def test_a_message_names_the_key_and_what_is_allowed_there(problems, old, new, key, says):
    (problem,) = problems((old, new))
    assert problem.key == key
    assert says in problem.message


def test_nothing_to_choose_from_is_said_in_the_plural():
    assert suggest("x", [], kind="carriages") == "no carriages are known here"


@pytest.mark.parametrize(
    ("joints", "column", "message"),
    [
        ("jionts.tail = 5", 1, 'did you mean "joints"?'),
        ("joints = 5", 10, "expected a table { ... }"),
        ("joints.tail = 5", 15, "expected a table { ... }"),
        ('joints.tail = "2*a"', 15, "expected a table { ... }"),
        (
            'joints.tail = { amplitude_deg = [1], frequency_hz = "f" }',
            33,
            "expected a number or text in quotes",
        ),
        (
            'joints.tail = { amplitude_deg = "2*", frequency_hz = "f" }',
            33,
            "something is missing behind this",
        ),
    ],
)
def test_joints_that_are_none_are_told_with_their_place(problems, joints, column, message):
    result = problems(('joints.tail = { amplitude_deg = "a", frequency_hz = "f" }', joints))
    assert any((item.line, item.column) == (19, column) and message in item.message for item in result), (
        result
    )


def test_a_plugin_may_stand_beside_the_experiment(write, tmp_path):
    (tmp_path / "square_beside.py").write_text(
        "from labrun.gaits.sine import SineGait\n\n\nclass Gait(SineGait):\n    pass\n"
    )
    before = list(sys.path)
    loaded = load_experiment(write(('plugin = "sine"', 'plugin = "square_beside:Gait"')))
    assert make_gait(loaded.experiment.gait).joints == ("tail",)
    assert sys.path == before


def test_without_the_table_of_its_kind_only_that_is_told(write):
    path = write(
        ("[sweep]\n", ""),
        ("axes = { a = { from = 10, to = 60, step = 5 }, f = [0.5, 1.0, 1.5] }\n", ""),
        ('where = ["a * f <= 84"]\n', ""),
    )
    with pytest.raises(SpecError) as raises:
        load_experiment(path)
    (problem,) = raises.value.details["problems"]
    assert (problem["key"], problem["line"]) == ("kind", 2)
    assert "needs a table [sweep]" in problem["message"]


def test_a_table_of_another_kind_is_offered(write):
    with pytest.raises(SpecError, match=r'needs a table \[run\]; add it, or write kind = "sweep"'):
        load_experiment(write(('kind = "sweep"', 'kind = "run"')))


def test_another_spelling_of_the_same_unit_is_told_as_one(write):
    with pytest.raises(SpecError, match="the suffix of N m is _n_m; write torque_n_m = 30"):
        load_experiment(write(("force_n = 300", "force_n = 300, torque_nm = 30")))


def test_a_sentence_of_a_devices_own_check_stands_as_it_is(write):
    joints = '"dynamixel"\njoints = { tail = { id = 1 }, head = { id = 1 } }'
    with pytest.raises(SpecError, match=r"rig\.devices\.tail: joints tail and head both have id 1"):
        load_experiment(write(('"arduino-servo"', joints)))
