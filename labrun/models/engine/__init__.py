"""The engine room: compiled integration of any model with any effects. Importing it imports numba.

docs/development/architecture.md explains it.
"""

from labrun.models.engine.calling import call_model
from labrun.models.engine.filtering import evaluate_sites, filter_inputs, filter_outputs
from labrun.models.engine.integration import integrate

__all__ = ["call_model", "evaluate_sites", "filter_inputs", "filter_outputs", "integrate"]
