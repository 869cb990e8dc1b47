"""Simulators: parameters, inputs, outputs, and sites where physics can be missing."""

from labrun.arrays import FloatArray
from labrun.compiled import NativeFunction, Pointer, kernel, native
from labrun.effects import Site, SiteKind
from labrun.models.inputs import Drive
from labrun.models.loading import load_model, parse_model, shipped_models
from labrun.models.model import Between, Condition, Input, Model, Output, Parameter
from labrun.models.python_model import compile_derivative, compile_output, python_model
from labrun.models.simulation import (
    Simulation,
    Unfiltered,
    filtered,
    prepare,
    simulate,
    simulate_unfiltered,
    site_course,
    suggest_substeps,
)
from labrun.models.stepper import Stepper
from labrun.models.writing import corrected_model_text

__all__ = [
    "Between",
    "Condition",
    "Drive",
    "FloatArray",
    "Input",
    "Model",
    "NativeFunction",
    "Output",
    "Parameter",
    "Pointer",
    "Simulation",
    "Site",
    "SiteKind",
    "Stepper",
    "Unfiltered",
    "compile_derivative",
    "compile_output",
    "corrected_model_text",
    "filtered",
    "kernel",
    "load_model",
    "native",
    "parse_model",
    "prepare",
    "python_model",
    "shipped_models",
    "simulate",
    "simulate_unfiltered",
    "site_course",
    "suggest_substeps",
]
