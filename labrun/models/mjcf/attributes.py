"""Which attributes of MJCF elements a table can name, and what they are in MuJoCo's memory."""

SETTABLE = {
    "joint": {
        "stiffness": "jnt_stiffness",
        "damping": "dof_damping",
        "armature": "dof_armature",
        "frictionloss": "dof_frictionloss",
        "springref": "qpos_spring",
        "range": "jnt_range",
    },
    "body": {
        "mass": "body_mass",
        "inertia": "body_inertia",
        "ipos": "body_ipos",
        "pos": "body_pos",
        "gravcomp": "body_gravcomp",
    },
    "geom": {
        "friction": "geom_friction",
        "pos": "geom_pos",
        "margin": "geom_margin",
        "solref": "geom_solref",
        "solimp": "geom_solimp",
    },
    "actuator": {
        "gear": "actuator_gear",
        "gainprm": "actuator_gainprm",
        "biasprm": "actuator_biasprm",
        "dynprm": "actuator_dynprm",
        "forcerange": "actuator_forcerange",
        "ctrlrange": "actuator_ctrlrange",
    },
    "tendon": {
        "stiffness": "tendon_stiffness",
        "damping": "tendon_damping",
        "frictionloss": "tendon_frictionloss",
        "armature": "tendon_armature",
        "springlength": "tendon_lengthspring",
    },
    "equality": {"data": "eq_data", "solref": "eq_solref", "solimp": "eq_solimp"},
    "site": {"pos": "site_pos"},
}
"""What of an element can be set: its attribute in MJCF, and the array of the compiled model."""
OPTIONS = {"gravity": 3, "wind": 3, "density": 1, "viscosity": 1}
"""Numbers of ``mjOption``, and how many each is."""
FIRST_UNLESS_TOLD = ("friction", "gear")
"""Attributes of several numbers, of which people mean the first."""
SERVO = {"kp": ((("gainprm", 0, 1.0), ("biasprm", 1, -1.0))), "kv": ((("biasprm", 2, -1.0),))}
"""Gains of MJCF's position actuator."""
SHOWN = {
    "actuator": {"force": "actuator_force", "length": "actuator_length", "velocity": "actuator_velocity"},
    "tendon": {"length": "ten_length", "velocity": "ten_velocity"},
    "body": {"position": "xpos"},
    "site": {"position": "site_xpos"},
}
"""What of an element can be seen: how a table says it, and the array of the simulation's data."""
QUATERNION = ("qw", "qx", "qy", "qz")
SPIN = ("wx", "wy", "wz")
"""Parts of a ball joint's position and of its velocity; of a free joint's, behind those of the translation."""
