"""Skogestad's rules (SIMC): gains from one or two lags and a dead time."""

from typing import Literal

from labrun.fit.tuning.controller import Gains
from labrun.fit.tuning.half_rule import Reduced, reduce_order
from labrun.fit.tuning.loop import Loop

Structure = Literal["P", "PI", "PID"]


def simc(
    loop: Loop, structure: Structure, *, tau_c_s: float | None = None, derivative_filter: float = 10.0
) -> Gains:
    """Return the gains for a loop, whose sampling, computation and averaging count as dead time.

    Parameters
    ----------
    loop
        Around a stable plant with real poles.
    structure
        P takes the gain of PI and leaves out the integral.
    tau_c_s
        Time constant that the closed loop should have; the effective dead time, if None.
    derivative_filter
        N: the derivative's filter has the time constant Td/N.

    Raises
    ------
    FitError
        The plant has complex or unstable poles.
    """
    extra_s = loop.delay_s - float(loop.plant.dead_s)
    reduced = reduce_order(loop.plant, 2 if structure == "PID" else 1, extra_s)
    return rules(reduced, structure, tau_c_s=tau_c_s, derivative_filter=derivative_filter)


def rules(
    reduced: Reduced, structure: Structure, *, tau_c_s: float | None = None, derivative_filter: float = 10.0
) -> Gains:
    """Return the gains for a reduced plant.

    ``Kc = lag / (gain (tau_c + dead))``, ``Ti = min(lag, 4 (tau_c + dead))``, ``Td = second lag`` in the series form
    ``Kc (1 + 1/(Ti s)) (1 + Td s)``, given here in parallel form: Skogestad, J. Process Control 13 (2003) 291-309,
    (23)-(25). A plant of one lag gets ``Td = dead/3``, the improved rule of Grimholt and Skogestad, J. Process Control
    70 (2018) 36-46. A plant without a lag gets a pure integral.
    """
    tau_c_s = reduced.dead_s if tau_c_s is None else tau_c_s
    closed_s = tau_c_s + reduced.dead_s
    integral_s = min(reduced.lag_s, 4.0 * closed_s)
    # lag over integral time; where both are zero, the rule's limit
    ratio = reduced.lag_s / integral_s if integral_s > 0 else 1.0
    series = reduced.lag_s / (reduced.gain * closed_s)
    per_s = ratio / (reduced.gain * closed_s)
    if structure == "P":
        return Gains(series if reduced.lag_s > 0 else 0.5 / reduced.gain)
    if structure == "PI":
        return Gains(series, per_s)
    derivative_s = reduced.second_lag_s or reduced.dead_s / 3.0
    p, d = series + per_s * derivative_s, series * derivative_s
    return Gains(p, per_s, d, d / p / derivative_filter if p else 0.0)
