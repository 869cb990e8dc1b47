"""How a fit's settings name a signal: a channel, what to take of it, and how it is averaged."""

from typing import Annotated, Any, Literal

from pydantic import BaseModel, ConfigDict, Field, PositiveFloat, model_validator

Take = Literal["value", "magnitude", "direction"]
UNITS = {"N m": "N"}
"""What a unit becomes when it is divided by a length, m."""


class SignalTable(BaseModel):
    """A signal of a fit; a text alone is its channel.

    Attributes
    ----------
    channel
        ``"device.channel"`` as recorded; ``"command.joint"``; ``"gait.a"``, a named part of the gait's formulas or of
        the condition, over time; of a recording, the name of a channel.
    side_channel
        The second axis of a force, for `take`.
    take
        ``"value"`` of the channel; ``"magnitude"`` or ``"direction"`` (deg, 0 along `channel`, +90 along
        `side_channel`) of the vector of both, each averaged first.
    scale, side_scale
        Each channel is multiplied by its own.
    divide_by_m
        Both are divided by this length, m: a torque at the end of a bar becomes the force that made it.
    average
        ``"cycle"``: mean over the gait cycle that has just passed, as a controller sees it; it delays by half a cycle.
    """

    model_config = ConfigDict(extra="forbid", frozen=True, strict=True, allow_inf_nan=False)

    channel: str
    side_channel: str | None = None
    take: Take = "value"
    scale: Annotated[float, Field()] = 1.0
    side_scale: float = 1.0
    divide_by_m: PositiveFloat | None = None
    average: Literal["none", "cycle"] = "none"

    @model_validator(mode="before")
    @classmethod
    def _text_or_table(cls, data: Any) -> Any:
        return {"channel": data} if isinstance(data, str) else data

    @model_validator(mode="after")
    def _two_channels_for_a_vector(self) -> "SignalTable":
        if self.take != "value" and self.side_channel is None:
            raise ValueError(f'take = "{self.take}" needs a side_channel')
        if self.take == "value" and self.side_channel is not None:
            raise ValueError('a side_channel needs take = "magnitude" or "direction"')
        return self

    @property
    def channels(self) -> tuple[str, ...]:
        """The channels it is made of."""
        return (self.channel,) if self.side_channel is None else (self.channel, self.side_channel)

    def unit(self, channel_unit: str) -> str:
        """Return the signal's unit, given its channel's."""
        if self.take == "direction":
            return "deg"
        if self.divide_by_m is None:
            return channel_unit
        return UNITS.get(channel_unit, f"{channel_unit}/m")
