"""Stiffness and damping over specimens."""

from typing import TYPE_CHECKING, ClassVar, Literal

from pydantic import BaseModel, ConfigDict, PositiveFloat

from labrun.fit.method import FitJob

if TYPE_CHECKING:
    from labrun.fit.summary import FitSummary


class HingeMapsSettings(BaseModel):
    """What the conditions of the trials do not say, and which estimate of each release the maps go through.

    Attributes
    ----------
    width_mm, length_mm, area_cm2
        Hinge width, hinge length and the body's cross-section, where a trial's condition does not name them.
    way
        "simulation" (output error) or "fourier" (chapter 3's: Fourier series, differentiated, least squares).
    """

    model_config = ConfigDict(extra="forbid", frozen=True)

    width_mm: PositiveFloat | None = None
    length_mm: PositiveFloat | None = None
    area_cm2: PositiveFloat | None = None
    way: Literal["simulation", "fourier"] = "simulation"


class HingeMapsFit:
    """k and b of every specimen from its releases, then the polynomials (3.6) to (3.12) through them."""

    Settings: ClassVar[type[BaseModel]] = HingeMapsSettings

    def __init__(self, settings: HingeMapsSettings) -> None:
        self._settings = settings

    def __call__(self, job: FitJob) -> "FitSummary":
        """Fit; see `labrun.fit.hinge_maps.fitting.fit_hinge_maps`."""
        from labrun.fit.hinge_maps.fitting import fit_hinge_maps

        stated = self._settings.model_dump(include={"width_mm", "length_mm", "area_cm2"}, exclude_none=True)
        return fit_hinge_maps(job, stated=stated, way=self._settings.way)
