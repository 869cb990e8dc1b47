"""--set key=value."""

import pytest

from labrun.errors import SpecError
from labrun.experiment import apply_overrides


def test_values_are_toml_and_bare_words_are_text():
    data = {}
    apply_overrides(
        data,
        ["a.b=3", "a.c=[1, 2]", "a.d=quiet", 'a.e="x y"', "a.f=/dev/ttyUSB1", "a.g=true", "a.h={ i = 1.5 }"],
    )
    assert data["a"] == {
        "b": 3,
        "c": [1, 2],
        "d": "quiet",
        "e": "x y",
        "f": "/dev/ttyUSB1",
        "g": True,
        "h": {"i": 1.5},
    }


def test_an_entry_of_a_list_is_named_by_its_number():
    data = {"run": {"conditions": [{"release": 10}, {"release": 20}]}}
    apply_overrides(data, ["run.conditions.1.release=25"])
    assert data["run"]["conditions"][1]["release"] == 25


def test_an_override_reaches_inside_what_is_written_short(load):
    loaded = load(overrides=["rig.scene.noise=0", "trial.repeats.max=6"])
    assert loaded.experiment.rig.scene.settings == {"noise": 0}
    assert (loaded.experiment.trial.repeats.min, loaded.experiment.trial.repeats.max) == (3, 6)


@pytest.mark.parametrize(
    "override", ["trial.cycles", "=3", "trial.cycles=", "a..b=1", "trial.cycles.x=3", "trial.x=[1,"]
)
def test_what_cannot_be_read_or_placed_names_the_override(override, good):
    import tomllib

    with pytest.raises(SpecError, match="--set") as caught:
        apply_overrides(tomllib.loads(good), [override])
    assert override in str(caught.value)


@pytest.mark.parametrize(
    ("override", "key", "says"),
    [
        ("trial.repeat=5", "trial.repeat", 'did you mean "repeats"?'),
        ("trail.repeats=5", "trail", 'did you mean "trial"?'),
        ("rig.devices.tial.port=/dev/x", "rig.devices.tial", 'did you mean "rig.devices.tail"?'),
        ("trial.settle.timeout_ms=3", "trial.settle.timeout_ms", "write timeout_s = 0.003"),
        ("trial.cycles=-1", "trial.cycles", "expected more than 0"),
        ("gait.joints.tail.amplitude_deg=2*b", "gait.joints.tail.amplitude_deg", 'unknown name "b"'),
    ],
)
def test_what_an_override_gets_wrong_is_told_with_the_override_the_key_and_the_nearest(
    problems, override, key, says
):
    (problem,) = problems(overrides=(override,))
    assert problem.origin == f"--set {override}"
    assert problem.key == key
    assert says in problem.message


def test_all_overrides_that_are_wrong_are_told_at_once(problems):
    result = problems(("repeats = 3", "repeat = 3"), overrides=("trial.cycls=3", "sweep.axs=3"))
    assert [problem.key for problem in result] == ["trial.cycls", "sweep.axs", "trial.repeat"]
