"""How closely the diagnosis computes: draws, starts, tolerances and most evaluations of its fits.

More of each costs time and makes answers more exact; none of them decides what a cause is (`labrun.gap.criteria`).
"""

RESAMPLES = 400
"""Resamples of the units of evidence behind confidences and intervals of shares."""
INTERVAL_DRAWS = 200
"""Draws that intervals of sizes are read from."""
NORMAL_95 = 1.96
"""Two-sided 95 % of the normal distribution."""
SPANNED = 1e-7
"""Singular value, in units of the largest, below which a direction of the nuisance parameters is rounding."""
FEWEST_STEPS = 20
"""Time steps from which the usual one can be told."""

# --- Fits ---

RECALIBRATION_STARTS = 3
"""Starts of the search for the recalibrated parameters."""
ROUGH_TOLERANCE = 0.01
"""Relative fall of the sum of squares at which rough fits end."""
ROUGH_EVALUATIONS = 12
"""Most evaluations of a rough fit."""
FIT_TOLERANCE = 0.0001
"""Relative fall of the sum of squares at which fits of candidates end."""
FIT_EVALUATIONS = 30
"""Most evaluations of such a fit."""
FIT_RENEWALS = 6
"""Most times that derivatives are computed anew in such a fit."""
STEPS_DO = 0.005
"""Part of the squared residual that halving the integrator's steps may change."""

# --- Robots ---

ROBOT_SUBSTEPS = 16
"""Most steps of the integrator per sample where the whole robot is simulated."""
LOAD_STEPS = 4
"""Steps to the place of a load, and of reweighing the joints that tell it."""
CLOCK_STEPS = 6
"""Steps to the time by which a joint's goals are late."""
CLOCK_FARTHEST_STEP_S = 0.03
"""Most of one such step, s."""
