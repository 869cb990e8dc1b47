"""One half-duplex bus of servos, shared by commands, which must not wait, and questions, which wait for answers."""

import threading
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import TYPE_CHECKING

from labrun.devices import Clock, DeviceError, opened
from labrun.devices.serial_port import SerialPort
from labrun_plugins.dynamixel.codec import (
    BROADCAST,
    FAST_SYNC_READ,
    SYNC_READ,
    Status,
    instruction,
    split_fast,
)
from labrun_plugins.dynamixel.control_table import REFUSALS, Block, Register, whole


class Complaints:
    """Makes the errors of one bus."""

    def __init__(self, device: str, baud: int, names: Mapping[int, str]) -> None:
        self._device = device
        self._baud = baud
        self._names = names

    def who(self, ids: Sequence[int]) -> str:
        """Return the joints of these ids as a person calls them."""
        return ", ".join(f"joint {self._names.get(identity, '?')} (id {identity})" for identity in ids)

    def silent(self, ids: Sequence[int], *, damaged: bool, strangers: Collection[int]) -> DeviceError:
        """Return the error for servos that do not answer, or only with noise.

        `damaged`: whether something came that was no answer. `strangers`: ids that answered without having been asked.
        """
        who = self.who(ids)
        if damaged:
            return DeviceError(
                self._device,
                f"answers of {who} arrive damaged: their check sums do not hold",
                hint="check the cable, its length and its shield; a lower baud (in servos and file) is sturdier",
            )
        others = ", ".join(str(identity) for identity in sorted(set(strangers) - set(self._names)))
        if others:
            return DeviceError(
                self._device,
                f"{who} does not answer, but id {others} does, which no joint of the file has",
                hint="compare joints.<joint>.id with the servos; two servos with one id disturb each other",
            )
        return DeviceError(
            self._device,
            f"{who} does not answer at {self._baud} bits/s",
            hint="check its power supply and plug; labrun doctor --hardware lists what answers, and at which baud",
        )

    def refused(self, status: Status, what: str) -> DeviceError:
        """Return the error for an answer that says no."""
        why = REFUSALS.get(status.refusal, f"answers with error {status.refusal}")
        return DeviceError(
            self._device,
            f"{self.who([status.id])} refuses {what}: it {why}",
            hint="another program may have changed its set-up; switch its power off and on, then try again",
        )


if TYPE_CHECKING:
    from labrun_plugins.dynamixel.sdk import HardenedHandler, HardenedPort

TRIES = 3
_PATIENCE_S = 0.04
"""An answer takes 1 ms at 1 Mbit/s, and 16 ms more behind an adapter whose latency timer nobody has set."""
_READ_S = 0.002
_COMMAND_WAIT_S = 0.008
"""What is still on its way after so long is on its way inside this computer: the wire itself is free."""
_QUIET_S = 0.02
_FAST_TRIES = 3
_HEAR_S = 0.005
_URGENT_S = 0.1
_PING_BYTES = 3


