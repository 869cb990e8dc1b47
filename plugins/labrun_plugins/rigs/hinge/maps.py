"""From runs of specimens to the maps of chapter 3."""

from collections.abc import Mapping, Sequence
from typing import Any, ClassVar, Literal

import numpy as np
from pydantic import BaseModel, PositiveFloat

from labrun.errors import FitError
from labrun.fit import FitJob, FitSummary, FittedData, WithSettings
from labrun.toml import Keys
from labrun_plugins.rigs.hinge.body import FOUND
from labrun_plugins.rigs.hinge.map_findings import (
    coefficient_table,
    findings,
    map_warnings,
    maps_figure,
    quality_table,
    specimen_table,
    warnings,
)
from labrun_plugins.rigs.hinge.polynomial import SYMBOLS, UNITS, FittedMap, Form, Quantity, fit_polynomial
from labrun_plugins.rigs.hinge.specimens import SIZES, Specimen, load_specimens

METHOD = "hinge-maps"
_QUANTITIES: tuple[Quantity, ...] = ("damping", "stiffness")
_ALIKE = 1e-6


class HingeMapsSettings(Keys):
    """What the conditions of the trials do not say, and which estimate of each release the maps go through.

    Attributes
    ----------
    width_mm, length_mm, area_cm2
        Hinge width, hinge length and the body's cross-section, where a trial's condition does not name them.
    way
        "simulation" (output error) or "fourier" (chapter 3's: Fourier series, differentiated, least squares).
    """

    width_mm: PositiveFloat | None = None
    length_mm: PositiveFloat | None = None
    area_cm2: PositiveFloat | None = None
    way: Literal["simulation", "fourier"] = "simulation"


class HingeMapsFit(WithSettings[HingeMapsSettings]):
    """k and b of every specimen from its releases, then the polynomials (3.6) to (3.12) through them."""

    Settings: ClassVar[type[BaseModel]] = HingeMapsSettings

    def __call__(self, job: FitJob) -> FitSummary:
        """Fit; see `fit_hinge_maps`."""
        stated = self._settings.model_dump(include={"width_mm", "length_mm", "area_cm2"}, exclude_none=True)
        return fit_hinge_maps(job, stated=stated, way=self._settings.way)


def fit_hinge_maps(
    job: FitJob, *, stated: Mapping[str, float] | None = None, way: str = "simulation"
) -> FitSummary:
    """Fit k and b of every specimen, then polynomials in the sizes that differ between specimens.

    One size alone gives (3.6) over the body's area (b only: the hinge is the same), (3.7) and (3.8) over the hinge's
    width, (3.9) and (3.10) over its length; several give b(a, l, w) by (3.11) and k(l, w) by (3.12).

    Parameters
    ----------
    job
        Its model states the body, with the names of conditions in its equations; its runs' conditions name
        ``width_mm``, ``length_mm`` and ``area_cm2``.
    way
        Which estimate of each release: "simulation" or "fourier".

    Raises
    ------
    RequestError, FitError, ModelError
        See `load_specimens`, `body_of` and `fit_polynomial`; all releases are of one specimen.
    """
    specimens = load_specimens(job, stated or {})
    forms = _forms(specimens.every)
    job.note("fitting the maps")
    maps = {way: _maps(forms, specimens.every, way, job.rng)}
    other = "fourier" if way == "simulation" else "simulation"
    maps[other] = _maps(forms, specimens.every, other, job.rng)
    fitted_maps = maps[way]

    name = " + ".join([specimens.first.name, *specimens.more])
    return FitSummary(
        METHOD,
        ", ".join(fitted.form.label for fitted in fitted_maps),
        FittedData(name, specimens.first.kind, specimens.trials, specimens.left_out),
        {name: estimate for fitted in fitted_maps for name, estimate in fitted.estimates.items()},
        {
            fitted.form.quantity: float(np.sqrt(np.mean((fitted.measured - fitted.fitted) ** 2)))
            for fitted in fitted_maps
        },
        {fitted.form.quantity: UNITS[fitted.form.quantity] for fitted in fitted_maps},
        tables=(
            *(specimen_table(fitted, specimens.every, way) for fitted in fitted_maps),
            quality_table(fitted_maps),
            *(coefficient_table(fitted) for fitted in fitted_maps),
        ),
        findings=tuple(findings(fitted_maps, maps[other], specimens.every, way)),
        warnings=(
            *specimens.refused,
            *(text for fitted in fitted_maps for text in map_warnings(fitted)),
            *warnings(fitted_maps, specimens.every, way),
        ),
        details={
            "way": way,
            "specimens": [_specimen_json(specimen) for specimen in specimens.every],
            "maps": [_map_json(fitted) for fitted in fitted_maps],
        },
        figure_data=lambda: maps_figure(fitted_maps, specimens.every, way),
    )


