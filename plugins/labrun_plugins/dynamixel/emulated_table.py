"""The control table of an emulated servo: what stands where, who may write it, and when.

Written from the manual's pages, apart from the host's table.
"""

from dataclasses import dataclass
from typing import Literal

Access = Literal["read", "eeprom", "ram"]
_MANY = 2**31 - 1


@dataclass(frozen=True, slots=True)
class Entry:
    """One line of the manual's table."""

    address: int
    size: int
    access: Access
    start: int
    low: int = 0
    high: int = _MANY


def entries(model: int, firmware: int) -> dict[int, Entry]:
    """Return the lines of a model's table by address.

    Models from 1060 to 1090 and 1160 measure load, and have neither current limit nor goal current.
    """
    lines = [
        Entry(0, 2, "read", model), Entry(2, 4, "read", 0), Entry(6, 1, "read", firmware),
        Entry(7, 1, "eeprom", 1, 0, 252), Entry(8, 1, "eeprom", 1, 0, 7), Entry(9, 1, "eeprom", 250, 0, 254),
        Entry(10, 1, "eeprom", 0, 0, 13), Entry(11, 1, "eeprom", 3, 0, 16), Entry(12, 1, "eeprom", 255, 0, 255),
        Entry(13, 1, "eeprom", 2, 1, 22), Entry(20, 4, "eeprom", 0, -1_044_479, 1_044_479),
        Entry(24, 4, "eeprom", 10, 0, 1023), Entry(31, 1, "eeprom", 80, 0, 100),
        Entry(32, 2, "eeprom", 160, 95, 160), Entry(34, 2, "eeprom", 95, 95, 160),
        Entry(36, 2, "eeprom", 885, 0, 885), Entry(38, 2, "eeprom", 1193, 0, 1193),
        Entry(44, 4, "eeprom", 330, 0, 1023), Entry(48, 4, "eeprom", 4095, 0, 4095),
        Entry(52, 4, "eeprom", 0, 0, 4095), Entry(60, 1, "eeprom", 0, 0, 3), Entry(63, 1, "eeprom", 52, 0, 255),
        Entry(64, 1, "ram", 0, 0, 1), Entry(65, 1, "ram", 0, 0, 1), Entry(68, 1, "ram", 2, 0, 2),
        Entry(69, 1, "read", 0), Entry(70, 1, "read", 0), Entry(76, 2, "ram", 1920, 0, 16383),
        Entry(78, 2, "ram", 100, 0, 16383), Entry(80, 2, "ram", 0, 0, 16383), Entry(82, 2, "ram", 0, 0, 16383),
        Entry(84, 2, "ram", 800, 0, 16383), Entry(88, 2, "ram", 0, 0, 16383), Entry(90, 2, "ram", 0, 0, 16383),
        Entry(98, 1, "ram", 0, 0, 127), Entry(100, 2, "ram", 885, -_MANY), Entry(102, 2, "ram", 1193, -_MANY),
        Entry(104, 4, "ram", 0, -_MANY), Entry(108, 4, "ram", 0, 0, 32767), Entry(112, 4, "ram", 0, 0, 32767),
        Entry(116, 4, "ram", 0, -_MANY), Entry(120, 2, "read", 0), Entry(122, 1, "read", 0),
        Entry(123, 1, "read", 0), Entry(124, 2, "read", 0), Entry(126, 2, "read", 0), Entry(128, 4, "read", 0),
        Entry(132, 4, "read", 0), Entry(136, 4, "read", 0), Entry(140, 4, "read", 0), Entry(144, 2, "read", 120),
        Entry(146, 1, "read", 35), Entry(147, 1, "read", 0),
    ]  # fmt: skip
    lines += [Entry(168 + 2 * n, 2, "ram", 224 + n, 64, 661) for n in range(28)]
    lines += [Entry(578 + 2 * n, 2, "ram", 634 + n, 64, 661) for n in range(28)]
    measures_load = 1060 <= model <= 1090 or model == 1160
    return {line.address: line for line in lines if not (measures_load and line.address in (38, 102))}


def indirect(address: int) -> int | None:
    """Return where the pointer of an indirect data byte stands; None for an ordinary address."""
    if 224 <= address <= 251:
        return 168 + 2 * (address - 224)
    if 634 <= address <= 661:
        return 578 + 2 * (address - 634)
    return None


class Refusal(Exception):  # noqa: N818  named after what the servo does
    """The servo answers with this error number."""

    def __init__(self, number: int) -> None:
        super().__init__(number)
        self.number = number


RANGE, LENGTH, LIMIT, ACCESS = 4, 5, 6, 7


class Table:
    """The memory of one servo, with the rules of the manual about reading and writing.

    Parameters
    ----------
    model, firmware
        Decide which lines there are.
    """

    def __init__(self, model: int, firmware: int) -> None:
        self.lines = entries(model, firmware)
        self._memory = bytearray(700)
        self._owner = {a + n: line for a, line in self.lines.items() for n in range(line.size)}
        for line in self.lines.values():
            self.set(line.address, line.start)

    def get(self, address: int, *, signed: bool = False) -> int:
        """Return the value of a line."""
        size = self.lines[address].size
        return int.from_bytes(self._memory[address : address + size], "little", signed=signed)

    def set(self, address: int, value: int) -> None:
        """Put a value, without any rule."""
        size = self.lines[address].size
        self._memory[address : address + size] = (value % 256**size).to_bytes(size, "little")

    def restart(self) -> None:
        """Forget everything but what EEPROM keeps."""
        for line in self.lines.values():
            if line.access != "eeprom":
                self.set(line.address, line.start)

    def read(self, address: int, length: int) -> bytes:
        """Return bytes.

        Raises
        ------
        Refusal
            There is nothing at one of these addresses.
        """
        found = bytearray()
        for place in range(address, address + length):
            target = self._target(place)
            if target not in self._owner:
                raise Refusal(ACCESS)
            found.append(self._memory[target])
        return bytes(found)

    def check(self, address: int, data: bytes) -> list[tuple[Entry, int]]:
        """Return the lines that data would write, and their new values.

        Raises
        ------
        Refusal
            Read-only, no such address, half a line, EEPROM while the torque is on, or out of range.
        """
        changed = dict(zip((self._target(address + n) for n in range(len(data))), data, strict=True))
        touched: list[Entry] = []
        for place in changed:
            line = self._owner.get(place)
            if line is None or line.access == "read" or (line.access == "eeprom" and self.get(64)):
                raise Refusal(ACCESS)
            if line not in touched:
                touched.append(line)
        written = []
        for line in touched:
            places = range(line.address, line.address + line.size)
            if any(place not in changed for place in places):
                raise Refusal(LENGTH)
            value = int.from_bytes(bytes(changed[p] for p in places), "little", signed=line.low < 0)
            if not line.low <= value <= line.high:
                raise Refusal(RANGE)
            written.append((line, value))
        return written

    def _target(self, address: int) -> int:
        pointer = indirect(address)
        return address if pointer is None else self.get(pointer)
