"""A learned model as two files: a description in TOML and weights in npz. Reading them executes nothing."""

import hashlib
import io
import zipfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path
from typing import Any, Protocol, cast

import numpy as np
import tomli_w
from numpy.typing import ArrayLike

from labrun import registry
from labrun.arrays import FloatArray
from labrun.errors import SpecError
from labrun.learned.network import ACTIVATIONS, Activation, Network, Scaling
from labrun.toml import parsed, text_of

_FORM = 1


@dataclass(frozen=True, slots=True)
class LearnedModel:
    """A network with its inputs and outputs.

    Attributes
    ----------
    network
    inputs, outputs
        Names and units, in the network's order.
    rig
        The bench that it was learned on, as its experiment names the scene; empty if it names none.
    added_to
        The inverse (see `load_inverse`) whose drives it corrects; empty if it gives the drives themselves.
    origin
        Run and git commit of the data, and how it was trained: for people.
    """

    network: Network
    inputs: Mapping[str, str]
    outputs: Mapping[str, str]
    rig: str = ""
    added_to: str = ""
    origin: Mapping[str, Any] = field(default_factory=dict)


def files_of(model: LearnedModel, stem: str) -> dict[str, str | bytes]:
    """Return the files of a model: name -> content."""
    packed = _packed(model.network)
    table = {
        "form": _FORM,
        **_described(model),
        "hidden": list(model.network.hidden),
        "weights": f"{stem}.npz",
        "sha256": hashlib.sha256(packed).hexdigest(),
    }
    return {f"{stem}.toml": tomli_w.dumps(table), f"{stem}.npz": packed}


def read_learned(path: Path) -> LearnedModel:
    """Read a model from its TOML and npz files.

    Raises
    ------
    SpecError
        A file that is missing, damaged, or of another fit; or weights that are no finite numbers.
    """
    data = parsed(text_of(path, kind=SpecError, what="learned model"), str(path), kind=SpecError)
    missing = [
        key for key in ("inputs", "outputs", "activation", "weights", "sha256", "scaling") if key not in data
    ]
    if missing:
        raise SpecError(
            f"{path} is not a learned model: it lacks {', '.join(missing)}",
            hint="labrun fit NAME --model mlp writes one, a .toml and an .npz beside it",
        )
    weights_path = path.parent / str(data["weights"])
    try:
        packed = weights_path.read_bytes()
    except OSError as error:
        raise SpecError(
            f"{path} has its weights in {weights_path.name}, which cannot be read: {error.strerror}",
            hint="the two files belong together: copy both",
        ) from error
    if hashlib.sha256(packed).hexdigest() != data["sha256"]:
        raise SpecError(
            f"the weights in {weights_path.name} are not those that {path} describes: another fit, or a damaged file",
            hint="copy both files of one fit; the scaling of one does not hold for the weights of another",
        )
    try:
        arrays = np.load(io.BytesIO(packed), allow_pickle=False)
        layers = sum(name.startswith("weight_") for name in arrays.files)
        weights, biases = ([arrays[f"{of}_{i}"] for i in range(layers)] for of in ("weight", "bias"))
        model = _model(data, weights, biases)
        changed = [
            n for n, values in _scaling_of(model.network).items() if not np.array_equal(arrays[n], values)
        ]
    except (KeyError, ValueError, TypeError, zipfile.BadZipFile) as error:
        raise SpecError(
            f"{path} and {weights_path.name} cannot be read as a learned model: {error}"
        ) from error
    if changed:
        raise SpecError(
            f"scaling.{changed[0]} in {path} is not that of the weights in {weights_path.name}",
            hint="the numbers of one fit belong together: copy both of its files again, or repeat the fit",
        )
    return model


def to_table(model: LearnedModel) -> dict[str, Any]:
    """Return a model as a table, for an experiment that is stored with all it needs."""
    network = model.network
    return {
        **_described(model),
        "weights": [weight.tolist() for weight in network.weights],
        "biases": [bias.tolist() for bias in network.biases],
    }


