"""What is true of a robot as a whole: how its base stands, and what it carries, as lines of its model file.

All are zero until somebody knows better: a diagnosis writes them, and so may a person.
"""

from collections.abc import Mapping
from typing import Any

import numpy as np

from labrun.models.mjcf.inverse import far_end, tip_body
from labrun.models.mjcf.plant import imported

ROLL, PITCH, LOAD = "base_roll", "base_pitch", "tip_load"
"""Parameters of the model file: rad about x, rad about y, kg."""
PLACE = ("tip_load_x", "tip_load_y", "tip_load_z")
"""Where the load is in the frame of the last body, m: at its far end unless somebody knows better."""
_LEAST_MASS = 0.1
"""Part of the last body's mass that a load below zero leaves of it."""


def around(xml: str, masses: Mapping[str, str]) -> tuple[list[str], dict[str, str]]:
    """Return the tilt of a robot's base, the load at its tip, and inertias in proportion to the masses.

    A body that is heavier than stated and turns as easily as before would be another shape; joint by joint, a
    body counts in proportion to its mass, too.

    Parameters
    ----------
    xml
        MJCF without other files.
    masses : body -> parameter
        Which parameters are masses; that of the last body is given its value here.

    Returns
    -------
    list, dict
        Lines of ``[parameters]``; entries of ``[mjcf]``: reference -> equation.
    """
    mujoco = imported()
    model = mujoco.MjModel.from_xml_string(xml)
    parameters: list[str] = []
    equations: dict[str, str] = {}
    if not np.any(model.jnt_type == mujoco.mjtJoint.mjJNT_FREE) and np.any(model.opt.gravity):
        parameters += [
            f'{name} = {{ value = 0.0, tolerance = 0.0, unit = "rad", lower = -1.6, upper = 1.6 }}'
            for name in (ROLL, PITCH)
        ]
        equations |= _gravity([float(one) for one in model.opt.gravity])
    for name, mass_of in masses.items():
        equations |= _in_proportion(model, name, mass_of)
    body = tip_body(model)
    name = (mujoco.mj_id2name(model, mujoco.mjtObj.mjOBJ_BODY, body) or "") if body else ""
    # MuJoCo keeps a body that is balanced about its joint so: nothing can hang on it
    if name in masses and not model.body_simple[body]:
        mass = float(model.body_mass[body])
        low = (_LEAST_MASS - 1.0) * mass
        parameters.append(f'{LOAD} = {{ value = 0.0, tolerance = 0.0, unit = "kg", lower = {low!r} }}')
        parameters += [
            f'{parameter} = {{ value = {float(value)!r}, tolerance = 0.0, unit = "m" }} # twice as far as its centre'
            for parameter, value in zip(PLACE, far_end(model), strict=True)
        ]
        equations |= _loaded(model, body, name, masses[name])
    return parameters, equations


def _gravity(down: list[float]) -> dict[str, str]:
    """Return gravity as a base sees it that is pitched about y, then rolled about x."""
    x, y, z = (repr(one) for one in down)
    after = f"(sin({PITCH})*({x}) + cos({PITCH})*({z}))"
    return {
        "option.gravity[0]": f"cos({PITCH})*({x}) - sin({PITCH})*({z})",
        "option.gravity[1]": f"cos({ROLL})*({y}) + sin({ROLL})*{after}",
        "option.gravity[2]": f"cos({ROLL})*{after} - sin({ROLL})*({y})",
    }


def _in_proportion(model: Any, name: str, mass: str) -> dict[str, str]:
    """Return the principal inertias of a body as its mass has them."""
    body = model.body(name)
    ratios = [float(one) / float(body.mass[0]) for one in body.inertia]
    return {f"body.{name}.inertia[{axis}]": f"{ratio!r}*{mass}" for axis, ratio in enumerate(ratios) if ratio}


def _loaded(model: Any, body: int, name: str, mass: str) -> dict[str, str]:
    """Return mass, centre and inertia of a body with a point mass on it.

    Parallel axes (Siciliano, Sciavicco, Villani, Oriolo, Robotics (2009), section B.2). Products of inertia in the
    body's principal axes are left out: none arise where the line from its centre to the load lies on one of them.
    """
    mujoco = imported()
    centre = [float(one) for one in model.body_ipos[body]]
    turn = np.empty(9)
    mujoco.mju_quat2Mat(turn, model.body_iquat[body])
    to_principal = turn.reshape(3, 3).T
    found = {f"body.{name}.mass": f"{mass} + {LOAD}"}
    share = f"{LOAD}/({mass} + {LOAD})"
    away = [f"({place} - {at!r})" for place, at in zip(PLACE, centre, strict=True)]
    for axis in range(3):
        found[f"body.{name}.ipos[{axis}]"] = f"{centre[axis]!r} + {away[axis]}*{share}"
        along = [f"{float(part)!r}*{one}" for part, one in zip(to_principal[axis], away, strict=True) if part]
        own = float(model.body_inertia[body, axis] / model.body_mass[body])
        squares = " + ".join(f"{one}^2" for one in away)
        found[f"body.{name}.inertia[{axis}]"] = (
            f"{own!r}*{mass} + ({squares} - ({' + '.join(along)})^2)*{mass}*{share}"
        )
    return found


def heavy_bodies(xml: str) -> dict[str, float]:
    """Return the masses of the bodies that hang on joints of their own, by name."""
    mujoco = imported()
    model = mujoco.MjModel.from_xml_string(xml)
    names = {body: mujoco.mj_id2name(model, mujoco.mjtObj.mjOBJ_BODY, body) for body in range(1, model.nbody)}
    return {
        name: float(model.body_mass[body])
        for body, name in names.items()
        if name and model.body_mass[body] > 0 and model.body_dofnum[body] > 0
    }
