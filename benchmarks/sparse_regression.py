"""Diagnose a recording by sparse regression: pysindy's STLSQ on the acceleration that the model misses.

    pip install pysindy
    labrun gap check --cases 20 --seed 7 --tool "python benchmarks/sparse_regression.py"

States are read from the outputs, rates by smoothed finite differences (pysindy). The measured acceleration minus that
of the model's equation is regressed on terms of textbook effects. Both sides pass the same low pass, and errors of the
model's parameters are projected out of them. Sequentially thresholded least squares (Brunton, Proctor, Kutz, PNAS 113,
2016) selects the terms; its threshold is the largest whose error on withheld conditions lies within one standard error
of the best. Effects of sensors are not in the acceleration, and an added inertia is a multiple of it: neither is found.
"""

import json
import sys
import tomllib
import warnings
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.signal import butter, sosfiltfilt

from labrun.fit import load_dataset
from labrun.models import load_model

warnings.simplefilter("ignore")
import pysindy  # noqa: E402

THRESHOLDS = np.geomspace(0.02, 2.0, 15)
"""In units of the root mean square of the missing acceleration, for columns of root mean square 1."""
EDGE = 8
"""Samples at both ends of a trial where derivatives are poor."""
CUT, EVERY = 0.1, 5
"""Low pass of both sides of the regression, as a share of half the sampling rate; one sample of so many is kept."""
ERRORS = 2.0
"""A gap is reported if the terms lower the error on withheld conditions by more than so many standard errors."""
SLOW = 0.02
FUNCTIONS = {"abs": np.abs, "sin": np.sin, "cos": np.cos, "tan": np.tan, "sqrt": np.sqrt, "exp": np.exp,
             "log": np.log, "tanh": np.tanh, "sign": np.sign, "pi": np.pi}  # fmt: skip


@dataclass
class Motion:
    """One condition: values of all names in the model's equations, and the slope of every state, as measured."""

    names: dict
    slopes: dict


class Recording:
    """States, inputs and missing accelerations of every condition, averaged over its repeats."""

    def __init__(self, folder: Path) -> None:
        self.model = load_model(folder / "model.toml")
        table = tomllib.loads((folder / "model.toml").read_text())
        self.equations = {state: text.strip() for state, text in table.get("equations", {}).items()}
        self.readings = {name: output["equation"].strip() for name, output in table["outputs"].items()}
        data = load_dataset(folder, self.model)
        groups: dict[str, list] = {}
        for trial in data.trials:
            groups.setdefault(json.dumps(trial.condition, sort_keys=True), []).append(trial)
        self.parameters = {parameter.name: parameter.value for parameter in self.model.parameters}
        self.loose = [parameter.name for parameter in self.model.parameters if parameter.tolerance != 0]
        self.motions = [self._motion(group) for group in groups.values()]

    def _motion(self, group) -> Motion:
        trial, outputs = group[0], np.mean([repeat.outputs for repeat in group], axis=0)
        time_s, names = trial.time_s, dict(trial.condition)
        names |= {port.name: trial.inputs[:, column] for column, port in enumerate(self.model.inputs)}
        slopes = {}
        measured = {
            self.readings[port.name]: outputs[:, column] for column, port in enumerate(self.model.outputs)
        }
        for state in self.model.states:
            if state in measured:
                names[state] = measured[state]
                slopes[state] = _slope(measured[state], time_s)
        for state in self.model.states:  # a coordinate whose rate is a state of its own
            rate = self.equations[state]
            if rate in self.model.states:
                if state in names and rate not in names:
                    names[rate] = slopes[state]
                    slopes[rate] = _slope(slopes[state], time_s)
                elif rate in names and state not in names:
                    names[state] = np.concatenate([[0.0], np.cumsum(np.diff(time_s) * names[rate][1:])])
        unknown = [state for state in self.model.states if state not in names]
        if unknown:
            raise SystemExit(f"no output measures {', '.join(unknown)}")
        names["time_slope"] = {port.name: np.gradient(names[port.name], time_s) for port in self.model.inputs}
        return Motion(names, slopes)

    def acceleration(self, state: str, motion: Motion, **changed) -> np.ndarray:
        """Return what the model's equation gives at the measured motion; `changed` replaces parameters or inputs."""
        forces = {f"force_at_{site.name}": 0.0 for site in self.model.sites}
        names = FUNCTIONS | self.parameters | motion.names | forces | changed
        text = self.equations[state].replace("^", "**").replace("force.", "force_at_")
        length = len(next(iter(motion.slopes.values())))
        return np.broadcast_to(np.asarray(eval(text, {"__builtins__": {}}, names), float), length)[EDGE:-EDGE]