def from_table(table: Mapping[str, Any]) -> LearnedModel:
    """Return what `to_table` was given.

    Raises
    ------
    SpecError
        Tables that were changed meanwhile, so that they do not fit together any more.
    """
    try:
        return _model(table, table["weights"], table["biases"])
    except (KeyError, ValueError, TypeError) as error:
        raise SpecError(f"the learned model that stands in the experiment does not hold: {error}") from error


def _described(model: LearnedModel) -> dict[str, Any]:
    """Return everything of a model but its weights."""
    network = model.network
    return {
        "inputs": dict(model.inputs),
        "outputs": dict(model.outputs),
        "rig": model.rig,
        "added_to": model.added_to,
        "activation": network.activation,
        "scaling": {name: values.tolist() for name, values in _scaling_of(network).items()},
        "origin": dict(model.origin),
    }


def _model(
    table: Mapping[str, Any], weights: Sequence[ArrayLike], biases: Sequence[ArrayLike]
) -> LearnedModel:
    """Return the model that `_described` described, checked against its weights."""
    network = Network(
        tuple(np.array(weight, dtype=np.float64) for weight in weights),
        tuple(np.array(bias, dtype=np.float64) for bias in biases),
        _activation(table["activation"]),
        *_scalings(table["scaling"]),
    )
    model = LearnedModel(
        network,
        dict(table["inputs"]),
        dict(table["outputs"]),
        str(table.get("rig", "")),
        str(table.get("added_to", "")),
        dict(table.get("origin", {})),
    )
    sizes = [len(model.inputs), *(len(bias) for bias in network.biases)]
    shapes = [weight.shape for weight in network.weights]
    if not shapes or shapes != list(pairwise(sizes)) or sizes[-1] != len(model.outputs):
        layers = ", ".join(" x ".join(map(str, shape)) for shape in shapes) or "no layer"
        raise ValueError(
            f"weights of {layers} do not lead from {len(model.inputs)} inputs to {len(model.outputs)} outputs"
        )
    scales = [
        len(network.inputs.mean),
        len(network.inputs.scale),
        len(network.outputs.mean),
        len(network.outputs.scale),
    ]
    if scales != [len(model.inputs)] * 2 + [len(model.outputs)] * 2:
        raise ValueError("its scaling is of another number of inputs or outputs")
    if not network.finite:
        raise ValueError("its weights are not finite numbers: the training failed; fit it again")
    if not (network.inputs.sound and network.outputs.sound):
        raise ValueError("its scaling needs finite numbers, and scales above 0; fit it again")
    return model


def _activation(name: Any) -> Activation:
    if name not in ACTIVATIONS:
        raise ValueError(f"activation {name!r} is not one of {', '.join(ACTIVATIONS)}")
    return cast("Activation", name)


def _packed(network: Network) -> bytes:
    arrays: dict[str, Any] = {}
    for number, (weight, bias) in enumerate(zip(network.weights, network.biases, strict=True)):
        arrays |= {f"weight_{number}": weight, f"bias_{number}": bias}
    arrays |= _scaling_of(network)
    buffer = io.BytesIO()
    np.savez(buffer, **arrays)
    return buffer.getvalue()


def _scaling_of(network: Network) -> dict[str, FloatArray]:
    return {
        "input_mean": network.inputs.mean,
        "input_scale": network.inputs.scale,
        "output_mean": network.outputs.mean,
        "output_scale": network.outputs.scale,
    }


def _scalings(table: Mapping[str, Any]) -> tuple[Scaling, Scaling]:
    first, other = (
        Scaling(np.array(table[f"{of}_mean"], dtype=float), np.array(table[f"{of}_scale"], dtype=float))
        for of in ("input", "output")
    )
    return first, other


INVERSES = "labrun.inverses"


class Inverse(Protocol):
    """The function an entry point of group ``labrun.inverses`` names."""

    def __call__(self, values: Sequence[float]) -> tuple[float, ...]:
        """Return the drives, in the gait's own units, that ought to bring about this feedback of a loop."""
        ...


def load_inverse(name: str) -> Inverse:
    """Return an inverse by name; PluginError with the nearest name if there is none."""
    return cast("Inverse", registry.load(INVERSES, name))
