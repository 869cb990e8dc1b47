"""Maps learned from data: networks with scaling, stored as plain arrays with a TOML file, and their training."""

from labrun.learned.artefact import (
    INVERSES,
    Inverse,
    LearnedModel,
    files_of,
    from_table,
    load_inverse,
    read_learned,
    to_table,
)
from labrun.learned.network import ACTIVATIONS, Activation, Network, Scaling
from labrun.learned.training import SlidingAffine, Solver, Training, exact_affine, train

__all__ = [
    "ACTIVATIONS", "INVERSES", "Activation", "Inverse", "LearnedModel", "Network", "Scaling", "SlidingAffine",
    "Solver", "Training", "exact_affine", "files_of", "from_table", "load_inverse", "read_learned", "to_table",
    "train",
]  # fmt: skip
