"""Fitted transfer functions as a fit's result: estimates, sentences, TOML and picture."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from labrun.fit.estimate import Estimate
from labrun.fit.signals import SignalSet
from labrun.fit.summary import FitSummary, FittedData, TextTable
from labrun.fit.transfer.coefficients import responses_toml, to_table
from labrun.fit.transfer.findings import leftovers, warnings_of
from labrun.fit.transfer.fitting import TransferFit
from labrun.fit.transfer.transfer import Transfer


@dataclass(frozen=True, slots=True)
class TransferSummary(FitSummary):
    """A `FitSummary` with what was found by response.

    Attributes
    ----------
    transfers
        The transfer functions themselves.
    resampled
        Others that the data do not rule out.
    estimates
        Which of `parameters` are whose.
    """

    transfers: Mapping[str, Transfer] = field(default_factory=dict)
    resampled: Mapping[str, Sequence[Transfer]] = field(default_factory=dict)
    estimates: Mapping[str, Mapping[str, Estimate]] = field(default_factory=dict)

    @property
    def transfer(self) -> Transfer:
        """The one transfer function; the first of several."""
        return next(iter(self.transfers.values()))


def summarise(
    method: str,
    fits: Mapping[str, TransferFit],
    signals: SignalSet,
    *,
    tables: Sequence[TextTable] = (),
    findings: Sequence[str] = (),
) -> TransferSummary:
    """Return the result of a fit of one or more responses."""
    from labrun.fit.transfer.picture import draw_responses

    estimates: dict[str, dict[str, Estimate]] = {}
    written = {}
    said = list(findings)
    warned: list[str] = []
    for name, fit in fits.items():
        mine = _estimates(fit)
        estimates[name] = {f"{name}_{key}": estimate for key, estimate in mine.items()}
        table = to_table(fit.transfer)
        keys = {"gain": "gain", "lag": "lag_s", "dead_time": "dead_s"}
        table |= {f"{keys[key]}_ci95": list(one.ci95) for key, one in mine.items() if key in keys}
        written[name] = table
        said.append(f"{name} = {fit.transfer}")
        said += leftovers(fit, name, fit.transfer.output_unit)
        warned += warnings_of(fit, name)
        if any(trial.averaged > 1 for trial in fit.trials):
            said.append(
                f"{name}: the output was averaged over the gait cycle, and so was the fitted answer: gain, lag and "
                "dead time are the plant's, without the average"
            )
    count = sum(len(fit.trials) for fit in fits.values())
    title = f"{method} fitted to {signals.name}"
    return TransferSummary(
        method,
        method,
        FittedData(signals.name, signals.kind, count, signals.left_out),
        {key: one for mine in estimates.values() for key, one in mine.items()},
        rmse={name: fit.rmse for name, fit in fits.items()},
        rmse_units={name: fit.transfer.output_unit for name, fit in fits.items()},
        tables=(
            *(_roots(name, fit) for name, fit in fits.items() if not fit.transfer.is_first_order),
            *tables,
        ),
        findings=tuple(said),
        warnings=tuple(warned),
        details={"transfer": written},
        files={f"{method}.toml": responses_toml(written, f"labrun fit: {title}")},
        picture=lambda: draw_responses(fits, title),
        transfers={name: fit.transfer for name, fit in fits.items()},
        resampled={name: fit.resampled() for name, fit in fits.items()},
        estimates=estimates,
    )


def _estimates(fit: TransferFit) -> dict[str, Estimate]:
    unit = fit.transfer.gain_unit
    found = {"gain": fit.estimate(lambda one: one.gain, unit)}
    if fit.transfer.is_first_order:
        found["lag"] = fit.estimate(lambda one: one.lag_s, "s")
    else:
        for power in range(1, fit.shape.zeros + 1):
            found[f"b{power}"] = fit.estimate(_above(power), f"{unit} {_seconds(power)}")
        for power in range(1, fit.shape.poles + 1):
            found[f"a{power}"] = fit.estimate(_below(power), _seconds(power))
    if fit.shape.dead_time:
        found["dead_time"] = fit.estimate(lambda one: one.dead_s, "s")
    return found


def _above(power: int) -> Callable[[Transfer], float]:
    return lambda one: one.numerator[-1 - power] if len(one.numerator) > power else 0.0


def _below(power: int) -> Callable[[Transfer], float]:
    return lambda one: one.denominator[-1 - power]


def _seconds(power: int) -> str:
    return "s" if power == 1 else f"s^{power}"


def _roots(name: str, fit: TransferFit) -> TextTable:
    rows = []
    for kind, roots in (("pole", fit.transfer.poles), ("zero", fit.transfer.zeros)):
        for root in roots:
            if root.imag < 0:
                continue
            size = abs(root)
            rows.append(
                (
                    kind,
                    f"{root.real:.4g}" + (f" ± {root.imag:.4g}j" if root.imag else ""),
                    f"{size / (2 * np.pi):.4g}",
                    f"{-root.real / size:.3g}" if size else "",
                )
            )
    return TextTable(f"{name}: poles and zeros", ("", "rad/s", "Hz", "damping ratio"), tuple(rows))
