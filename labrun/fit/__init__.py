"""Fitting: what a model's parameters are, how sure, and what is left. What a fit by plugin builds on stands here."""

import sys

from labrun import UseCasePackage
from labrun.fit.correlation import correlation_length
from labrun.fit.dataset import Dataset, FitTrial, load_dataset
from labrun.fit.estimate import Estimate, rounded
from labrun.fit.figure import Curve, FigureData, Panel, Stack
from labrun.fit.levenberg_marquardt import NormalEquations, minimise
from labrun.fit.method import FitJob, FitMethod, FitPlugin, NoSettings
from labrun.fit.notes import Note, silent
from labrun.fit.output_error import FEW_TRIALS, fit_model
from labrun.fit.problem import Problem
from labrun.fit.resampling import LEVEL, resample_trials, student
from labrun.fit.result import FitResult, FitSummary, FittedData, TextTable
from labrun.store import is_recording

__all__ = [
    "FEW_TRIALS",
    "LEVEL",
    "Curve",
    "Dataset",
    "Estimate",
    "FigureData",
    "FitJob",
    "FitMethod",
    "FitPlugin",
    "FitResult",
    "FitSummary",
    "FitTrial",
    "FittedData",
    "NoSettings",
    "NormalEquations",
    "Note",
    "Panel",
    "Problem",
    "Stack",
    "TextTable",
    "correlation_length",
    "fit_model",
    "is_recording",
    "load_dataset",
    "minimise",
    "resample_trials",
    "rounded",
    "silent",
    "student",
]

sys.modules[__name__].__class__ = UseCasePackage
