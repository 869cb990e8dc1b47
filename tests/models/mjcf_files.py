"""MJCF files and tables the tests share."""

from labrun.models import load_model

ARM = """
<mujoco>
  <option gravity="0 0 -9.81"/>
  <worldbody>
    <body name="arm">
      <joint name="hinge" axis="0 1 0" stiffness="0.5" damping="0.02"/>
      <inertial pos="0 0 -0.25" mass="0.4" diaginertia="1e-3 1e-3 1e-3"/>
    </body>
  </worldbody>
  <actuator><motor name="motor" joint="hinge"/></actuator>
</mujoco>
"""

ARM_TABLE = """
name   = "arm"
mujoco = "arm.xml"
[states]
angle = "joint.hinge.position"
rate  = "joint.hinge.velocity"
[inputs]
torque = { mjcf = "actuator.motor", unit = "N m", between = "linear" }
[parameters]
mass      = { mjcf = "body.arm.mass", tolerance = 0.05, unit = "kg", lower = 1e-3 }
stiffness = { mjcf = "joint.hinge.stiffness", unit = "N m/rad" }
damping   = { value = 0.03, mjcf = "joint.hinge.damping", unit = "N m s/rad" }
[outputs]
angle = { mjcf = "joint.hinge.position", unit = "rad" }
torque = "actuator.motor.force"
[sites.hinge]
kind = "joint"
stiffness = "stiffness"
load = "mass*9.81"
[initial]
angle = "first"
"""

ARM_EQUATIONS = """
name = "arm"
states = ["angle", "rate"]
[inputs]
torque = { unit = "N m", between = "linear" }
[parameters]
mass      = { value = 0.4, tolerance = 0.05, unit = "kg", lower = 1e-3 }
stiffness = { value = 0.5, unit = "N m/rad" }
damping   = { value = 0.03, unit = "N m s/rad" }
[equations]
angle = "rate"
rate  = "(torque + force.hinge - stiffness*angle - damping*rate - mass*9.81*0.25*sin(angle)) / (1e-3 + mass*0.25^2)"
[outputs]
angle = "angle"
torque = "torque"
[sites.hinge]
kind = "joint"
coordinate = "angle"
rate = "rate"
stiffness = "stiffness"
load = "mass*9.81"
"""


def write(folder, table, xml, name="arm"):
    """Put a table and its MJCF file in a folder, and return the table's path."""
    (folder / f"{name}.xml").write_text(xml)
    path = folder / f"{name}.toml"
    path.write_text(table)
    return path


def load(folder, table, xml, name="arm"):
    """Return the model of a table and its MJCF file."""
    return load_model(write(folder, table, xml, name))
