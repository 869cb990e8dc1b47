"""Simulations made lately, up to the effects at their outputs: many candidates there share one."""

from collections import OrderedDict
from collections.abc import Callable
from dataclasses import replace
from threading import Lock
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from labrun.models import Unfiltered

_MOST_BYTES = 128_000_000


class Recent:
    """The simulations used last, as many as fit into some memory. Threads may share one."""

    def __init__(self) -> None:
        self._kept: OrderedDict[Any, Unfiltered] = OrderedDict()
        self._bytes = 0
        self._lock = Lock()

    def get(self, key: Any, make: "Callable[[], Unfiltered]") -> "Unfiltered":
        """Return the simulation of that key, without its states; `make` simulates if it is not there."""
        with self._lock:
            found = self._kept.get(key)
            if found is not None:
                self._kept.move_to_end(key)
                return found
        made = make()
        made = replace(
            made, states=made.states[:, :0].copy()
        )  # nobody asks for them here, and they are large
        with self._lock:
            if key not in self._kept:
                self._kept[key] = made
                self._bytes += _size(made)
            while self._bytes > _MOST_BYTES and len(self._kept) > 1:
                self._bytes -= _size(self._kept.popitem(last=False)[1])
        return made

    def __reduce__(self) -> tuple[type["Recent"], tuple[()]]:
        """Travel empty: what is kept holds memory of this process, and locks do not travel."""
        return Recent, ()


def _size(one: "Unfiltered") -> int:
    return one.outputs.nbytes + one.states.nbytes
