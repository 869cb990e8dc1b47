"""Diagnose a recording the textbook way: least squares with every single effect, the one of least BIC is the cause.

    labrun gap check --cases 20 --seed 7 --tool "python benchmarks/least_squares_bic.py"

The model is recalibrated by Gauss-Newton (parameters held by their tolerances, free initial states), then once more
with each effect of a short list added at each site, input and output. The Bayesian information criterion of white
residuals (Schwarz, Annals of Statistics 6, 1978) picks one of them or none. labrun reads the recording and simulates
the model; effects, fits and choice are all here.
"""

import json
import sys
import tomllib
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import tomli_w
from scipy.signal import lfilter

from labrun.fit import load_dataset
from labrun.models import parse_model, prepare, simulate

SUBSTEPS = 2
ITERATIONS = 5
LITTLE = 1e-3
"""A fit ends where a step lowers the squared error by less than this share."""
SHAPED = ("delay", "lag", "dead-band", "saturation")
"""Effects whose outputs have no slope, or a poor one, over a size of zero: their fits start elsewhere, twice."""
RIVAL = 10.0
"""A difference in BIC that counts as very strong evidence (Kass and Raftery, JASA 90, 1995)."""
FREE = 0.2
"""Scale of a parameter whose tolerance is "free", as a share of its value; it is not held by it."""
SLOW = 0.02
"""Dry friction is rounded below this share of the greatest speed."""

# The force of size 1 at a site, the size's name in the answer, and whether it may be negative.
DRY = "-tanh(({rate})/{slow})"
JOINT = {
    "coulomb-friction": (DRY, "torque", False),
    "load-dependent-friction": (DRY + "*abs({load})", "coefficient", False),
    "viscous-damping": ("-({rate})", "coefficient", True),
    "quadratic-drag": ("-abs({rate})*({rate})", "coefficient", False),
    "cubic-stiffness": ("-({coordinate})^3", "coefficient", True),
    "asymmetric-stiffness": ("-0.5*(({coordinate}) + abs({coordinate}))", "excess", True),
    "constant-force": ("1.0", "force", True),
}
BODY = {
    "drag-error": ("-abs({rate})*({rate})", "coefficient", True),
    "added-mass": ("", "", True),
}
INERTIA = ("added-inertia", "added-mass")
"""These scale the acceleration instead of adding a force."""


# The size's name in the answer and whether it may be negative, of effects of an input and of an output.
INPUT = {
    "delay": ("delay", False),
    "lag": ("time_constant", False),
    "gain-error": ("error", True),
    "bias": ("offset", True),
    "dead-band": ("half_width", False),
    "saturation": ("", False),
}
OUTPUT = {
    **{name: INPUT[name] for name in ("delay", "lag", "gain-error", "bias")},
    "drift": ("slope", True),
    "cross-talk": ("share", True),
}


def changed_signal(
    effect: str, size: float, time_s: np.ndarray, signal: np.ndarray, others: np.ndarray
) -> np.ndarray:
    """Return a signal (n,) with an effect of some size; `others` (n, k) are the signals beside it."""
    peak = np.abs(signal).max()
    level = peak * (1.0 - size)
    share = 1.0 - np.exp(-np.median(np.diff(time_s)) / max(size, 1e-6))
    changes = {
        "delay": lambda: np.interp(time_s - size, time_s, signal),
        "lag": lambda: lfilter([share], [1.0, share - 1.0], signal - signal[0]) + signal[0],
        "gain-error": lambda: (1.0 + size) * signal,
        "bias": lambda: signal + size,
        "dead-band": lambda: np.sign(signal) * np.maximum(np.abs(signal) - size, 0.0),
        "saturation": lambda: np.clip(
            signal, -level, level
        ),  # its size is the share of the peak that is cut off
        "drift": lambda: signal + size * (time_s - time_s[0]),
        "cross-talk": lambda: signal + size * others.sum(axis=1),
    }
    return changes[effect]()


@dataclass(frozen=True)
class Candidate:
    """An effect at a site or of a signal, a released parameter, or nothing."""

    effect: str = ""
    site: str = ""
    size_name: str = ""
    signed: bool = True
    of_signal: bool = False
    parameter: str = ""


@dataclass
class Fit:
    """Where a fit ended: x in units of the scales, the size of the effect, residuals in units of sigma, and its BIC."""

    candidate: Candidate
    x: np.ndarray
    size: float
    residuals: np.ndarray
    bic: float = np.inf


