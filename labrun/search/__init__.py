"""Which trials come next: the points of a sweep, a search by CMA-ES, and the honest best of what was measured."""

from labrun.search.cmaes import Judge, NoCandidateError, Searched, search_by_cmaes
from labrun.search.constraints import (
    Constraint,
    ConstraintError,
    Feasibility,
    LimitExcesses,
    Violations,
    probes,
)
from labrun.search.generation import keep_generation, read_generations
from labrun.search.leaders import Measured, Measures, honest_best, leading_conditions, pooled_variance
from labrun.search.mountings import Scatter, mean_error, scatter, t_interval
from labrun.search.over import Combined, OverSettings, at_settings, excess_at_settings, levels_of, settings_of
from labrun.search.planned import axis_values, conditions, start_of_search, sweep_conditions
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
    winner_lines,
)
from labrun.search.survey import allowed_points, at_points, most_trials, survey_space
from labrun.search.verdict import Verdict

__all__ = [
    "NUMBER", "RESULT_FILE", "Agreement", "Best", "Cell", "Combined", "Constraint", "ConstraintError",
    "Feasibility", "FieldColumn", "Judge", "LimitExcesses", "Measured", "Measures", "NoCandidateError",
    "OverSettings", "Ranking", "RunResult", "Scatter", "Searched", "Verdict", "Violations", "agreement",
    "allowed_points", "apart_text", "at_points", "at_settings", "axis_values", "conditions", "excess_at_settings",
    "honest_best", "keep_generation", "leading_conditions", "levels_of", "mean_error", "most_trials",
    "pooled_intervals", "pooled_variance", "probes", "read_generations", "reason_lines", "resume_line", "scatter",
    "search_by_cmaes", "settings_of", "start_of_search", "stored_result", "survey_space", "sweep_conditions",
    "t_interval", "unsettled_text", "winner_lines",
]  # fmt: skip
