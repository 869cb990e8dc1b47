"""Feed-forward from a fitted model, with a PID for what the model does not know."""

from collections.abc import Mapping
from typing import Annotated, Any, ClassVar, Literal

from pydantic import Discriminator, Field, Tag, model_validator

from labrun.control.pid import PidController, PidSettings
from labrun.control.plant import PlantModel, read_plant
from labrun.control.protocol import FindFile, LoopContext, Step
from labrun.errors import SpecError
from labrun.toml import Table, TableFaults, checked


def _form_of_model(model: object) -> str:
    """Tell the two forms apart, so that an error is about the one that was meant."""
    return "file" if isinstance(model, str) else "table"


class FeedforwardSettings(PidSettings):
    """Keys of `feedforward+pid`: those of `pid`, and the model.

    Attributes
    ----------
    model
        Inline, see `PlantModel`, or the path of a TOML file, as ``labrun fit --model fopdt`` or ``transfer-function``
        writes it.
    response
        Which response of a file that holds several.
    lead_s
        The feed-forward looks this far ahead on the reference, which is known; ``"dead"``: by the model's dead time.
    """

    model: Annotated[
        Annotated[PlantModel, Tag("table")] | Annotated[str, Tag("file")], Discriminator(_form_of_model)
    ]
    response: str | None = None
    lead_s: Annotated[float, Field(ge=0)] | Literal["dead"] = 0.0

    @model_validator(mode="after")
    def _response_is_of_a_file(self) -> "FeedforwardSettings":
        with TableFaults() as faults:
            if self.response is not None and isinstance(self.model, PlantModel):
                faults.add("response", "chooses one of a file's responses, and the model is written inline")
        return self


class FeedforwardPid(PidController):
    """The reference over the model's static gain, plus a PID on what is left (source, Fig. 5.9 b).

    Parameters
    ----------
    settings
        See `FeedforwardSettings`.
    context
        The loop's period, range and start.
    """

    Settings: ClassVar[type[Table]] = FeedforwardSettings

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
        if not isinstance(model, str):
            return dict(settings)
        response = settings.get("response")
        if response is not None and not isinstance(response, str):
            return dict(settings)  # refused with its place when the settings are checked
        rest = {key: value for key, value in settings.items() if key != "response"}
        return {**rest, "model": read_plant(find(model), response)}

    def _checked(self, settings: Mapping[str, Any]) -> PidSettings:
        return checked(FeedforwardSettings, settings)

    def _feedforward(self, step: Step) -> float:
        return step.reference_at(step.time_s + self._lead_s) / self._gain
