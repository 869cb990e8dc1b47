"""What is hidden in which case: drawn from decks, so that every sixty cases have the same mixture of kinds."""

from dataclasses import dataclass

import numpy as np

from .forms import FORMS, OUTSIDE, OUTSIDE_SIGNALS
from .mechanism import Kind
from .plant import Plant
from .plants import PLANTS

DECK = {"control": 20, "outside": 7, "pair": 5, "parameter": 3, "effect": 25}
"""Cases of each kind in sixty."""
_BLOCK = sum(DECK.values())
_TRIES = 400


@dataclass(frozen=True)
class Chosen:
    """What to hide where: ids with their sites; an id of `OUTSIDE` or `OUTSIDE_SIGNALS` where `outside`."""

    plant: Plant
    hidden: tuple[tuple[Kind, str, str], ...]
    outside: bool = False


def kind_of(seed: int, index: int) -> str:
    """Return the kind of a case, whatever other cases are made."""
    block, place = divmod(index, _BLOCK)
    deck = [kind for kind, count in DECK.items() for _ in range(count)]
    order = np.random.default_rng([seed, 20211, block]).permutation(_BLOCK)
    return deck[int(order[place])]


def stream_of(only: str | None) -> tuple[int, ...]:
    """Return what keeps cases of one kind alone apart from those that the mixture has under the same seed."""
    # counted from one: a zero at the end of a seed would give the mixture's own numbers
    return () if only is None else (1 + list(DECK).index(only),)


def aim_of(kind: str, rng: np.random.Generator) -> float:
    """Return the gap to aim at after recalibration, in units of one trial's noise."""
    low, high = {"pair": (0.5, 30.0), "parameter": (1.0, 30.0)}.get(kind, (0.1, 30.0))
    return float(np.exp(rng.uniform(np.log(low), np.log(high))))


def strength_class(gap: float) -> str:
    """Return the class of a gap."""
    return "below 0.5" if gap < 0.5 else "0.5 to 1" if gap < 1 else "1 to 3" if gap < 3 else "3 and above"


def places(plant: Plant) -> list[tuple[Kind, str, str]]:
    """Return every (site kind, effect, site) that may be hidden in a plant."""
    found: list[tuple[Kind, str, str]] = []
    for site in plant.sites:
        found += [(site.kind, effect, site.name) for effect in site.effects]
    for way, table in (("input", plant.input_effects), ("output", plant.output_effects)):
        for name, effects in table.items():
            found += [(way, effect, name) for effect in effects]  # type: ignore[misc]
    return found


def draw_plant(rng: np.random.Generator) -> Plant:
    """Return any bench."""
    return PLANTS[rng.integers(len(PLANTS))](rng)


def choose(kind: str, rng: np.random.Generator) -> Chosen:
    """Return a bench and what to hide in it."""
    if kind in ("control", "parameter"):
        return Chosen(draw_plant(rng), ())
    if kind == "outside":
        return _choose_outside(rng)
    if kind == "pair":
        while True:
            plant = draw_plant(rng)
            there = places(plant)
            first, second = (there[one] for one in rng.choice(len(there), 2, replace=False))
            # the same physics twice, or two filters of one signal, would be one cause to anyone
            if first[1] != second[1] and first[2] != second[2]:
                return Chosen(plant, (first, second))
    wanted = list(FORMS)[rng.integers(len(FORMS))]
    for _ in range(_TRIES):
        plant = draw_plant(rng)
        fitting = [one for one in places(plant) if one[:2] == wanted]
        if fitting:
            return Chosen(plant, (fitting[rng.integers(len(fitting))],))
    raise LookupError(f"no bench takes {wanted[1]} at a {wanted[0]}")


def _choose_outside(rng: np.random.Generator) -> Chosen:
    while True:
        plant = draw_plant(rng)
        if rng.random() < 0.75:
            name = list(OUTSIDE)[rng.integers(len(OUTSIDE))]
            site = plant.sites[rng.integers(len(plant.sites))]
            # a swimming body has no stroke over which anything could repeat
            if not plant.returns:
                if name in ("shaken-base", "warming-damper"):
                    return Chosen(plant, ((site.kind, name, site.name),), outside=True)
                continue
            if not plant.states and name in ("second-mode", "flutter"):
                continue
            return Chosen(plant, ((site.kind, name, site.name),), outside=True)
        name = list(OUTSIDE_SIGNALS)[rng.integers(len(OUTSIDE_SIGNALS))]
        ways: list[tuple[Kind, str]] = [("output", one.name) for one in plant.outputs]
        if plant.states:
            ways += [("input", one.name) for one in plant.inputs]
        way, signal = ways[rng.integers(len(ways))]
        return Chosen(plant, ((way, name, signal),), outside=True)
