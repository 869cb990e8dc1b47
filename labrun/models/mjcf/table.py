"""What stands where in the table of integers through which compiled code reaches MuJoCo.

Functions and what is plural stand for addresses, names with ``COUNT`` for how many there are. ``WARNINGS`` is where
MuJoCo counts three kinds of them: singular inertia, too many contacts, too many constraints.
"""

(
    FORWARD, SET_CONSTANTS, MODEL, DATA, WARNINGS,
    FORCES, FORCES_COUNT,
    STATES, STATES_COUNT, RATES,
    QUATERNIONS, QUATERNIONS_COUNT, QUATERNION_VELOCITIES,
    INPUTS, INPUTS_COUNT, INPUTS_ADD,
    SITES, SITES_COUNT,
    VALUES_COUNT, SCRATCH, LAST,
    SETTINGS, SETTINGS_COUNT, SETTINGS_FROM, SETTINGS_FACTORS,
    OUTPUTS, OUTPUTS_COUNT, OUTPUTS_NEED_FORWARD,
    SIZE,
) = range(29)  # fmt: skip
