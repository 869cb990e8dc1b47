"""Work of a force along its way, or of a torque through its angle, in each cycle."""

from typing import Any, ClassVar, Literal

import numpy as np
from pydantic import model_validator

from labrun.arrays import FloatArray
from labrun.errors import ExperimentError
from labrun.objectives.channel import ChannelObjective, ChannelSettings, Following
from labrun.objectives.protocol import TrialSignals
from labrun.toml import TableFaults, suggest


class WorkSettings(ChannelSettings):
    """Keys of `work`.

    Attributes
    ----------
    over
        The channel of the angle (rad) or way (m) along which the force or torque works.
    over_command
        Instead: a joint, whose angle is taken as it was told, where nothing measures it.
    part
        What of a cycle is given: "positive" and "negative" work, "net", their difference, "total", their sum, or
        "efficiency", net over total in magnitude, %.
    by
        What tells positive from negative: the sign of the "force" (which way it pushes: of a stroke to and fro one
        half propels and the other recovers), or that of the "power" (what the drive puts in, and what it gets back).
    """

    over: str | None = None
    over_command: str | None = None
    part: Literal["positive", "negative", "net", "total", "efficiency"] = "net"
    by: Literal["force", "power"] = "force"

    @model_validator(mode="after")
    def _one_way(self) -> "WorkSettings":
        with TableFaults() as faults:
            if (self.over is None) == (self.over_command is None):
                faults.add("over", "give one of over and over_command", of=("over", "over_command"))
        return self


class Work(ChannelObjective):
    """Work of a cycle, J: integral of the magnitude of force times way, split by the sign of force or power.

    Without a cycle it is the work of the whole recording. The source calls efficiency what a cycle's pushes have in
    common, over all of them (section 7.4, inferred): |W+ - W-|/(W+ + W-).
    """

    Settings: ClassVar[type[ChannelSettings]] = WorkSettings
    channel_settings: ClassVar[tuple[str, ...]] = ("over",)
    _settings: WorkSettings

    def unit(self, channel_unit: str) -> str:  # noqa: ARG002
        """Return "J", or "%" of an efficiency."""
        return "%" if self._settings.part == "efficiency" else "J"

    def __call__(self, signals: TrialSignals) -> float:
        """Return the number. Raises ExperimentError: an efficiency where no work was done; no such channel or joint."""
        positive, negative, keys = 0.0, 0.0, self._settings
        ways = self._ways(signals)
        for piece in map(self._scaled, signals.counting_pieces(self.channel)):
            up, down = split_work(piece.values, ways(piece.time_s), keys.by)
            positive, negative = positive + up, negative + down
        start_s, end_s = signals.window()
        cycles = 1.0 if signals.period_s is None else max(round((end_s - start_s) / signals.period_s), 1)
        positive, negative = positive / cycles, negative / cycles
        if keys.part == "efficiency":
            if positive + negative == 0.0:
                raise ExperimentError(
                    f"{self.channel} does no work over {keys.over or keys.over_command}: it has no efficiency"
                )
            return 100.0 * abs(positive - negative) / (positive + negative)
        return {
            "positive": positive, "negative": negative, "net": positive - negative, "total": positive + negative,
        }[keys.part]  # fmt: skip

    def _ways(self, signals: TrialSignals) -> Any:
        """Return a function that gives the way at ascending times."""
        if self._settings.over is not None:
            return Following(signals.counting_pieces(self._settings.over)).at
        joint, joints = self._settings.over_command or "", signals.command.joints
        if joint not in joints:
            raise ExperimentError(
                f"over_command = {joint!r}: no such joint was commanded",
                hint=suggest(joint, joints, kind="commanded"),
            )
        column = joints.index(joint)
        return lambda time_s: signals.command.at(time_s - signals.start_s)[:, column]


def split_work(force: FloatArray, way: FloatArray, by: Literal["force", "power"]) -> tuple[float, float]:
    """Return how much work was done where the force, or the power, is positive, and where it is negative; both >= 0.

    Between samples both run straight; an interval in which the force changes its sign is divided where it does.
    `force`, `way`, (n,): at the same times.
    """
    step = np.diff(way)
    first, last = force[:-1], force[1:]
    crosses = first * last < 0.0
    share = np.where(crosses, np.abs(first) / np.where(crosses, np.abs(first) + np.abs(last), 1.0), 1.0)
    # two parts of each interval: before the sign changes, and after it; without a change the first is all of it
    before = step * share * np.where(crosses, 0.5 * first, 0.5 * (first + last))
    after = np.where(crosses, step * (1.0 - share) * 0.5 * last, 0.0)
    work = np.concatenate([before, after])
    force_sign = np.concatenate([np.where(crosses, first, first + last), last])
    sign = force_sign if by == "force" else work
    amount = np.abs(work)
    return float(amount[sign > 0.0].sum()), float(amount[sign < 0.0].sum())
