"""What people say of a controller that is to be designed: keys of ``[fit.methods.pid]`` and ``--set``."""

from typing import Annotated, Any, Literal

from pydantic import BaseModel, ConfigDict, Field, PositiveFloat, model_validator

from labrun.control import HalfSineSettings
from labrun.fit.transfer import NamedTransferTable

Number = Annotated[float, Field(allow_inf_nan=False)]
NonNegative = Annotated[float, Field(ge=0)]


class _Keys(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)


class GivenTable(_Keys):
    """Gains that somebody wrote down, to be looked at beside the designs; keys as of the controller plugins."""

    p: Number = 0.0
    i: Number = 0.0
    i_per: Literal["second", "sample"] = "second"
    d: Number = 0.0
    filter_s: NonNegative | None = None
    feedforward: bool = False


class PidFitSettings(_Keys):
    """Keys of the fit ``pid``.

    Attributes
    ----------
    plant
        Which fit gives the transfer function: ``"fopdt"`` or ``"transfer-function"``.
    plant_settings
        Its settings, over those the experiment has for it.
    response
        Which of its responses; the first, if not said.
    given_plant
        A plant instead of a fitted one: ``gain exp(-dead_s s) / (lag_s s + 1)``, or any transfer function.
    method, structure
        What is designed: by which rule, and with which terms.
    feedforward
        Also with a feed-forward, FF-P and FF-PI.
    lead_s
        How far ahead on the reference the feed-forward looks.
    rate_hz, compute_s
        Of the loop; `compute_s` is the time from the newest sample to the drive it leads to.
    feedback, period_s
        Filter of the feedback, as of the feedback plugins; `period_s` is the time a mean is taken over, the
        gait's cycle if not said.
    gain_margin, phase_margin_deg, max_sensitivity
        What the optimum keeps.
    criterion, load_weight
        What it minimises: integral of the magnitude of the error ("iae"), or of that times the time since the step
        ("itae"). A step at the plant's input that moves the output by 1 counts `load_weight`, one of the reference 1.
    tau_c_s
        Time constant that SIMC asks of the closed loop; the effective dead time, if not said.
    derivative_filter
        N: the derivative is filtered with the time constant Td/N.
    i_per
        How the snippet gives the integral.
    range
        Of the drive, when a reference is followed.
    reference
        Half-wave sine, as of the reference plugin, to be followed in the prediction; none, if not said.
    gain_error
        Relative error of the plant's gain for which that is predicted too.
    compare
        Further controllers to be looked at, by name.
    resamples
        Plants over which margins are judged.
    """

    plant: Literal["fopdt", "transfer-function"] = "fopdt"
    plant_settings: dict[str, Any] = Field(default_factory=dict)
    response: str | None = None
    given_plant: NamedTransferTable | None = None
    method: Literal["simc", "optimum", "both"] = "both"
    structure: Literal["P", "PI", "PID", "all"] = "all"
    feedforward: bool = True
    lead_s: NonNegative = 0.0
    rate_hz: Annotated[float, Field(gt=0, le=1000)] = 20.0
    compute_s: NonNegative = 0.0
    feedback: Literal["latest", "moving-average", "cycle-average"] = "cycle-average"
    period_s: PositiveFloat | None = None
    gain_margin: Annotated[float, Field(gt=1)] = 2.0
    phase_margin_deg: Annotated[float, Field(gt=0, lt=120)] = 45.0
    max_sensitivity: Annotated[float, Field(gt=1)] | None = None
    criterion: Literal["iae", "itae"] = "iae"
    load_weight: NonNegative = 1.0
    tau_c_s: PositiveFloat | None = None
    derivative_filter: Annotated[float, Field(ge=1)] = 10.0
    i_per: Literal["second", "sample"] = "second"
    range: tuple[Number, Number] | None = None
    reference: HalfSineSettings | None = None
    gain_error: Annotated[float, Field(ge=0, lt=1)] = 0.15
    compare: dict[str, GivenTable] = Field(default_factory=dict)
    resamples: Annotated[int, Field(ge=20, le=2000)] = 200

    @model_validator(mode="after")
    def _fits_together(self) -> "PidFitSettings":
        if self.range is not None and not self.range[0] < self.range[1]:
            raise ValueError(f"range: {self.range[0]:g} is not below {self.range[1]:g}")
        if self.feedback == "latest" and self.period_s is not None:
            raise ValueError('feedback = "latest" takes no mean: leave period_s out')
        return self

    @property
    def structures(self) -> tuple[Literal["P", "PI", "PID"], ...]:
        """The structures that are designed."""
        return ("P", "PI", "PID") if self.structure == "all" else (self.structure,)

    @property
    def rules(self) -> tuple[Literal["simc", "optimum"], ...]:
        """The ways they are designed."""
        return ("simc", "optimum") if self.method == "both" else (self.method,)