class Bus:
    """Talks to servos.

    A question holds the bus until it is answered or given up. A command waits for that only as long as an answer can be
    on the wire; a computer that is slow to hand over what has arrived does not hold it back any longer.

    Parameters
    ----------
    names
        Id -> joint, for messages.

    Attributes
    ----------
    fast
        Whether all servos know fast reads; turned off when they are not answered.
    """

    def __init__(self, device: str, port: str, baud: int, clock: Clock, names: Mapping[int, str]) -> None:
        self.device = device
        self.baud = baud
        self.fast = False
        self._clock = clock
        self._complaints = Complaints(device, baud, names)
        self._serial = SerialPort(device, port, baud, timeout_s=_READ_S)
        self._lock = threading.Lock()
        self._port: HardenedPort | None = None
        self._handler: HardenedHandler | None = None
        self._urgent: int | None = None
        self._unsettled = False
        self._fast_failures = 0

    @property
    def is_open(self) -> bool:
        """Tell whether the port is open."""
        return self._serial.is_open and self._port is not None

    @property
    def sent_s(self) -> float:
        """When the last packet left, by the clock."""
        return self._parts()[0].sent_s

    def take_gap_s(self) -> float:
        """Return the longest time for which nothing was sent, since the last time this was asked."""
        port, _ = self._parts()
        gap_s = max(port.longest_gap_s, self._clock.now() - port.sent_s)
        port.longest_gap_s = 0.0
        return gap_s

    def open(self) -> None:
        """Open the port. Raises DeviceError: the vendor's library is missing, or the port cannot be opened."""
        try:
            from labrun_plugins.dynamixel.sdk import HardenedHandler, HardenedPort
        except ImportError as error:
            raise DeviceError(
                self.device, f"needs dynamixel-sdk ({error})", hint="pip install 'labrun[dynamixel]'"
            ) from error
        self._serial.open()
        self._port = HardenedPort(self._serial, self.baud, self._clock, _PATIENCE_S)
        self._handler = HardenedHandler()
        self._unsettled = False
        self._fast_failures = 0

    def close(self) -> None:
        """Close the port; never raises."""
        self._serial.close()
        self._port = self._handler = None

    def ping(self, identity: int) -> tuple[int, int] | None:
        """Return model number and firmware of a servo; None if it does not answer."""
        port, handler = self._parts()
        for _ in range(TRIES):
            with self._question():
                packet = [0] * 10
                packet[4:8] = [identity, 3, 0, 1]
                handler.txPacket(port, packet)
                port.setPacketTimeout(14)
                status = self._settled(handler.answer(port, identity, _PING_BYTES))
            if status is not None and len(status.data) == _PING_BYTES:
                return int.from_bytes(status.data[:2], "little"), status.data[2]
        return None

    def scan(self, patience_s: float) -> dict[int, tuple[int, int]]:
        """Ask everybody who is there; return id -> (model number, firmware)."""
        port, handler = self._parts()
        models: dict[int, tuple[int, int]] = {}
        with self._question():
            packet = [0] * 10
            packet[4:8] = [BROADCAST, 3, 0, 1]
            handler.txPacket(port, packet)
            port.setPacketTimeoutMillis(1e3 * patience_s)
            while (status := handler.status(port)) is not None:
                if len(status.data) == _PING_BYTES:
                    models[status.id] = int.from_bytes(status.data[:2], "little"), status.data[2]
        return models

    def read(self, identity: int, register: Register) -> int:
        """Return a register's value. Raises DeviceError: no answer, or a refusal."""
        return register.decode(self.read_bytes(identity, Block(register.address, register.size)))

    def read_bytes(self, identity: int, block: Block) -> bytes:
        """Return the bytes of a block of one servo; raises as `read`."""
        return self._read_status(identity, block).data

    def _read_status(self, identity: int, block: Block) -> Status:
        port, handler = self._parts()
        noise = handler.noise
        for _ in range(TRIES):
            with self._question():
                handler.readTx(port, identity, block.address, block.size)
                status = self._settled(handler.answer(port, identity, block.size))
            if status is None:
                continue
            if len(status.data) == block.size:
                return status
            raise self._complaints.refused(status, f"a read of address {block.address}")
        raise self.silent([identity], damaged=handler.noise > noise)

    def write(self, identity: int, register: Register, value: int) -> None:
        """Write a register. Raises DeviceError: no answer, or a refusal."""
        port, handler = self._parts()
        noise = handler.noise
        for _ in range(TRIES):
            with self._question():
                data = list(register.encode(value))
                handler.writeTxOnly(port, identity, register.address, register.size, data)
                port.setPacketTimeout(11)
                status = self._settled(handler.answer(port, identity, 0))
            if status is None:
                continue
            if status.refusal:
                raise self._complaints.refused(status, f"{register.name} = {value}")
            return
        raise self.silent([identity], damaged=handler.noise > noise)

    def reboot(self, identity: int) -> None:
        """Restart a servo, which clears what it has latched; it does not answer for a while."""
        port, handler = self._parts()
        with self._question():
            packet = [0] * 10
            packet[4:8] = [identity, 3, 0, 8]
            handler.txPacket(port, packet)
            port.setPacketTimeout(11)
            self._settled(handler.answer(port, identity, 0))

    def group_write(
        self,
        register: Register,
        values: Mapping[int, int],
        *,
        wait_s: float | None = None,
        wanted: Callable[[], bool] = lambda: True,
    ) -> None:
        """Write a register of several servos at once; nobody answers.

        Parameters
        ----------
        register, values
            What to write: id -> value.
        wait_s
            How long a question under way may hold this back at most; None for as long as its answer can be on the wire.
        wanted
            Asked once the wait is over, right before the packet leaves: a stop may have come meanwhile.

        Raises
        ------
        DeviceError
            The port is gone.
        """
        data = {identity: register.encode(value) for identity, value in values.items()}
        self.group_write_bytes(whole(register), data, wait_s=wait_s, wanted=wanted)

    def group_write_bytes(
        self,
        block: Block,
        data: Mapping[int, bytes],
        *,
        wait_s: float | None = None,
        wanted: Callable[[], bool] = lambda: True,
    ) -> None:
        """Write neighbouring registers of several servos at once; otherwise as `group_write`."""
        port, handler = self._parts()
        parameters: list[int] = []
        for identity, own in data.items():
            parameters += [identity, *own]
        if wait_s is None:
            wait_s = _COMMAND_WAIT_S + 10.0 * 30 * len(data) / self.baud
        held = self._lock.acquire(timeout=wait_s)
        try:
            if wanted():
                handler.syncWriteTxOnly(port, block.address, block.size, parameters, len(parameters))
        finally:
            if held:
                self._lock.release()

    def group_read(
        self, ids: Sequence[int], block: Block, *, wait_s: float = -1.0, patience_s: float | None = None
    ) -> dict[int, Status]:
        """Read a block of several servos at once.

        Parameters
        ----------
        ids, block
            Whom to ask for what.
        wait_s
            How long to wait for another question's end; -1 for as long as it takes.
        patience_s
            How long to wait for the answers; None for as long as usual.

        Returns
        -------
        dict
            Id -> its answer, with its own error byte; those that did not answer in time, or refused, are missing.

        Raises
        ------
        DeviceError
            The port is gone.
        """
        port, handler = self._parts()
        self._give_way()
        if not self._lock.acquire(timeout=wait_s):
            return {}
        try:
            self._begin()
            fast = self.fast and len(ids) > 1
            handler.syncReadTx(port, block.address, block.size, list(ids), len(ids), fast)
            if patience_s is not None:
                port.setPacketTimeoutMillis(1e3 * patience_s)
            answers = self._fast_answers(ids, block) if fast else self._answers(ids, block)
            self._unsettled = len(answers) < len(ids)
            return {identity: status for identity, status in answers.items() if not status.refusal}
        finally:
            self._lock.release()

    def question(self, ids: Sequence[int], block: Block) -> bytes:
        """Return the packet that asks servos for a block, for somebody else to send; `hear` takes the answers."""
        code = FAST_SYNC_READ if self.fast and len(ids) > 1 else SYNC_READ
        where = block.address.to_bytes(2, "little") + block.size.to_bytes(2, "little")
        return instruction(BROADCAST, code, where + bytes(ids))

    def hear(self, ids: Sequence[int], block: Block) -> dict[int, Status]:
        """Return the answers to a `question`, of all servos, that come next; none if they do not come soon.

        Raises DeviceError: the port is gone.
        """
        port, handler = self._parts()
        self._give_way()
        answers: dict[int, Status] = {}
        with self._lock:
            port.setPacketTimeoutMillis(1e3 * _HEAR_S)
            while len(answers) < len(ids) and (status := handler.status(port)) is not None:
                if status.id == BROADCAST:
                    answers = split_fast(status, ids, block.size) or {}
                elif len(status.data) == block.size:
                    # another's answer to the question before was lost
                    answers = {} if status.id in answers else answers
                    answers[status.id] = status
        return answers if len(answers) == len(ids) else {}

    def spoken(self) -> None:
        """Take note that somebody else has kept the bus busy up to now."""
        port, _ = self._parts()
        port.sent_s, port.longest_gap_s = self._clock.now(), 0.0

    @property
    def file(self) -> int:
        """The port's file descriptor, which does not block. Raises DeviceError: the port is gone."""
        return self._serial.file

    def require(self, ids: Sequence[int], block: Block) -> dict[int, Status]:
        """Read a block of several servos, all of them. Raises DeviceError: one of them does not answer, or refuses."""
        statuses: dict[int, Status] = {}
        for _ in range(TRIES):
            statuses |= self.group_read([identity for identity in ids if identity not in statuses], block)
            if len(statuses) == len(ids):
                break
        # One by one the others are heard: in a group a servo that is silent may keep those after it waiting.
        return {i: statuses[i] if i in statuses else self._read_status(i, block) for i in ids}

    def silent(self, ids: Sequence[int], *, damaged: bool = False) -> DeviceError:
        """Return the error for servos that do not answer, or only with noise."""
        strangers = self._handler.strangers if self._handler is not None else ()
        return self._complaints.silent(ids, damaged=damaged, strangers=strangers)

    def who(self, ids: Sequence[int]) -> str:
        """Return the joints of these ids as a person calls them."""
        return self._complaints.who(ids)

    def _answers(self, ids: Sequence[int], block: Block) -> dict[int, Status]:
        port, handler = self._parts()
        statuses: dict[int, Status] = {}
        while len(statuses) < len(ids) and (status := handler.status(port)) is not None:
            if status.id not in ids:
                handler.strangers.add(status.id)
            elif len(status.data) == block.size or (not status.data and status.refusal):
                statuses[status.id] = status
        return statuses

    def _fast_answers(self, ids: Sequence[int], block: Block) -> dict[int, Status]:
        port, handler = self._parts()
        while (status := handler.status(port)) is not None:
            blocks = split_fast(status, ids, block.size)
            if blocks is not None:
                self._fast_failures = 0
                return blocks
        self._fast_failures += 1
        self.fast = self._fast_failures < _FAST_TRIES
        return {}

    @contextmanager
    def urgent(self) -> Iterator[None]:
        """Ask the questions of all other threads to wait meanwhile: who only waits for a lock may never get it."""
        self._urgent = threading.get_ident()
        try:
            yield
        finally:
            self._urgent = None

    def _give_way(self) -> None:
        until_s = self._clock.now() + _URGENT_S
        while self._urgent not in (None, threading.get_ident()) and self._clock.now() < until_s:
            self._clock.sleep(_URGENT_S / 50)

    @contextmanager
    def _question(self) -> Iterator[None]:
        self._give_way()
        with self._lock:
            self._begin()
            yield

    def _begin(self) -> None:
        """Drop what is left of earlier questions; after one that was given up, also what comes a little late."""
        _, handler = self._parts()
        if self._unsettled:
            until_s = self._clock.now() + _QUIET_S
            while self._serial.read() and self._clock.now() < until_s:
                pass
            self._unsettled = False
        self._serial.discard_input()
        handler.forget()

    def _settled(self, status: Status | None) -> Status | None:
        self._unsettled = status is None
        return status

    def _parts(self) -> "tuple[HardenedPort, HardenedHandler]":
        return opened(self.device, self._port), opened(self.device, self._handler)
