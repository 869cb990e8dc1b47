"""What a person is told of a robot file with a typo."""

import re

import pytest

from labrun.errors import ModelError
from labrun.models import load_model, read_robot

XML = """<mujoco model="arm">
  <worldbody>
    <body name="upper">
      <joint name="shoulder" axis="0 1 0" damping="0.2"/>
      <inertial pos="0 0 -0.1" mass="0.3" diaginertia="1e-3 1e-3 1e-3"/>
    </body>
  </worldbody>
  <actuator><position name="servo" joint="shoulder" kp="8"/></actuator>
</mujoco>
"""
TYPOS = {
    ("damping=", "dampping="): 'arm.xml, line 4: .*dampping.*\n.*"damping"',
    ("<joint", "<jiont"): 'arm.xml, line 4: unrecognized element.*jiont.*\n.*"joint"',
    ("worldbody", "worldbdy"): 'arm.xml, line 2: .*\n.*"worldbody"',
    ('joint="shoulder"', 'joint="sholder"'): 'arm.xml, line 8: .*sholder.*\n.*"shoulder"',
    ("damping=", "qqq="): "line 4: .*qqq.*\n.*attributes of joint: .*armature",
    ("</body>", ""): "arm.xml, line 3: <body> is not closed",
    ('axis="0 1 0"', 'axis="0 1 a"'): "line 4: .*axis.*\n.*a point, no comma",
    ('mass="0.3"', 'mass="0,3"'): "line 5: .*mass.*\n.*a point, no comma",
    (
        '1e-3 1e-3 1e-3"',
        '1e-3 1e-3 1e-2"',
    ): "inertia of upper .line 3, .*more than the other two together.*\n.*--repair",
    (' mass="0.3" diaginertia="1e-3 1e-3 1e-3"', ' mass="0.3"'): "line 3: .*\n.*mass and diaginertia",
    ("<worldbody>", '<include file="leg.xml"/><worldbody>'): "line 2: .*leg.xml.*\n.*beside the one",
}


@pytest.mark.parametrize(("wrong", "message"), TYPOS.items(), ids=lambda typo: typo[1][:24])
def test_a_typo_is_told_with_its_line_and_what_was_meant(tmp_path, wrong, message):
    file = tmp_path / "arm.xml"
    file.write_text(XML.replace(*wrong), encoding="utf-8")
    with pytest.raises(ModelError) as error:
        read_robot(file)
    assert re.search(message, str(error.value))


@pytest.mark.parametrize("typed", ["arm.xm", "arn.xml", "amr.toml"])
def test_a_misspelled_file_is_told_with_the_file_that_is_there(tmp_path, monkeypatch, typed):
    (tmp_path / "arm.xml").write_text(XML, encoding="utf-8")
    (tmp_path / "log.csv").touch()
    with pytest.raises(ModelError) as error:
        load_model(tmp_path / typed)
    assert "arm.xml" in error.value.hint