def terms(recording: Recording, state: str, motion: Motion) -> dict[tuple[str, str], np.ndarray]:
    """Return the acceleration that size 1 of every effect causes, by effect and site."""
    still = recording.acceleration(state, motion)
    listed: dict[tuple[str, str], np.ndarray] = {}
    for site in recording.model.sites:
        push = recording.acceleration(state, motion, **{f"force_at_{site.name}": 1.0}) - still
        if not np.any(push) or site.rate not in motion.names or site.coordinate not in motion.names:
            continue
        rate, name = motion.names[site.rate][EDGE:-EDGE], motion.names[site.coordinate][EDGE:-EDGE]
        dry = -np.tanh(rate / (SLOW * np.abs(rate).max() + 1e-12))
        if site.kind == "body":
            forces = {"drag-error": -np.abs(rate) * rate}
        else:
            forces = {
                "coulomb-friction": dry,
                "viscous-damping": -rate,
                "quadratic-drag": -np.abs(rate) * rate,
                "cubic-stiffness": -(name**3),
                "asymmetric-stiffness": -np.maximum(name, 0.0),
                "constant-force": np.ones_like(rate),
            }
            if site.load:
                names = FUNCTIONS | recording.parameters | motion.names
                load = eval(site.load.replace("^", "**"), {"__builtins__": {}}, names)
                forces["load-dependent-friction"] = (
                    dry * np.abs(np.broadcast_to(load, len(rate) + 2 * EDGE))[EDGE:-EDGE]
                )
        listed |= {(effect, site.name): push * force for effect, force in forces.items()}
    for port in recording.model.inputs:
        value = motion.names[port.name]
        push = recording.acceleration(state, motion, **{port.name: value + 1.0}) - still
        if np.any(push):
            small = np.clip(value, -0.1 * np.abs(value).max(), 0.1 * np.abs(value).max())
            large = np.sign(value) * np.maximum(np.abs(value) - 0.8 * np.abs(value).max(), 0.0)
            signals = {
                "gain-error": value,
                "bias": np.ones_like(value),
                "delay": -motion.names["time_slope"][port.name],
                "dead-band": -small,
                "saturation": -large,
            }
            listed |= {(effect, port.name): push * signal[EDGE:-EDGE] for effect, signal in signals.items()}
    return listed


def nuisance(recording: Recording, state: str, motion: Motion) -> np.ndarray:
    """Return what errors of the model's parameters change, one column each."""
    columns = []
    for name in recording.loose:
        value, step = recording.parameters[name], 1e-4 * (abs(recording.parameters[name]) or 1.0)
        change = recording.acceleration(state, motion, **{name: value + step}) - recording.acceleration(
            state, motion
        )
        columns.append(change / step)
    return np.array(columns).reshape(len(columns), -1).T


def low_passed(columns: np.ndarray) -> np.ndarray:
    """Return columns after a zero-phase low pass, thinned."""
    return sosfiltfilt(butter(2, CUT, output="sos"), columns, axis=0)[EDGE:-EDGE:EVERY]


