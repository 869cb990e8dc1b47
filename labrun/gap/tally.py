"""How many simulations of the model itself were made, and how many of them left the finite numbers."""

from threading import Lock

_FEW = 0.005
"""Share of simulations below which a sentence gives one more digit."""


class Tally:
    """Counts simulations; shared by all problems that are made from one, and by threads."""

    def __init__(self) -> None:
        self._lock = Lock()
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
