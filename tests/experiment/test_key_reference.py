"""What a key takes is found by its path, told from the models that check the file."""

import pytest

from labrun.errors import RequestError
from labrun.experiment import Experiment, keys_at


def keys_below(path):
    return {key.path: key for key in keys_at(path)}


def test_a_table_shows_its_keys_with_default_and_unit():
    result = keys_below("trial.settle")
    hold = result["trial.settle.hold_s"]
    assert (hold.takes, hold.default, hold.unit) == ("number, above 0", "2", "s")
    assert result["trial.settle.until"].default == '"quiet"'


def test_the_top_of_the_file_has_every_table():
    assert list(keys_below("")) == list(Experiment.model_fields)


def test_brackets_as_in_the_file_may_stand():
    assert keys_at("[trial.settle]") == keys_at("trial.settle")


@pytest.mark.parametrize(
    ("path", "default"),
    [("cmaes.variables.a.from", "must be given"), ("rig.devices.wrench.limits.force_n", "")],
)
def test_a_table_of_names_is_entered_by_any_name(path, default):
    assert [(key.path, key.default) for key in keys_at(path)] == [(path, default)]


def test_a_plugin_shows_its_own_keys_as_its_docstring_explains_them():
    result = keys_below("dynamixel")
    assert "Set-points a second." in result["dynamixel.command_hz"].meaning
    assert result["dynamixel.joints"].default == "must be given"
    assert keys_below("rig.devices.dynamixel").keys() == {f"rig.devices.{path}" for path in result}
    assert "gait.joints.NAME.amplitude_deg" in keys_below("gait.joints")


@pytest.mark.parametrize(
    ("path", "hint"),
    [
        ("trial.setle", "settle"),
        ("trial.settle.hold", "hold_s"),
        ("trial.cycles.x", "labrun keys trial.cycles"),
    ],
)
def test_a_key_that_is_none_names_the_nearest(path, hint):
    with pytest.raises(RequestError) as error:
        keys_at(path)
    assert hint in (error.value.hint or "")


def test_a_key_without_its_table_is_told_with_it():
    with pytest.raises(RequestError) as refused:
        keys_at("scene")
    assert refused.value.hint == "labrun keys rig.scene"