def regression(
    recording: Recording, state: str
) -> tuple[list[tuple[str, str]], list[np.ndarray], list[np.ndarray]]:
    """Return names of the terms, and by condition their columns and the missing acceleration, both without nuisance."""
    listed = [terms(recording, state, motion) for motion in recording.motions]
    names = list(listed[0])
    missing = [
        motion.slopes[state][EDGE:-EDGE] - recording.acceleration(state, motion)
        for motion in recording.motions
    ]
    parts = [low_passed(np.column_stack([columns[name] for name in names])) for columns in listed]
    columns, target = np.concatenate(parts), np.concatenate([low_passed(signal) for signal in missing])
    others = np.concatenate([low_passed(nuisance(recording, state, motion)) for motion in recording.motions])
    both = np.column_stack([columns, target])
    size = np.sqrt(np.mean(np.square(columns), axis=0)) + 1e-30
    used = np.abs(others).max(axis=0) > 0 if others.size else np.zeros(0, bool)
    if used.any():
        others = others[:, used] / np.abs(others[:, used]).max(axis=0)
        both = both - others @ np.linalg.lstsq(others, both, rcond=1e-10)[0]
    columns, target = both[:, :-1], both[:, -1]
    left = np.sqrt(np.mean(np.square(columns), axis=0))
    seen = left > 0.02 * size  # the rest is an error of a parameter by another name
    scale = np.sqrt(np.mean(np.square(target))) + 1e-30
    ends = np.cumsum([len(part) for part in parts])[:-1]
    kept = [name for name, is_seen in zip(names, seen, strict=True) if is_seen]
    return kept, np.split(columns[:, seen] / left[seen], ends), np.split(target / scale, ends)


def selected(columns: np.ndarray, target: np.ndarray, threshold: float) -> np.ndarray:
    """Return the coefficients of pysindy's sequentially thresholded least squares."""
    optimizer = pysindy.STLSQ(threshold=threshold, alpha=1e-3)
    return np.asarray(optimizer.fit(columns, target.reshape(-1, 1)).coef_).ravel()


def chosen(columns: list[np.ndarray], target: list[np.ndarray]) -> tuple[np.ndarray, float]:
    """Return the coefficients at the threshold that withheld conditions choose, and what share of error they leave."""
    errors = []
    for threshold in THRESHOLDS:
        error = []
        for withheld in range(len(target)):
            rest = [index for index in range(len(target)) if index != withheld]
            result = selected(
                np.concatenate([columns[index] for index in rest]),
                np.concatenate([target[index] for index in rest]),
                threshold,
            )
            error.append(
                np.mean(np.square(target[withheld] - columns[withheld] @ result))
                / np.mean(np.square(target[withheld]))
            )
        errors.append(error)
    means = np.mean(errors, axis=1)
    best = int(np.argmin(means))
    limit = means[best] + np.std(errors[best], ddof=1) / np.sqrt(len(target))
    position = max(index for index, mean in enumerate(means) if mean <= limit)
    gain = 1.0 - np.array(errors[position])
    if gain.mean() <= ERRORS * gain.std(ddof=1) / np.sqrt(len(gain)):
        return np.zeros(columns[0].shape[1]), 1.0
    return selected(np.concatenate(columns), np.concatenate(target), THRESHOLDS[position]), float(
        means[position]
    )


def diagnosed(folder: Path) -> dict:
    """Return the answer: gap, causes, rest."""
    recording = Recording(folder)
    if not recording.model.states:
        raise SystemExit("the model has no states: there is no acceleration")
    causes, rests = [], []
    for state in recording.model.states:
        if state not in recording.motions[0].slopes or recording.equations[state] in recording.model.states:
            continue
        names, columns, target = regression(recording, state)
        if not names:
            continue
        result, rest = chosen(columns, target)
        if not result.any():
            continue
        rests.append(min(rest, 1.0))
        shares = np.square(result) / max(np.square(result).sum(), 1e-30) * (1.0 - rest)
        causes += [
            {"effect": name[0], "site": name[1], "closes": float(share)}
            for name, share in zip(names, shares, strict=True)
            if share > 0.0
        ]
    causes.sort(key=lambda cause: -cause["closes"])
    return {"gap": bool(causes), "causes": causes, "rest": float(np.mean(rests)) if rests else None}


def _slope(signal: np.ndarray, time_s: np.ndarray) -> np.ndarray:
    return np.asarray(pysindy.SmoothedFiniteDifference()._differentiate(signal[:, None], time_s))[:, 0]


if __name__ == "__main__":
    print(json.dumps(diagnosed(Path(sys.argv[1]))))
