"""Functions as machine code: of Python, or of checked equations; called through their address, kept on disk."""

from labrun.compiled.functions import (
    IntPointer,
    NativeFunction,
    Pointer,
    Signature,
    ThroughAddresses,
    compiled,
    inlined,
    kernel,
    native,
)
from labrun.compiled.generation import equations, generated, is_generated, law, needed, signal_step

__all__ = [
    "IntPointer", "NativeFunction", "Pointer", "Signature", "ThroughAddresses", "compiled", "equations",
    "generated", "inlined", "is_generated", "kernel", "law", "native", "needed", "signal_step",
]  # fmt: skip
