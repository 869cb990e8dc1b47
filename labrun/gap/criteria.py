"""The constants by which the diagnosis decides, in the order of its steps; all are plain numbers.

What halving and doubling each of them changes stands in docs/development/diagnosis-constants.md.
"""

# --- The rule ---

STANDARD_ERRORS = 1.0
"""Standard errors over units of evidence that an improvement has to exceed (one-standard-error rule)."""
MARGIN = 0.1
"""Fall of the mean log squared error, beyond the standard error, that matters in practice: 5 % of the root mean
square."""
SHARE_OF_GAP = 0.05
"""Share of the squared gap that a cause has to close, of seen and of unseen data; less than that is not searched."""
ENOUGH_UNITS = 8
"""Units of evidence: with fewer conditions, each is cut into blocks of time until there are so many."""
RESAMPLES = 400
"""Resamples of the units of evidence behind confidences and intervals of shares."""
TEMPERATURE = 4.0
"""Temperature of confidences: frequencies among resamples are that much too sure of sealed development cases."""
MOST_CAUSES = 3
"""Causes that may be at work together."""
RATED = 5
"""Candidates beside one set of causes that are judged on unseen data."""
BEAM = 2
"""Sets of causes of one size that further causes are looked for beside, while none is accepted."""
FORMS_TRIED = 2
"""Candidates nearest to the best one whose other forms (shapes, fewer levels) are fitted."""
EXCHANGES = 3
"""Times that every cause is compared again with all others in its place."""
MOST_FOLDS = 8
"""Conditions are left out one at a time, or in this many groups where there are more."""
WITHHELD_BLOCKS = 8
"""Blocks of time that are left out, one at a time, of a single condition."""
LEAST_INFORMATION = 0.12
"""Part of the information about a size that a fold must have to fit it; else the size stays as it was."""

# --- The answer ---

EXPLAINED_REST = 0.1
"""Share of the gap that may be left of an explained gap."""
MOSTLY_REST = 0.5
"""Share of the gap that may be left of a mostly explained gap."""
LEARNABLE = 0.1
"""Share of the squared rest that has to be predictable where nothing was repeated, to be called unexplained."""
DEPENDS = 0.5
"""Part of what is predictable of the rest that a signal has to predict alone to be named."""
MOST_DEPENDED_ON = 2
"""Signals that the rest is said to depend on, at most."""
INTERVAL_DRAWS = 200
"""Draws that intervals of sizes are read from."""
NORMAL_95 = 1.96
"""Two-sided 95 % of the normal distribution."""
STANDS_OUT = 0.05
"""p-value below which a part of the data holds more of the gap than chance gives it."""

# --- Recalibration, noise, and what differs from trial to trial ---

WITHIN_TOLERANCES = 3.0
"""Recalibration moves a parameter by at most this many of its stated tolerances."""
RECALIBRATION_STARTS = 3
"""Starts of the search for the recalibrated parameters."""
FAR_OFF = 3.0
"""Factor by which a stated value may be wrong; beyond it, an effect is the better explanation."""
MODEL_ROUNDING = 5e-4
"""Part of an output's spread below which no model is believed: integrators and sampling differ by as much."""
ENOUGH_FREEDOM = 8
"""Independent whole-trial deviations from which noise is redrawn; with fewer it is drawn from its spectrum."""
OWN_FLOOR_REPEATS = 3
"""Repeats from which a condition has a noise floor of its own."""
DEVIATION_P = 0.001
"""p-value below which a trial-wise deviation scatters more than noise would have it."""
FEWEST_STEPS = 20
"""Time steps from which the usual one can be told."""
SAME_BEGINNING = 5.0
"""Standard deviations of the noise within which first samples of repeats begin alike."""
LARGE_REMAINDER = 3.0
"""Rest, in units of the noise, from which an observer for motion caught in wells is tried."""

# --- Screening ---

WORTH_BESIDE_BEST = 0.1
"""Part of what the best survey promises that makes a candidate worth a fit."""
ALWAYS_FITTED = 3
"""Candidates that are fitted in any case, the most promising ones."""
WORTH_FOLLOWING = 0.1
"""Part of the best gain from which a rough fit is followed to its end."""
IMITATED = 0.1
"""Part of a small change below which it counts as imitated by parameters."""
SPANNED = 1e-7
"""Singular value, in units of the largest, below which a direction of the nuisance parameters is rounding."""

# --- Fits ---

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

# --- The next experiment, and two robots compared ---

NEXT_REPEATS = 3
"""Repeats of each proposed trial."""
VISIBLE_DIFFERENCE = 1.0
"""Difference between two predictions, in standard deviations, below which they are the same."""
FEWEST_UNIT_PIECES = 8
"""Pieces of each robot that intervals of a comparison rest on."""

# --- Robots ---

FAR_MOVED = 2.0
"""Stated tolerances from which a parameter that alone explains a robot's joint is reported as wrong."""
ROBOT_SUBSTEPS = 16
"""Most steps of the integrator per sample where the whole robot is simulated."""
GAIN_TOLERANCE = 0.1
"""How far the gains of a drive and the masses of a file may be off."""
MASS_TOLERANCE = 0.05
"""How far the gains of a drive and the masses of a file may be off."""
LEAST_TORQUE = 0.01
"""Part of a joint's torque that a body must ask for to have a mass of its own among the parameters."""
LEAST_TORQUE_LEFT = 0.01
"""Part of what the drive puts on a joint that is left at the least."""
NUMBERS_A_TRIAL = 10
"""What a trial tells of a joint, independent of one another, however many its samples are."""
CLOCK_FARTHEST_STEP_S = 0.03
"""Most of a step to the time by which a joint's goals are late."""
LOAD_STEPS = 4
"""Steps to the place of a load, and of reweighing the joints that tell it."""
CLOCK_STEPS = 6
"""Steps to the time by which a joint's goals are late."""
CLOCK_TOLD = 3.0
"""Steps to the time by which a joint's goals are late."""
CLOCK_ALIKE = 0.2
"""Steps to the time by which a joint's goals are late."""
CLOCK_JOINTS = 2
"""Joints, and part of those that would tell it, that have to agree on a clock of the whole log."""
CLOCK_AGREED = 0.67
"""Joints, and part of those that would tell it, that have to agree on a clock of the whole log."""
CLOCK_LEAST = 0.25
"""Joints, and part of those that would tell it, that have to agree on a clock of the whole log."""
LEAST_JOINT_GAP = 0.3
"""Gap of a joint, in units of the noise, below which nothing is announced."""
EXPLAINED_BY_OTHERS = 0.5
"""Part of a joint's gap that may be left where the base, a load or another joint's link explains it."""
LINKS_ASKED = 3
"""Most probable joints whose links may not be where their encoders say that are compared."""

# --- Corrected files ---

FILE_FOLDS = 3
"""Parts of a log, each of which is withheld once from the fit of what a corrected file holds."""
FEWEST_PIECES = 6
"""Pieces that a log of fewer trials is cut into before parts of it are withheld."""
FREE_PIECE_S = 0.5
"""Length of pieces where a joint is driven by a torque: longer ones drift from the log whatever the model."""
PIECE_SAMPLES = 50
"""Samples that a piece has at least."""
