"""Simulators: parameters, inputs, outputs, and sites where physics can be missing."""

from labrun.models.inputs import Drive
from labrun.models.loading import load_model, shipped_models
from labrun.models.model import Between, Condition, FloatArray, Input, Model, Output, Parameter, Site
from labrun.models.python_model import compile_derivative, compile_output, python_model
from labrun.models.simulation import Simulation, prepare, simulate, suggest_substeps
from labrun.models.stepper import Stepper
from labrun.models.toml_model import parse_model
from labrun.models.writing import corrected_model_text

__all__ = [
    "Between",
    "Condition",
    "Drive",
    "FloatArray",
    "Input",
    "Model",
    "Output",
    "Parameter",
    "Simulation",
    "Site",
    "Stepper",
    "compile_derivative",
    "compile_output",
    "corrected_model_text",
    "load_model",
    "parse_model",
    "prepare",
    "python_model",
    "shipped_models",
    "simulate",
    "suggest_substeps",
]
