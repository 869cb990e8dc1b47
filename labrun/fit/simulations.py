"""Simulations that were made: how many left the finite numbers, and the last ones, which many candidates share."""

from collections import OrderedDict
from collections.abc import Callable, Hashable
from dataclasses import replace
from threading import Lock

from labrun.models import Unfiltered

_MOST_BYTES = 128_000_000
_FEW = 0.005
"""Share of simulations below which a sentence gives one more digit."""


class Simulations:
    """Counts simulations of a model by itself, and keeps the last ones up to the effects at their outputs.

    Shared by all problems that are made from one, and by threads.
    """

    def __init__(self) -> None:
        self._lock = Lock()
        self._kept: OrderedDict[Hashable, Unfiltered] = OrderedDict()
        self._bytes = 0
        self.made = 0
        self.broken = 0

    def count(self, *, finite: bool) -> None:
        """Count one simulation of one trial."""
        with self._lock:
            self.made += 1
            self.broken += not finite

    @property
    def remarks(self) -> tuple[str, ...]:
        """A sentence if some simulations broke; nothing else."""
        if not self.broken:
            return ()
        share = self.broken / self.made
        percent = f"{100 * share:.{1 if share < _FEW else 0}f} %"
        return (
            f"{self.broken} of {self.made} simulations of the model ({percent}) left the finite numbers while "
            "its parameters were fitted: part of what is believed of them does not simulate, and was not searched.",
        )

    def get(self, key: Hashable, make: Callable[[], Unfiltered]) -> Unfiltered:
        """Return the simulation of that key, without its states; `make` simulates if it is not there."""
        with self._lock:
            found = self._kept.get(key)
            if found is not None:
                self._kept.move_to_end(key)
                return found
        made = make()
        made = replace(made, states=made.states[:, :0].copy())  # nobody asks for them, and they are large
        with self._lock:
            if key not in self._kept:
                self._kept[key] = made
                self._bytes += _size(made)
            while self._bytes > _MOST_BYTES and len(self._kept) > 1:
                self._bytes -= _size(self._kept.popitem(last=False)[1])
        return made

    def __reduce__(self) -> tuple[type["Simulations"], tuple[()]]:
        """Travel empty: what is kept holds memory of this process, and locks do not travel."""
        return Simulations, ()


def _size(one: Unfiltered) -> int:
    return one.outputs.nbytes + one.states.nbytes
