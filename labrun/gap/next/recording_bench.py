"""What could be recorded next where only recordings are known: other courses of the inputs, other conditions."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from labrun.arrays import FloatArray
from labrun.experiment import condition_key, condition_text
from labrun.fit import Dataset, FitTrial
from labrun.gap.next.trials import PlannedTrial, by_hand, evenly, require_free, write_plan
from labrun.models import Model
from labrun.store import saving

_FACTORS = (0.25, 0.5, -1.0)
"""Factors on recorded inputs."""
_GENTLER = (0.5, 0.25)
"""Factors on the inputs at a condition nobody has tried."""
_WARPS = (0.5, 2.0, 4.0)
"""How much faster; slower ones take longer and are cut at the recorded length."""
_CYCLES = (2.0, 5.0, 10.0, 20.0, 40.0, 80.0, 160.0)
"""Cycles of a sine in a trial."""
_FEWEST_SAMPLES = 8.0
"""Of one cycle: faster sines are not sampled well enough to be believed."""
_SHAPES = (1.0, 0.3)
"""Amplitudes of a sine, in units of half the range of an input."""
_BASES = 3
"""Recorded trials that planned ones start from."""


@dataclass(frozen=True)
class RecordingBench:
    """Recorded trials as examples of what the rig can do.

    `dataset` holds one trial for each unit of the data: planned trials refer to units by their number.

    Its limits are not known. What is planned stays within the range that every input was recorded in, and lasts no
    longer than the recorded trials.
    """

    dataset: Dataset
    model: Model
    repeats: int

    def pool(self) -> list[PlannedTrial]:
        """Return recorded inputs scaled and sped up, sines, steps and sweeps of the same range, other conditions."""
        bases = self._bases()
        trials: list[PlannedTrial] = []
        for basis in bases:
            trials += self._other_conditions(basis)
            if self.model.inputs:
                trials += self._changed(basis)
        if self.model.inputs:
            trials += self._made(bases[0])
        return trials

    @property
    def set_by_hand(self) -> tuple[str, ...]:
        """Numbers of the condition that the model uses."""
        trials = self.dataset.trials
        return tuple(
            name
            for name in self.model.conditions
            if all(isinstance(trial.condition.get(name), float | int) for trial in trials)
        )

    def _bases(self) -> list[int]:
        """Return the first trials of a few conditions, one number each."""
        firsts: dict[object, int] = {}
        for index, trial in enumerate(self.dataset.trials):
            firsts.setdefault(condition_key(trial.condition), index)
        return evenly(list(firsts.values()), _BASES)

    def _other_conditions(self, index: int) -> list[PlannedTrial]:
        trial = self.dataset.trials[index]
        conditions = []
        for name in self.set_by_hand:
            values = [float(t.condition[name]) for t in self.dataset.trials]
            for value in by_hand(name, values):
                condition = {**trial.condition, name: value}
                label = f"{condition_text({name: value})}, else as recorded at {trial.label}"
                conditions.append(self._trial(label, condition, trial, trial.inputs, (index, 1.0)))
                for factor in _GENTLER if self.model.inputs else ():
                    gentle = {**condition, "input": f"times {factor:g}"}
                    conditions.append(
                        self._trial(
                            f"{label}, inputs times {factor:g}",
                            gentle,
                            trial,
                            factor * trial.inputs,
                            (index, factor),
                        )
                    )
        return conditions

    def _changed(self, index: int) -> list[PlannedTrial]:
        trial = self.dataset.trials[index]
        trials = []
        for factor in _FACTORS:
            label = f"inputs of {trial.label} times {factor:g}"
            condition = {**trial.condition, "input": f"{trial.label} times {factor:g}"}
            trials.append(self._trial(label, condition, trial, factor * trial.inputs, (index, factor)))
        for warp in _WARPS:
            label = f"inputs of {trial.label}, {warp:g} times as fast"
            condition = {**trial.condition, "input": f"{trial.label} {warp:g} times as fast"}
            began = trial.time_s - trial.time_s[0]
            faster = np.column_stack(
                [
                    np.interp((began * warp) % max(began[-1], 1e-12), began, column)
                    for column in trial.inputs.T
                ]
            )
            trials.append(self._trial(label, condition, trial, faster, (index, 1.0)))
        return trials

    def _made(self, index: int) -> list[PlannedTrial]:
        """Return sines, steps and sweeps of every input that moved, the others at their middle."""
        trial = self.dataset.trials[index]
        time_s = trial.time_s - trial.time_s[0]
        length = float(time_s[-1])
        fastest = 1.0 / (_FEWEST_SAMPLES * float(np.median(np.diff(time_s))))
        trials = []
        for column, signal in enumerate(self.model.inputs):
            values = np.concatenate([each.inputs[:, column] for each in self.dataset.trials])
            middle, half = 0.5 * (values.max() + values.min()), 0.5 * float(np.ptp(values))
            if half == 0.0:
                continue
            shapes: list[tuple[str, FloatArray]] = []
            for share in _SHAPES:
                size = share * half
                for cycles in _CYCLES:
                    frequency = cycles / length
                    if frequency <= fastest:
                        course = middle + size * np.sin(2 * np.pi * frequency * time_s)
                        shapes.append((f"sine of {size:.3g} at {frequency:.3g} Hz", course))
                top = min(_CYCLES[-1] / length, fastest)
                bottom = _CYCLES[0] / length
                rate = np.log(top / bottom) / length
                phase = 2 * np.pi * bottom * (np.exp(rate * time_s) - 1.0) / rate
                shapes.append(
                    (f"sweep of {size:.3g} from {bottom:.3g} to {top:.3g} Hz", middle + size * np.sin(phase))
                )
                # it begins at rest: what an input was before a trial is not known to any effect
                square = middle + size * np.sign(np.sin(4 * np.pi * time_s / length + 1e-9)) * (
                    time_s > length / 16
                )
                shapes.append((f"steps of {size:.3g} every {length / 4:.3g} s", square))
            for label, course in shapes:
                inputs = np.tile(np.median(trial.inputs, axis=0), (len(time_s), 1))
                inputs[:, column] = course
                condition = {**trial.condition, "input": f"{label} at {signal.name}"}
                trials.append(self._trial(f"{signal.name}: {label}", condition, trial, inputs, (index, 0.0)))
        return trials

    def _trial(
        self,
        label: str,
        condition: dict[str, float | str],
        like: FitTrial,
        inputs: FloatArray,
        begins: tuple[int, float],
    ) -> PlannedTrial:
        time_s = like.time_s - like.time_s[0]
        cost_s = self.repeats * float(time_s[-1])
        return PlannedTrial(label, condition, time_s, np.ascontiguousarray(inputs), max(cost_s, 1e-3), begins)

    def write(
        self, path: Path, name: str, dataset: Dataset, trials: Sequence[PlannedTrial], remarks: Sequence[str]
    ) -> None:
        """Write a recording whose outputs are still to be measured: its toml, and every trial's inputs as CSV."""
        channels: dict[str, Any] = {}
        for signal in dataset.inputs:
            channels[signal.name] = {"kind": "input", "unit": signal.unit, "between": signal.between}
        for signal in dataset.outputs:
            channels[signal.name] = {"kind": "output", "unit": signal.unit}
        files = [
            (f"trial-{number}-{repeat}.csv", trial, repeat)
            for number, trial in enumerate(trials, start=1)
            for repeat in range(1, self.repeats + 1)
        ]
        entries = [
            {"file": file, "condition": dict(trial.condition), "repeat": repeat}
            for file, trial, repeat in files
        ]
        columns = ", ".join(signal.name for signal in dataset.outputs)
        message = f"Each CSV file holds time and inputs of one trial; what was measured goes beside them as {columns}."
        write_plan(path, [*remarks, message], {"experiment": name, "channels": channels, "trials": entries})
        header = ",".join(["time_s", *(signal.name for signal in dataset.inputs)])
        for file, trial, _ in files:
            require_free(path.parent / file)
            table = np.column_stack([trial.time_s, trial.inputs])
            with saving(file, path.absolute().parent):
                np.savetxt(path.parent / file, table, delimiter=",", header=header, comments="", fmt="%.9g")
