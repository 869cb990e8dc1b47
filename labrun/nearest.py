"""Which of the names there are a person meant by one that is not among them."""

import difflib
from collections.abc import Iterable


def nearest(name: str, known: Iterable[str], *, cutoff: float = 0.6) -> str | None:
    """Return the known name most like `name`, whatever its case, or None if none is alike.

    Parameters
    ----------
    name
        What was found.
    known
        What there is.
    cutoff
        Least likeness, from 0 (anything) to 1 (equal), as in `difflib.get_close_matches`.
    """
    candidates = list(known)
    folded = {candidate.casefold(): candidate for candidate in reversed(candidates)}
    found = difflib.get_close_matches(name.casefold(), folded, n=1, cutoff=cutoff)
    if found:
        return folded[found[0]]
    # Names of one letter are like nothing: "freq" or "f0" for "f".
    starts = [known for key, known in folded.items() if key and name.casefold().startswith(key)]
    return starts[0] if len(starts) == 1 else None
