"""The memory of a bench as JSON-ready values, exact to the last bit."""

import base64
import json
import zlib
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]


def packed(array: FloatArray) -> dict[str, Any]:
    """Return an array of float64 as shape and base64 of its bytes."""
    data = np.ascontiguousarray(array, dtype="<f8")
    return {"shape": list(data.shape), "base64": base64.b64encode(data.tobytes()).decode("ascii")}


def unpacked(stored: dict[str, Any]) -> FloatArray:
    """Return what `packed` was given."""
    data = np.frombuffer(base64.b64decode(stored["base64"]), dtype="<f8")
    return data.reshape(stored["shape"]).astype(np.float64)


def sealed(memory: dict[str, Any]) -> dict[str, Any]:
    """Return a memory in a form that nobody reads by accident."""
    text = json.dumps(memory, separators=(",", ":"))
    return {"sealed": base64.b64encode(zlib.compress(text.encode())).decode("ascii")}


def unsealed(stored: Mapping[str, Any]) -> Mapping[str, Any]:
    """Return what `sealed` was given; a memory that is not sealed as it is."""
    if "sealed" not in stored:
        return stored
    memory: dict[str, Any] = json.loads(zlib.decompress(base64.b64decode(stored["sealed"])))
    return memory


def generator_state(rng: np.random.Generator) -> dict[str, Any]:
    """Return the state of a generator; its large integers stay integers, which JSON keeps exactly."""
    return dict(rng.bit_generator.state)


def restore_generator(rng: np.random.Generator, state: dict[str, Any]) -> None:
    """Take back what `generator_state` gave."""
    rng.bit_generator.state = state
