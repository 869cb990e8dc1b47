"""Simulators: parameters, inputs, outputs, and sites where physics can be missing."""

from labrun.arrays import FloatArray
from labrun.compiled import NativeFunction, Pointer, kernel, native
from labrun.effects import Site, SiteKind
from labrun.models.correcting import corrected_model_text
from labrun.models.equations import python_model
from labrun.models.files import load_model, parse_model
from labrun.models.finding import is_robot, shipped_models
from labrun.models.layout import Drive
from labrun.models.mjcf.exporting import Exported, MjcfRange, mjcf_of, mjcf_ranges
from labrun.models.mjcf.grip import with_grip_held
from labrun.models.mjcf.inverse import Carried, RobotTerms, TipLoad, carried, robot_terms
from labrun.models.mjcf.passive import PassiveForces, passive_forces
from labrun.models.mjcf.regressor import InertialRegressor, LinkMotion
from labrun.models.mjcf.robot import Robot, RobotActuator, RobotJoint, identifier, read_robot
from labrun.models.mjcf.robot_table import robot_table
from labrun.models.mjcf.running import Motion, run_mjcf
from labrun.models.model import Between, Condition, Input, Model, Origin, Output, Parameter, natives
from labrun.models.observer import measured_name, observed
from labrun.models.simulation import (
    Simulation,
    Stepper,
    Unfiltered,
    filtered,
    prepare,
    simulate,
    simulate_unfiltered,
    site_course,
    suggest_substeps,
)

__all__ = [
    "Between", "Carried", "Condition", "Drive", "Exported", "FloatArray", "InertialRegressor", "Input",
    "LinkMotion", "MjcfRange",
    "Model", "Motion", "NativeFunction", "Origin", "Output", "Parameter", "PassiveForces", "Pointer", "Robot",
    "RobotActuator",
    "RobotJoint", "RobotTerms", "Simulation", "Site", "SiteKind", "Stepper", "TipLoad", "Unfiltered", "carried",
    "corrected_model_text", "filtered", "identifier", "is_robot", "kernel", "load_model", "measured_name",
    "mjcf_of", "mjcf_ranges", "native", "natives", "observed", "parse_model", "passive_forces",
    "prepare", "python_model", "read_robot",
    "robot_table", "robot_terms", "run_mjcf", "shipped_models", "simulate", "simulate_unfiltered", "site_course",
    "suggest_substeps", "with_grip_held",
]  # fmt: skip
