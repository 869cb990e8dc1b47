"""A bench that is known through and through: recordings of a model with a hidden cause, with noise."""

from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from labrun.effects import load_effect
from labrun.fit.dataset import FitTrial, load_dataset
from labrun.models import load_model, simulate

RATE_HZ = 60.0
REPEATS = 3


@dataclass(frozen=True)
class Bench:
    """A model file, what is hidden in the bench, and the trials that were recorded.

    Attributes
    ----------
    hidden : (effect, kind, site, values), or None
    parameters
        True values that differ from the stated ones.
    courses : (condition, function of time) per recorded condition
    """

    model: str
    hidden: tuple | None
    courses: tuple
    parameters: dict = field(default_factory=dict)
    noise: float = 0.01
    duration_s: float = 4.0

    def write(self, folder: Path) -> Path:
        """Write model and recording; return the recording."""
        folder.mkdir()
        (folder / "model.toml").write_text(self.model)
        model = load_model(folder / "model.toml")
        inputs, outputs = ([port.name for port in ports] for ports in (model.inputs, model.outputs))
        text = ""
        for kind, ports in (("input", model.inputs), ("output", model.outputs)):
            text += "".join(
                f'[channels.{port.name}]\nkind = "{kind}"\nunit = "{port.unit}"\n' for port in ports
            )
        rng = np.random.default_rng(3)
        time_s = np.arange(0.0, self.duration_s, 1 / RATE_HZ)
        for number, (condition, course) in enumerate(self.courses):
            for repeat in range(1, REPEATS + 1):
                u = course(time_s)[:, None]
                y = self.measure(model, time_s, u, condition, rng)
                name = f"{number}-{repeat}.csv"
                header = ",".join(["time_s", *inputs, *outputs])
                table = np.column_stack([time_s, u, y])
                np.savetxt(folder / name, table, delimiter=",", header=header, comments="", fmt="%.9g")
                values = ", ".join(f"{key} = {value}" for key, value in condition.items())
                text += f'[[trials]]\nfile = "{name}"\ncondition = {{ {values} }}\nrepeat = {repeat}\n'
        (folder / "recording.toml").write_text(text)
        return folder

    def measure(self, model, time_s, inputs, condition, rng):
        """Return what the bench would measure, (n, m)."""
        effects = []
        if self.hidden is not None:
            effect, kind, site, values = self.hidden
            effects = [load_effect(effect, kind).attach(site, **values)]
        result = simulate(
            model,
            time_s,
            inputs,
            condition=condition,
            effects=effects,
            parameters=self.parameters,
            substeps=16,
        )
        assert result.finite
        return result.outputs + self.noise * rng.standard_normal(result.outputs.shape)

    def carry_out(self, proposal, folder: Path):
        """Return the recorded trials and those of the proposal, measured on this bench, as one dataset."""
        model = load_model(folder / "model.toml")
        dataset = load_dataset(folder, model)
        rng = np.random.default_rng(4)
        new = []
        for trial in proposal.trials:
            for repeat in range(1, proposal.repeats + 1):
                y = self.measure(model, trial.time_s, trial.inputs, trial.condition, rng)
                new.append(FitTrial(trial.label, trial.condition, repeat, trial.time_s, trial.inputs, y))
        return replace(dataset, trials=(*dataset.trials, *new)), model


def sine(size, frequency_hz):
    """Return a course of an input."""
    return lambda time_s: size * np.sin(2 * np.pi * frequency_hz * time_s)
