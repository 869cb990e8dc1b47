"""What all simulated benches share; the scene of a rig is a `Bench`."""

from labrun_plugins.simulated.bench.bench import Bench, TowedBench
from labrun_plugins.simulated.bench.hidden import (
    Passage,
    described,
    hidden_effects,
    joint_model,
    joint_stepper,
    model_beside,
    require_finite,
)
from labrun_plugins.simulated.bench.history import ACCELERATION_M_S2, Carriage, packed, unpacked
from labrun_plugins.simulated.bench.settings import BenchSettings, HiddenEffect

__all__ = [
    "ACCELERATION_M_S2", "Bench", "BenchSettings", "Carriage", "HiddenEffect", "Passage", "TowedBench",
    "described", "hidden_effects", "joint_model", "joint_stepper", "model_beside", "packed", "require_finite",
    "unpacked",
]  # fmt: skip