class Recording:
    """A recording, averaged over repeats, and its model with a term for every force of the list, all of size zero."""

    def __init__(self, folder: Path) -> None:
        text = (folder / "model.toml").read_text()
        plain = parse_model(text, folder.name)
        data = load_dataset(folder, plain)
        groups = {}
        for trial in data.trials:
            groups.setdefault(json.dumps(trial.condition, sort_keys=True), []).append(trial)
        self.trials = [
            replace(group[0], outputs=np.mean([trial.outputs for trial in group], 0))
            for group in groups.values()
        ]
        self.repeats = min(map(len, groups.values()))
        spread = [
            np.var([trial.outputs for trial in group], axis=0, ddof=1) / len(group)
            for group in groups.values()
            if len(group) > 1
        ]
        self.noise = np.sqrt(np.mean(np.concatenate(spread), axis=0)) if self.repeats > 1 else None
        self.sigma = np.std(np.concatenate([trial.outputs for trial in self.trials]), axis=0) + 1e-12
        loose = [parameter for parameter in plain.parameters if parameter.tolerance != 0]
        self.names = [parameter.name for parameter in loose]
        self.stated = np.array([parameter.value for parameter in loose])
        self.is_held = np.array([parameter.tolerance != "free" for parameter in loose])
        self.scales = np.array(
            [
                max(abs(parameter.value), 1e-9)
                * (FREE if parameter.tolerance == "free" else parameter.tolerance)
                for parameter in loose
            ]
        )
        self.free = [state for state in plain.states if plain.initial.get(state, "free") == "free"]
        self.inputs = [port.name for port in plain.inputs]
        self.outputs = [port.name for port in plain.outputs]
        self.drives = [prepare(plain, trial.time_s, trial.inputs, SUBSTEPS) for trial in self.trials]
        self.model = plain
        self.model, self.candidates = self._with_forces(text, plain)

    def _with_forces(self, text: str, plain):
        """Return the model with a parameter of value 0 for every effect at a site, and the list of all candidates."""
        table = tomllib.loads(text)
        peak = self._greatest_rates(plain)
        listed = [
            Candidate(parameter=name) for name, held in zip(self.names, self.is_held, strict=True) if held
        ]
        for site in plain.sites:
            effects = BODY if site.kind == "body" else {**JOINT, "added-inertia": ("", "", True)}
            terms = ""
            for effect, (formula, size_name, signed) in effects.items():
                words = {"rate": site.rate, "coordinate": site.coordinate, "load": site.load}
                if any("{" + word + "}" in formula and not value for word, value in words.items()):
                    continue
                name = _name(effect, site.name)
                if effect in INERTIA:
                    if site.rate not in plain.states:
                        continue
                    equation = table["equations"][site.rate]
                    table["equations"][site.rate] = f"({equation}) / (1 + {name})"
                else:
                    terms += f" + {name}*({formula.format(**words, slow=SLOW * peak.get(site.rate, 1.0))})"
                table["parameters"][name] = {"value": 0.0, "tolerance": "free", "unit": "1"}
                listed.append(Candidate(effect, site.name, size_name, signed))
            force = f"force.{site.name}"
            for equations in (table.get("equations", {}), table["outputs"]):
                for key, value in equations.items():
                    if isinstance(value, str):
                        equations[key] = value.replace(force, f"({force}{terms})")
                    else:
                        value["equation"] = value["equation"].replace(force, f"({force}{terms})")
        for names, effects in ((self.inputs, INPUT), (self.outputs, OUTPUT)):
            for name in names:
                listed += [
                    Candidate(effect, name, size_name, signed, of_signal=True)
                    for effect, (size_name, signed) in effects.items()
                    if effect != "cross-talk" or len(names) > 1
                ]
        return parse_model(tomli_w.dumps(table), plain.name), listed

    def _greatest_rates(self, plain) -> dict[str, float]:
        """Return the greatest absolute value of every state and input."""
        x = np.zeros(len(self.names) + len(self.free) * len(self.trials))
        runs = [self._run(trial, index, x, Candidate(), 0.0) for index, trial in enumerate(self.trials)]
        states = np.concatenate([run.states for run in runs])
        inputs = np.concatenate([trial.inputs for trial in self.trials])
        columns = dict(zip(plain.states, states.T, strict=True)) | dict(
            zip(self.inputs, inputs.T, strict=True)
        )
        return {name: float(np.nanmax(np.abs(column))) or 1.0 for name, column in columns.items()}

    def _run(self, trial, index: int, x: np.ndarray, candidate: Candidate, size: float):
        """Simulate one condition with parameters and initial states x, and with a candidate at some size."""
        count = len(self.names)
        values = dict(zip(self.names, self.stated + x[:count] * self.scales, strict=True))
        if candidate.effect and not candidate.of_signal:
            values[_name(candidate.effect, candidate.site)] = size
        inputs = self._changed(trial.inputs, self.inputs, candidate, size, trial.time_s)
        first = dict(zip(self.outputs, trial.outputs[:3].mean(axis=0), strict=True)) | self.model.told_first(
            trial.inputs[0]
        )
        start = self.model.initial_state(trial.condition, first=first)
        for position, state in enumerate(self.free):
            shift = x[count + index * len(self.free) + position]
            start[self.model.states.index(state)] += 0.1 * self.sigma[0] * shift
        return simulate(
            self.model,
            trial.time_s,
            self.drives[index] if inputs is trial.inputs else inputs,
            parameters=values,
            condition=trial.condition,
            initial_state=start,
            substeps=SUBSTEPS,
        )

    def _changed(self, signals, names, candidate: Candidate, size: float, time_s) -> np.ndarray:
        if not candidate.of_signal or candidate.site not in names:
            return signals
        column, changed = names.index(candidate.site), signals.copy()
        others = np.delete(signals, column, axis=1)
        changed[:, column] = changed_signal(candidate.effect, size, time_s, signals[:, column], others)
        return changed

    def residuals_of(self, index: int, x: np.ndarray, candidate: Candidate, size: float) -> np.ndarray:
        """Return measured minus simulated outputs of one condition, in units of sigma, flat."""
        trial = self.trials[index]
        run = self._run(trial, index, x, candidate, size)
        outputs = self._changed(run.outputs, self.outputs, candidate, size, trial.time_s)
        return np.nan_to_num((trial.outputs - outputs) / self.sigma, nan=1e3, posinf=1e3, neginf=-1e3).ravel()

    def residuals(self, x: np.ndarray, candidate: Candidate, size: float) -> np.ndarray:
        """Return the residuals of all conditions, and behind them what parameters deviate, in tolerances."""
        parts = [self.residuals_of(index, x, candidate, size) for index in range(len(self.trials))]
        prior = np.where(self.is_held, -x[: len(self.names)], 0.0)
        if candidate.parameter:
            prior[self.names.index(candidate.parameter)] = 0.0
        return np.concatenate([*parts, prior])

    def jacobian(self, x: np.ndarray, candidate: Candidate, size: float, step: float = 1e-3) -> np.ndarray:
        """Return d residuals / d x by forward differences; initial states of one condition touch its rows only."""
        base = self.residuals(x, candidate, size)
        columns = np.zeros((len(base), len(x)))
        for index in range(len(self.names)):
            moved = x.copy()
            moved[index] += step
            columns[:, index] = (self.residuals(moved, candidate, size) - base) / step
        for position in range(len(self.free)):
            row = 0
            for index, trial in enumerate(self.trials):
                rows = slice(row, row := row + trial.outputs.size)
                column = len(self.names) + index * len(self.free) + position
                moved = x.copy()
                moved[column] += step
                columns[rows, column] = (self.residuals_of(index, moved, candidate, size) - base[rows]) / step
        return columns


