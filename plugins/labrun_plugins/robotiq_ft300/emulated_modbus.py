"""The slave's side of Modbus RTU, as far as an FT300 speaks it."""

from collections.abc import Callable, Iterator

_READ, _WRITE_ONE, _WRITE_MANY = 0x03, 0x06, 0x10
_MOST_READ = 125
_LONGEST = 256


class Refusal(Exception):  # noqa: N818  not an error: one of the answers of the protocol
    """An exception code instead of an answer: 01 function, 02 register, 03 value."""

    def __init__(self, code: int) -> None:
        super().__init__(f"exception {code:02d}")
        self.code = code


def checksum(data: bytes | bytearray) -> bytes:
    """Return the two bytes that end a frame: remainder of the division by x^16 + x^15 + x^2 + 1, bits reversed."""
    remainder = 0xFFFF
    for byte in data:
        remainder ^= byte
        for _ in range(8):
            carry = remainder & 1
            remainder >>= 1
            if carry:
                remainder ^= 0xA001
    return bytes((remainder & 0xFF, remainder >> 8))


class ModbusSlave:
    """Answers requests for one address; stays silent to all else, as a real one does.

    Parameters
    ----------
    slave_id
        Its address.
    value
        Reads one register, 0 ... 65535; raises Refusal.
    set_value
        Writes one register; raises Refusal.

    """

    def __init__(
        self, slave_id: int, value: Callable[[int], int], set_value: Callable[[int, int], None]
    ) -> None:
        self.slave_id = slave_id
        self._value = value
        self._set_value = set_value
        self._kept = bytearray()

    def forget(self) -> None:
        """Drop what has come of an unfinished request: the line was quiet for a while."""
        self._kept.clear()

    def hear(self, data: bytes) -> Iterator[tuple[bytes, bytes]]:
        """Take bytes; yield each request to this slave that they complete, and its answer."""
        self._kept += data
        del self._kept[: -2 * _LONGEST]
        while len(self._kept) >= 8:
            size = self._size()
            if size is not None and len(self._kept) < size:
                return
            frame = bytes(self._kept[:size]) if size is not None else b""
            if not frame or checksum(frame[:-2]) != frame[-2:]:
                del self._kept[0]
                continue
            del self._kept[: len(frame)]
            if frame[0] == self.slave_id:
                yield frame, self._answer(frame)

    def _size(self) -> int | None:
        """Return how long the request at the head of what was kept is; None if it is none."""
        function = self._kept[1]
        if function == _WRITE_MANY:
            count = self._kept[6]
            return 9 + count if count and count % 2 == 0 and 9 + count <= _LONGEST else None
        return 8 if 1 <= function <= _WRITE_ONE else None

    def _answer(self, frame: bytes) -> bytes:
        function = frame[1]
        address = (frame[2] << 8) | frame[3]
        argument = (frame[4] << 8) | frame[5]
        try:
            if function == _READ:
                body = self._read(address, argument)
            elif function == _WRITE_ONE:
                self._set_value(address, argument)
                body = frame[2:6]
            elif function == _WRITE_MANY:
                body = self._write(address, argument, frame[7:-2])
            else:
                raise Refusal(1)
        except Refusal as refusal:
            function |= 0x80
            body = bytes((refusal.code,))
        answer = bytes((frame[0], function)) + body
        return answer + checksum(answer)

    def _read(self, address: int, count: int) -> bytes:
        if not 1 <= count <= _MOST_READ:
            raise Refusal(3)
        values = [self._value(register) for register in range(address, address + count)]
        return bytes((2 * count,)) + b"".join(bytes((v >> 8, v & 0xFF)) for v in values)

    def _write(self, address: int, count: int, data: bytes) -> bytes:
        if len(data) != 2 * count:
            raise Refusal(3)
        for number in range(count):
            self._set_value(address + number, (data[2 * number] << 8) | data[2 * number + 1])
        return bytes((address >> 8, address & 0xFF, count >> 8, count & 0xFF))
