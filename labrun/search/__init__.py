"""Choice of trials: points of a sweep, a CMA-ES search, and the confirmed best."""

from labrun.search.cmaes import NoCandidateError, Searched, read_generations, search_by_cmaes
from labrun.search.constraints import Constraint, ConstraintError, Feasibility, Violations, probes
from labrun.search.ending import Verdict
from labrun.search.leaders import (
    BestSoFar,
    BestYet,
    Measured,
    Measures,
    honest_best,
    leading_conditions,
    mean_error,
    scatter,
    t_interval,
)
from labrun.search.planned import (
    OverSettings,
    at_settings,
    combined_text,
    combined_values,
    conditions,
    excess_at_settings,
    levels_of,
    settings_of,
    sweep_conditions,
)
from labrun.search.range_ends import range_end_notes
from labrun.search.ranking import NUMBER, Agreement, Cell, FieldColumn, Ranking, agreement, pooled_intervals
from labrun.search.result import (
    RESULT_FILE,
    Best,
    RunResult,
    apart_text,
    reason_lines,
    resume_line,
    stored_result,
    unsettled_text,
)
from labrun.search.survey import allowed_points, at_points, most_trials, survey_space

__all__ = [
    "NUMBER", "RESULT_FILE", "Agreement", "Best", "BestSoFar", "BestYet", "Cell", "Constraint",
    "ConstraintError", "Feasibility", "FieldColumn", "Measured", "Measures", "NoCandidateError",
    "OverSettings", "Ranking", "RunResult", "Searched", "Verdict", "Violations", "agreement",
    "allowed_points", "apart_text", "at_points", "at_settings", "combined_text", "combined_values",
    "conditions", "excess_at_settings", "honest_best", "leading_conditions", "levels_of", "mean_error",
    "most_trials", "pooled_intervals", "probes", "range_end_notes", "read_generations", "reason_lines",
    "resume_line", "scatter", "search_by_cmaes", "settings_of", "stored_result", "survey_space",
    "sweep_conditions", "t_interval", "unsettled_text",
]  # fmt: skip