def recalibrated(recording: Recording) -> Fit:
    """Fit the model alone: Gauss-Newton with step halving."""
    x, none = np.zeros(len(recording.names) + len(recording.free) * len(recording.trials)), Candidate()
    residuals = recording.residuals(x, none, 0.0)
    for _ in range(2 * ITERATIONS):
        step = np.linalg.lstsq(recording.jacobian(x, none, 0.0), -residuals, rcond=1e-8)[0]
        for share in (1.0, 0.5, 0.1):
            tried = recording.residuals(x + share * step, none, 0.0)
            if tried @ tried < residuals @ residuals:
                break
        else:
            break
        gain = 1.0 - (tried @ tried) / (residuals @ residuals)
        x, residuals = x + share * step, tried
        if gain < LITTLE:
            break
    return Fit(none, x, 0.0, residuals)


def fitted(recording: Recording, plain: Fit, slopes: np.ndarray, candidate: Candidate) -> Fit:
    """Fit the model with one effect from several sizes; slopes over the parameters stay those of the model alone."""
    if candidate.parameter:
        slopes = slopes.copy()
        slopes[len(slopes) - len(recording.names) + recording.names.index(candidate.parameter)] = 0.0
        return _descended(recording, candidate, plain.x, 0.0, 0.0, slopes)
    scale = _natural_size(recording, plain, candidate)
    starts = (0.3, 1.0) if candidate.effect in SHAPED else (0.0,)
    if not scale > 0:
        return replace(plain, candidate=candidate)
    fits = [_descended(recording, candidate, plain.x, start * scale, scale, slopes) for start in starts]
    return min(fits, key=lambda fit: fit.residuals @ fit.residuals)


