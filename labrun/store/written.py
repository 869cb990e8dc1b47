"""What is known of a trial's file that this process wrote."""

from collections.abc import Mapping
from dataclasses import dataclass
from hashlib import blake2b
from pathlib import Path
from typing import TYPE_CHECKING
from weakref import ReferenceType

if TYPE_CHECKING:
    from labrun.store.hdf5 import StoredTable
    from labrun.store.trial_image import Places


@dataclass(frozen=True, slots=True)
class Written:
    """A trial's file as it was written.

    Attributes
    ----------
    digest
        BLAKE2b of the file, as in the journal.
    tare
        Offsets by ``device.channel``.
    places
        Where its samples stand; forgotten with the template.
    """

    digest: str
    tare: Mapping[str, float]
    places: "ReferenceType[Places]"

    def tables(self, path: Path) -> "dict[str, StoredTable] | None":
        """Read the file without HDF5; None where it is not as it was written, or its places are forgotten."""
        places = self.places()
        if places is None:
            return None
        image = path.read_bytes()
        return places.read(image, self.tare) if digest_of(image) == self.digest else None


def digest_of(content: bytes) -> str:
    """Return the digest of a trial's file that stands in the journal."""
    return blake2b(content, digest_size=16).hexdigest()
