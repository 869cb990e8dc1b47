"""The constants by which the diagnosis decides, in the order of its steps; all are plain numbers.

What halving and doubling each of them changes stands in docs/development/diagnosis-constants.md. How closely fits
converge and how many draws are taken stands in `labrun.gap.numerics`: more of these costs time and decides nothing.
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
FOLDS = 8
"""Groups of conditions, or of blocks of time of a single condition, that are left out in turn, at most."""
LEAST_INFORMATION = 0.12
"""Part of the information about a size that a fold must have to fit it; else the size stays as it was."""
TEMPERATURE = 4.0
"""Temperature of confidences: frequencies among resamples are that much too sure of sealed development cases."""
MOST_CAUSES = 3
"""Causes that may be at work together, and rounds in which each is compared again with all others in its place."""
RATED = 5
"""Candidates beside one set of causes that are judged on unseen data."""
BEAM = 2
"""Sets of causes of one size that further causes are looked for beside, and candidates whose other forms are fitted."""

# --- The answer ---

NEGLIGIBLE = 0.1
"""Share of the gap that may be left of an explained gap; share of the squared rest, predictable from motion and inputs,
below which a rest without repeats is not called unexplained."""
MOST = 0.5
"""Share of the gap, of what is predictable, or of a joint's gap that counts as most of it."""
STANDS_OUT = 0.05
"""p-value below which a part of the data holds more of the gap than chance gives it."""

# --- Recalibration, noise, and what differs from trial to trial ---

WITHIN_TOLERANCES = 3.0
"""Recalibration moves a parameter by at most this many of its stated tolerances."""
FAR_OFF = 3.0
"""Factor by which a stated value may be wrong; beyond it, an effect is the better explanation."""
MODEL_ROUNDING = 5e-4
"""Part of an output's spread below which no model is believed: integrators and sampling differ by as much."""
ENOUGH_FREEDOM = 8
"""Independent whole-trial deviations from which noise is redrawn; with fewer it is drawn from its spectrum."""
OWN_FLOOR_REPEATS = 3
"""Repeats from which a condition has a noise floor of its own."""
DEVIATION_P = 0.001
"""p-value below which trials have a deviation in common, or begin elsewhere than noise would have them."""
SAME_BEGINNING = 5.0
"""Standard deviations of the noise within which first samples of repeats begin alike."""
LARGE_REMAINDER = 3.0
"""Rest, in units of the noise, from which an observer for motion caught in wells is tried."""

# --- Screening ---

WORTH_FITTING = 0.1
"""Part of the best candidate's gain from which a survey is worth a fit, and a rough fit is followed to its end."""
ALWAYS_FITTED = 3
"""Candidates that are fitted in any case, the most promising ones."""
IMITATED = 0.1
"""Part of a small change below which it counts as imitated by parameters."""

# --- The next experiment ---

VISIBLE_DIFFERENCE = 1.0
"""Difference between two predictions, in standard deviations, below which they are the same."""

# --- Robots ---

FAR_MOVED = 2.0
"""Stated tolerances from which a parameter that alone explains a robot's joint is reported as wrong."""
GAIN_TOLERANCE = 0.1
"""Share by which the gains of a drive may be off."""
MASS_TOLERANCE = 0.05
"""Share by which the masses of a file may be off."""
LEAST_TORQUE = 0.01
"""Part of a joint's torque below which a body has no mass of its own, and a drive no effect."""
NUMBERS_A_TRIAL = 10
"""Independent numbers that a trial holds about a joint, however many its samples are."""
CLOCK_TOLD = 3.0
"""Standard deviations from zero from which a joint has a clock of its own to say."""
CLOCK_ALIKE = 0.2
"""Part of the median clock within which joints agree on it."""
CLOCK_JOINTS = 2
"""Joints, at least, that have to agree on a clock of the whole log."""
CLOCK_AGREED = 0.67
"""Share of the joints that could tell a clock of the whole log, that have to agree on it."""
CLOCK_LEAST = 0.25
"""Part of a sample below which a clock is none."""
LEAST_JOINT_GAP = 0.3
"""Gap of a joint, in units of the noise, below which nothing is announced."""
LINKS_ASKED = 3
"""Most probable joints whose links may not be where their encoders say that are compared."""

# --- Corrected files ---

FILE_FOLDS = 3
"""Parts of a log, each withheld once from the fit of what a corrected file holds. A log of fewer trials is cut
into twice as many pieces."""
FREE_PIECE_S = 0.5
"""Length of pieces where a joint is driven by a torque: longer ones drift from the log whatever the model."""
PIECE_SAMPLES = 50
"""Samples that a piece has at least."""