def _forms(specimens: Sequence[Specimen]) -> list[Form]:
    """Return the maps that the specimens ask for: over what differs between them."""
    distinct = {name: _distinct([specimen.sizes[name] for specimen in specimens]) for name in SIZES}
    varied = [name for name, count in distinct.items() if count > 1]
    if not varied:
        raise FitError(
            "all specimens have the same dimensions, so a map cannot be fitted",
            hint="--model hinge fits stiffness and damping of one specimen; a map needs three sizes or more, "
            "perhaps of other runs (--with RUN)",
        )
    straight = [name for name in varied if distinct[name] == 2]
    # the hinge is what is stiff: the body's area has no part in k
    asked = (
        (quantity, [name for name in varied if quantity == "damping" or name != "a"])
        for quantity in _QUANTITIES
    )
    return [Form.of(quantity, names, straight) for quantity, names in asked if names]


def _distinct(values: Sequence[float]) -> int:
    ordered = np.sort(values)
    return 1 + int(np.count_nonzero(np.diff(ordered) > _ALIKE * ordered[1:]))


def _maps(
    forms: Sequence[Form], specimens: Sequence[Specimen], way: str, rng: np.random.Generator
) -> list[FittedMap]:
    sizes = {name: np.array([specimen.sizes[name] for specimen in specimens]) for name in SIZES}
    columns = {quantity: FOUND.index(quantity) for quantity in _QUANTITIES}
    return [
        fit_polynomial(
            form, sizes, [specimen.by(way)[0][:, columns[form.quantity]] for specimen in specimens], rng=rng
        )
        for form in forms
    ]


def _specimen_json(specimen: Specimen) -> dict[str, Any]:
    estimates = {
        f"{SYMBOLS[quantity]}{suffix}": {"value": of[quantity].value, "ci95": list(of[quantity].ci95)}
        for suffix, of in (("", specimen.estimates), ("_fourier", specimen.fourier_estimates))
        for quantity in _QUANTITIES
    }
    return {
        "specimen": specimen.label,
        "run": specimen.run,
        **{name: specimen.sizes[letter] / factor for letter, (name, factor) in SIZES.items()},
        "releases": len(specimen.values),
        "inertia_kg_m2": specimen.body.inertia,
        "gravity_torque_n_m": specimen.body.gravity_torque,
        **estimates,
        "warnings": list(specimen.warnings),
    }


def _map_json(fitted: FittedMap) -> dict[str, Any]:
    def number(value: float) -> float | None:
        return float(value) if np.isfinite(value) else None

    rows = zip(fitted.form.names, fitted.by_releases, fitted.by_scatter, strict=True)
    return {
        "map": fitted.form.label,
        "range_m": {
            name: [float(values.min()), float(values.max())] for name, values in fitted.sizes.items()
        },
        "mae": fitted.mae,
        "mae_percent": fitted.percent(fitted.mae),
        "left_out_mae": number(fitted.left_out_mae),
        "left_out_mae_percent": number(fitted.percent(fitted.left_out_mae)),
        "condition_number": fitted.condition,
        "condition_number_raw": fitted.raw_condition,
        "intervals": {
            name: {
                "releases": [number(end) for end in releases],
                "scatter_between_specimens": [number(end) for end in scatter],
            }
            for name, releases, scatter in rows
        },
    }
