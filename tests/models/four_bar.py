"""A four-bar linkage with equal cranks: the coupler keeps its direction, and all of it swings as one pendulum."""

import numpy as np
from mjcf_files import load

CRANK = '<inertial pos="0 0 -0.1" mass="0.1" diaginertia="3e-4 3e-4 1e-5"/>'
HALF_COUPLER = '<inertial pos="0.15 0 0" mass="0.25" diaginertia="5e-6 2e-3 2e-3"/>'
MJCF = f"""
<mujoco>
  <option gravity="0 0 -9.81"/>
  <worldbody>
    <body name="left">
      <joint name="left" axis="0 1 0"/>{CRANK}
      <body name="coupler" pos="0 0 -0.2"><joint name="pin" axis="0 1 0"/>{HALF_COUPLER}</body>
    </body>
    <body name="right" pos="0.3 0 0">
      <joint name="right" axis="0 1 0"/>{CRANK}
      <body name="coupler_again" pos="-0.3 0 -0.2">
        <joint name="close" axis="0 1 0" pos="0.3 0 0"/>{HALF_COUPLER}
      </body>
    </body>
  </worldbody>
  <equality>
    <weld name="loop" body1="coupler" body2="coupler_again" solref="-250000 -1000" solimp="0.9999 0.9999 0.001"/>
  </equality>
</mujoco>
"""
TABLE = """
name = "four-bar"
mujoco = "arm.xml"
[states]
left = "joint.left.position"
right = "joint.right.position"
pin = "joint.pin.position"
left_rate = "joint.left.velocity"
right_rate = "joint.right.velocity"
[parameters]
friction = { mjcf = "joint.left.damping", tolerance = "free", unit = "N m s/rad", lower = 0.0 }
[outputs]
left = { mjcf = "joint.left.position", unit = "rad" }
[sites]
left = {}
pin = {}
[initial]
left = 0.6
"""
INERTIA = 2 * (3e-4 + 0.1 * 0.1**2) + 0.5 * 0.2**2
PULL_N_M = 9.81 * 0.2 * (0.5 + 2 * 0.1 / 2)


def four_bar(folder, table=TABLE, mjcf=MJCF):
    """Return the model; its files are put in a folder."""
    return load(folder, table, mjcf)


def begins(model, **given):
    """Return the state a trial begins in, by the states' names."""
    return dict(zip(model.states, np.asarray(model.initial_state({}, **given)).tolist(), strict=True))
