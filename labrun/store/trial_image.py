"""The bytes of a trial's file: laid out by HDF5 once for every shape of trial, after that only what differs is written.

Most of what a small HDF5 file costs is the making of its objects, and the trials of a run differ in their numbers
only: the same devices, channels and units, and often as many samples. So from the second trial of a shape on, a copy of
an image is opened in memory, HDF5 writes the attributes that differ into it, and the samples go to where HDF5 says that
each dataset stands. A `Template` is used only after what it gives was found equal, byte for byte, to what HDF5 wrote.
"""

from collections import OrderedDict
from collections.abc import Hashable, Mapping
from dataclasses import dataclass, replace

import numpy as np
from h5py import h5d, h5g

from labrun.store import hdf5
from labrun.store.attributes import MAX_FIXED, Attribute, rewrite_attribute, write_attributes
from labrun.store.hdf5 import HeldColumn, StoredTable, Table

OUTCOME = "outcome"
_PAD = 512
"""The outcome's JSON is filled with spaces to a multiple of this, so that the trials of a run have it of one length."""
_KEPT_BYTES = 32 << 20
"""Templates in memory, all together."""
_KEPT_SHAPES = 4096


@dataclass(frozen=True, slots=True)
class Content:
    """What a trial's file holds: attributes of its root, `OUTCOME` among them, and its tables."""

    attributes: Mapping[str, Attribute]
    tables: tuple[Table, ...]

    def shape(self) -> Hashable:
        """Return everything but the samples, the tare offsets, and the numbers and the outcome's text at the root."""
        root = tuple(
            (name, len(str(value)) if name == OUTCOME else value if isinstance(value, str) else type(value))
            for name, value in self.attributes.items()
        )
        tables = tuple(
            (
                table.name,
                tuple(table.attributes.items()),
                tuple((c.name, c.unit, len(c.values), tuple(c.attributes)) for c in table.columns),
            )
            for table in self.tables
        )
        return root, tables

    def padded(self) -> "Content":
        """Return the same with the outcome's text, which is ASCII, filled up with spaces: JSON allows them."""
        text = str(self.attributes[OUTCOME])
        return replace(self, attributes={**self.attributes, OUTCOME: text + " " * (-len(text) % _PAD)})

    def cleared(self) -> "Content":
        """Return the same without what trials of a shape differ in."""
        root = {
            name: type(value)(0) if not isinstance(value, str) else value
            for name, value in self.attributes.items()
        }
        root[OUTCOME] = " " * len(str(root[OUTCOME]))
        tables = tuple(
            replace(
                table,
                columns=tuple(
                    replace(c, values=np.zeros(len(c.values)), attributes=dict.fromkeys(c.attributes, 0.0))
                    for c in table.columns
                ),
            )
            for table in self.tables
        )
        return Content(root, tables)

    def write(self) -> tuple[bytes, tuple[int | None, ...]]:
        """Let HDF5 write it; return the file's bytes, and where each column's values stand, None for an empty one."""
        file = hdf5.create_in_memory()
        try:
            write_attributes(file, self.attributes)
            datasets = [dataset for table in self.tables for dataset in hdf5.write_table(file, table)]
            image = hdf5.image(file)
            return image, tuple(dataset.get_offset() for dataset in datasets)
        finally:
            file.close()


@dataclass(frozen=True, slots=True, weakref_slot=True)
class Places:
    """Where the samples stand in the image of a trial of one shape.

    Attributes
    ----------
    columns_at
        Place of every column's values; None for an empty one.
    tables
        Of a trial of the shape: names, units, attributes; samples and tare offsets are zeros.
    """

    columns_at: tuple[int | None, ...]
    tables: tuple[Table, ...]

    def read(self, image: bytes, tare: Mapping[str, float]) -> dict[str, StoredTable]:
        """Return the tables in the image of a trial of this shape; `tare` has its offsets by ``device.channel``."""
        places = iter(self.columns_at)
        found = {}
        for table in self.tables:
            columns = []
            for column in table.columns:
                where, count = next(places), len(column.values)
                values = column.values if where is None else np.frombuffer(image, "<f8", count, where)
                attributes = {name: float(tare[f"{table.name}.{column.name}"]) for name in column.attributes}
                columns.append(HeldColumn(column.name, column.unit, attributes, values))
            found[table.name] = StoredTable(table.name, tuple(columns), table.attributes)
        return found


@dataclass(frozen=True, slots=True)
class Template:
    """The image of a cleared trial of a shape, its attributes, and where its samples stand."""

    image: bytes
    attributes: Mapping[str, Attribute]
    places: Places

    @classmethod
    def of(cls, content: Content) -> "Template":
        """Make the template of a (padded) trial's shape."""
        cleared = content.cleared()
        image, columns_at = cleared.write()
        return cls(image, cleared.attributes, Places(columns_at, cleared.tables))

    def filled(self, content: Content) -> bytes:
        """Return the image of a (padded) trial of the shape."""
        file = hdf5.open_image(self.image)
        try:
            for name, value in content.attributes.items():
                if repr(value) != repr(self.attributes[name]):  # -0.0 is not 0.0 here
                    rewrite_attribute(file, name, value)
            for table in content.tables:
                if not any(column.attributes for column in table.columns):
                    continue
                group = h5g.open(file, table.name.encode())
                for column in table.columns:
                    for name, value in column.attributes.items():
                        rewrite_attribute(h5d.open(group, column.name.encode()), name, value)
            image = bytearray(hdf5.image(file))
        finally:
            file.close()
        columns = (column.values for table in content.tables for column in table.columns)
        for where, values in zip(self.places.columns_at, columns, strict=True):
            if where is not None:
                np.frombuffer(image, "<f8", len(values), where)[:] = values
        return bytes(image)


class Templates:
    """The templates of the shapes seen lately; a shape gets one when it comes the second time."""

    def __init__(self) -> None:
        self._known: OrderedDict[Hashable, Template | None] = OrderedDict()
        self._bytes = 0

    def image(self, content: Content) -> tuple[bytes, Places | None]:
        """Return the bytes of a trial's file, and where the samples stand in them, if that is kept."""
        if len(str(content.attributes[OUTCOME])) + _PAD > MAX_FIXED:
            return content.write()[0], None
        content = content.padded()
        shape = content.shape()
        template = self._known.get(shape)
        if template is not None:
            self._known.move_to_end(shape)
            return template.filled(content), template.places
        image = content.write()[0]
        if shape in self._known:
            template = Template.of(content)
            if template.filled(content) != image:
                return image, None
        self._remember(shape, template)
        return image, None if template is None else template.places

    def _remember(self, shape: Hashable, template: Template | None) -> None:
        self._known[shape] = template
        self._bytes += 0 if template is None else len(template.image)
        while self._bytes > _KEPT_BYTES or len(self._known) > _KEPT_SHAPES:
            _, oldest = self._known.popitem(last=False)
            self._bytes -= 0 if oldest is None else len(oldest.image)
