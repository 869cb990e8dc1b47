"""What a diagnosis is asked: data, and the model they are held against."""

from collections.abc import Mapping
from dataclasses import dataclass, field

from labrun.fit import Dataset
from labrun.models import Model


@dataclass(frozen=True)
class Question:
    """Data, the model they are held against, and which recorded channel is which of its inputs and outputs."""

    dataset: Dataset
    model: Model
    signals: Mapping[str, str] = field(default_factory=dict)
