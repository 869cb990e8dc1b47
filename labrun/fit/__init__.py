"""Fitting: parameters, intervals and residuals; the base of fit plugins."""

import sys

from labrun import UseCasePackage
from labrun.estimate import Estimate, rounded
from labrun.experiment import condition_text
from labrun.fit.comparison import (
    LEAST_SIZE,
    ComparedPoint,
    Comparison,
    Pair,
    compared,
    paired,
    predicted_numbers,
    predictions,
    told_apart,
)
from labrun.fit.dataset import Dataset, FitTrial, OutputsAlone, load_dataset, thinned, until_peak
from labrun.fit.learning.method import DataTable, TrainingSamples, known_inverse, mean_absolute
from labrun.fit.levenberg_marquardt import NormalEquations, minimise, search
from labrun.fit.method import (
    GROUP,
    FitJob,
    FitMethod,
    FitPlan,
    FitPlugin,
    NoSettings,
    Note,
    WithSettings,
    is_method,
    make_method,
    silent,
)
from labrun.fit.output_error import FEW_TRIALS, fit_model
from labrun.fit.problem import FEWEST_SAMPLES, Jacobian, OutputNoise, Problem
from labrun.fit.result import Curve, FigureData, FitResult, FitSummary, FittedData, Panel, Stack, TextTable
from labrun.fit.simulations import Each, one_by_one, workers
from labrun.fit.uncertainty import (
    LEVEL,
    by_mounting,
    correlation_length,
    divergence_warnings,
    mean_estimate,
    resample_trials,
    student,
)
from labrun.fit.variables import FIRST_SAMPLES, SIMULATED, Deviation, DeviationKind
from labrun.store import Run, TrialOutcome, is_recording, open_run

__all__ = [
    "FEWEST_SAMPLES", "FEW_TRIALS", "FIRST_SAMPLES", "GROUP", "LEAST_SIZE", "LEVEL", "SIMULATED", "ComparedPoint",
    "Comparison", "Curve", "DataTable", "Dataset", "Deviation", "DeviationKind", "Each", "Estimate", "FigureData",
    "FitJob", "FitMethod", "FitPlan", "FitPlugin", "FitResult", "FitSummary", "FitTrial", "FittedData", "Jacobian",
    "NoSettings", "NormalEquations", "Note", "OutputNoise", "OutputsAlone", "Pair", "Panel", "Problem", "Run",
    "Stack", "TextTable", "TrainingSamples", "TrialOutcome", "WithSettings", "by_mounting", "compared",
    "condition_text", "correlation_length", "divergence_warnings", "fit_model", "is_method", "is_recording",
    "known_inverse", "load_dataset", "make_method", "mean_absolute", "mean_estimate", "minimise", "one_by_one",
    "open_run", "paired", "predicted_numbers", "predictions", "resample_trials", "rounded", "search", "silent",
    "student", "thinned", "told_apart", "until_peak", "workers",
]  # fmt: skip

sys.modules[__name__].__class__ = UseCasePackage
