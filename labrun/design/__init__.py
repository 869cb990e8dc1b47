"""Geometry and gait in one search: candidates are simulated, the winner is perturbed, drawn and handed on as files."""

import sys

from labrun import UseCasePackage
from labrun.design.candidates import Candidates, SimulationLimitError
from labrun.design.constraints import Margin
from labrun.design.handing_on import MADE, Drawing, dimensions_csv, drawing_of, model_text, written_experiment
from labrun.design.simulator import Simulated, Simulator, require_simulable

__all__ = [
    "MADE", "Candidates", "Drawing", "Margin", "Simulated", "SimulationLimitError", "Simulator", "dimensions_csv",
    "drawing_of", "model_text", "require_simulable", "written_experiment",
]  # fmt: skip

sys.modules[__name__].__class__ = UseCasePackage
