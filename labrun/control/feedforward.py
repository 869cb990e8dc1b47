"""Feed-forward from a fitted model, with a PID for what the model does not know."""

from collections.abc import Mapping
from typing import Annotated, Any, ClassVar, Literal

from pydantic import Discriminator, Field, Tag

from labrun.control.pid import PidController, PidSettings
from labrun.control.plant import PlantModel, read_plant
from labrun.control.protocol import FindFile, LoopContext, Step
from labrun.control.settings import ControlSettings, checked
from labrun.errors import SpecError


def _form_of_model(model: object) -> str:
    """Tell the two forms apart, so that an error is about the one that was meant."""
    return "file" if isinstance(model, str) else "table"


class FeedforwardSettings(PidSettings):
    """Keys of `feedforward+pid`: those of `pid`, and the model.

    Attributes
    ----------
    model
        Inline, see `PlantModel`, or the path of a TOML file with these keys, as ``labrun fit --model fopdt`` writes it.
    lead_s
        The feed-forward looks this far ahead on the reference, which is known; ``"dead"``: by the model's dead time.
    """

    model: Annotated[
        Annotated[PlantModel, Tag("table")] | Annotated[str, Tag("file")], Discriminator(_form_of_model)
    ]
    lead_s: Annotated[float, Field(ge=0)] | Literal["dead"] = 0.0


class FeedforwardPid(PidController):
    """The reference over the model's static gain, plus a PID on what is left (source, Fig. 5.9 b).

    Parameters
    ----------
    settings
        See `FeedforwardSettings`.
    context
        The loop's period, range and start.
    """

    Settings: ClassVar[type[ControlSettings]] = FeedforwardSettings

    def __init__(self, settings: Mapping[str, Any], context: LoopContext) -> None:
        super().__init__(settings, context)
        keys = checked(FeedforwardSettings, settings)
        if isinstance(keys.model, str):
            raise SpecError(
                f'the model "{keys.model}" is a file, and was not read',
                hint="load the experiment from its file, or write the model inline",
            )
        self._gain = keys.model.static_gain
        self._lead_s = keys.model.dead_s if keys.lead_s == "dead" else float(keys.lead_s)

    @staticmethod
    def embed(settings: Mapping[str, Any], find: FindFile) -> dict[str, Any]:
        """Return the settings with the model that their file holds."""
        model = settings.get("model")
        return {**settings, "model": read_plant(find(model))} if isinstance(model, str) else dict(settings)

    def _checked(self, settings: Mapping[str, Any]) -> PidSettings:
        return checked(FeedforwardSettings, settings)

    def _feedforward(self, step: Step) -> float:
        return step.reference_at(step.time_s + self._lead_s) / self._gain