def _descended(recording, candidate, x, size, scale, slopes) -> Fit:
    """Fit by Gauss-Newton steps, halved where they do not help; `scale` 0 leaves the size alone."""
    residuals = recording.residuals(x, candidate, size)
    for _ in range(ITERATIONS):
        columns = slopes
        if scale > 0:
            nudged = recording.residuals(x, candidate, size + 1e-2 * scale)
            columns = np.column_stack([slopes, (nudged - residuals) / 1e-2])
        step = np.linalg.lstsq(columns, -residuals, rcond=1e-8)[0]
        for share in (1.0, 0.4, 0.1):
            new_size = size + share * scale * step[-1] if scale > 0 else 0.0
            new_size = new_size if candidate.signed else max(new_size, 0.0)
            new_x = x + share * step[: len(x)]
            tried = recording.residuals(new_x, candidate, new_size)
            if tried @ tried < residuals @ residuals:
                break
        else:
            break
        gain = 1.0 - (tried @ tried) / (residuals @ residuals)
        x, size, residuals = new_x, new_size, tried
        if gain < LITTLE:
            break
    return Fit(candidate, x, float(size), residuals)


def _natural_size(recording: Recording, plain: Fit, candidate: Candidate) -> float:
    """Return the size at which an effect changes the outputs by as much as the model alone leaves, about."""
    size, target = 1e-3, np.sqrt(np.mean(np.square(plain.residuals)))
    for _ in range(3):
        change = recording.residuals(plain.x, candidate, size) - plain.residuals
        seen = np.sqrt(np.mean(np.square(change)))
        if not seen > 0:
            return 0.0
        size *= float(np.clip(target / seen, 1e-3, 1e3))
    return size


def scored(recording: Recording, fit: Fit, parameters: int) -> Fit:
    """Return a fit with its BIC: white residuals, a variance of its own for every output."""
    count = len(fit.residuals) - len(recording.names)
    by_output = np.mean(np.square(fit.residuals[:count].reshape(-1, len(recording.outputs))), axis=0)
    prior = np.sum(np.square(fit.residuals[count:]))
    rows = count / len(recording.outputs)
    return replace(fit, bic=float(rows * np.log(by_output).sum() + prior + parameters * np.log(count)))


def excess(recording: Recording, fit: Fit) -> float:
    """Return the mean square beyond the noise that the scatter of repeats shows."""
    count = len(fit.residuals) - len(recording.names)
    floor = np.square(recording.noise / recording.sigma).mean()
    return max(float(np.mean(np.square(fit.residuals[:count])) - floor), 0.0)


def cause(recording: Recording, fit: Fit, slopes: np.ndarray) -> dict:
    """Return a cause as it is printed, its size with the 95 % interval of the linearised fit."""
    candidate = fit.candidate
    named = {"effect": candidate.parameter or candidate.effect, "site": candidate.site}
    if not candidate.size_name:
        return named
    step = max(abs(fit.size), 1e-9) * 1e-2
    column = (recording.residuals(fit.x, candidate, fit.size + step) - fit.residuals) / step
    others = np.linalg.lstsq(slopes, column, rcond=1e-8)[0]
    alone = column - slopes @ others
    half = 1.96 * np.sqrt(np.mean(np.square(fit.residuals)) / max(alone @ alone, 1e-30))
    return {
        **named,
        "size": {candidate.size_name: {"value": fit.size, "ci95": [fit.size - half, fit.size + half]}},
    }


def diagnosed(folder: Path) -> dict:
    """Return the answer: gap, causes, rest."""
    recording = Recording(folder)
    plain = recalibrated(recording)
    left = plain.residuals[: len(plain.residuals) - len(recording.names)].reshape(-1, len(recording.outputs))
    recording.sigma *= np.sqrt(np.mean(np.square(left), axis=0)) + 1e-12
    plain = recalibrated(recording)  # again, every output weighted by what the first left of it
    slopes = recording.jacobian(plain.x, Candidate(), 0.0)
    plain = scored(recording, plain, len(plain.x))
    fits = [
        scored(recording, fitted(recording, plain, slopes, candidate), len(plain.x) + 1)
        for candidate in recording.candidates
    ]
    best = min(fits, key=lambda fit: fit.bic)
    if best.bic >= plain.bic:
        return {"gap": False, "causes": []}
    rivals = [fit.candidate for fit in fits if fit is not best and fit.bic < best.bic + RIVAL]
    result = cause(recording, best, slopes)
    result["rivals"] = [{"effect": rival.parameter or rival.effect, "site": rival.site} for rival in rivals]
    if recording.noise is None or excess(recording, plain) == 0.0:
        return {"gap": True, "causes": [result]}
    rest = min(excess(recording, best) / excess(recording, plain), 1.0)
    return {"gap": True, "causes": [{**result, "closes": 1.0 - rest}], "rest": rest}


def _name(effect: str, site: str) -> str:
    return f"{effect}_at_{site}".replace("-", "_")


if __name__ == "__main__":
    print(json.dumps(diagnosed(Path(sys.argv[1]))))
