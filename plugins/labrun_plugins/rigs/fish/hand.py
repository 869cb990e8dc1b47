"""What a person changes on the fish between trials: blades, tail and dorsal fin, the water it is put into."""

from collections.abc import Iterable, Mapping

from labrun.errors import SpecError


def chosen_by_hand(
    condition: Mapping[str, float | str], name: str, kinds: Iterable[str], otherwise: str
) -> str:
    """Return which kind of `name` a condition asks for; `otherwise` where it does not say.

    Raises
    ------
    SpecError
        There is no such kind.
    """
    wanted = condition.get(name, otherwise)
    known = list(kinds)
    if wanted not in known:
        raise SpecError(f"this fish has no {name} {wanted!r}", hint=f"it has {', '.join(known)}")
    return str(wanted)
