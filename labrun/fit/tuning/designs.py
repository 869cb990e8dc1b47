"""All designs that were asked for, on one plant."""

from collections.abc import Mapping
from dataclasses import replace

from labrun.errors import FitError
from labrun.fit.tuning.controller import Gains
from labrun.fit.tuning.design import Design
from labrun.fit.tuning.loop import Loop
from labrun.fit.tuning.optimum import Wanted, optimum, require_stable
from labrun.fit.tuning.settings import GivenTable, PidSettings
from labrun.fit.tuning.simc import Structure, simc

_DEFAULT_FILTER_STEPS = 2.0
"""Time constant of the derivative's filter in steps, where a controller names none: as of the controller plugin."""


def design_all(loop: Loop, settings: PidSettings) -> tuple[list[Design], list[str]]:
    """Return the designs, those that were given last, and what to know about them.

    Raises
    ------
    FitError
        The plant does not settle, or no design could be made.
    """
    require_stable(loop)
    designs: list[Design] = []
    warnings: list[str] = []
    for structure in settings.structures:
        for rule in settings.rules:
            try:
                designs += _of(loop, settings, structure, rule)
            except FitError as error:
                told = f"no {structure} by {rule}: {error.args[0]}"
                warnings.append(told)
    if not designs and warnings:
        raise FitError("\n".join(warnings), hint='try method = "optimum", or smaller margins')
    designs.sort(key=lambda one: one.gains.feedforward is not None)
    return designs + given(loop, settings.compare, settings.lead_s), warnings


def wanted_of(settings: PidSettings) -> Wanted:
    """Return what an optimum keeps and minimises."""
    return Wanted(
        settings.gain_margin,
        settings.phase_margin_deg,
        settings.max_sensitivity,
        settings.criterion,
        settings.load_weight,
        settings.derivative_filter,
    )


def given(loop: Loop, tables: Mapping[str, GivenTable], lead_s: float) -> list[Design]:
    """Return gains that were written down as designs."""
    found = []
    for name, keys in tables.items():
        per_s = keys.i * (1.0 if keys.i_per == "second" else 1.0 / loop.step_s)
        filter_s = _DEFAULT_FILTER_STEPS * loop.step_s if keys.filter_s is None else keys.filter_s
        gains = Gains(
            keys.p,
            per_s,
            keys.d,
            filter_s,
            1.0 / loop.gain if keys.feedforward else None,
            lead_s if keys.feedforward else 0.0,
        )
        found.append(Design(name, "given", gains, loop))
    return found


def _of(loop: Loop, settings: PidSettings, structure: Structure, rule: str) -> list[Design]:
    name = f"{structure.lower()}-{rule}"
    inverse = 1.0 / loop.gain
    # a derivative beside a feed-forward is not asked for: what it would hasten, the feed-forward does
    also = settings.feedforward and structure != "PID"
    if rule == "simc":
        gains = simc(loop, structure, tau_c_s=settings.tau_c_s, derivative_filter=settings.derivative_filter)
        made = [Design(name, rule, gains, loop)]
        if also:
            made.append(
                Design(f"ff-{name}", rule, replace(gains, feedforward=inverse, lead_s=settings.lead_s), loop)
            )
        return made
    wanted = wanted_of(settings)
    made = [Design(name, rule, optimum(loop, structure, wanted), loop)]
    if also:
        gains = optimum(
            loop,
            structure,
            wanted,
            feedforward=inverse,
            lead_s=settings.lead_s,
            gain_error=settings.gain_error,
        )
        made.append(Design(f"ff-{name}", rule, gains, loop))
    return made
