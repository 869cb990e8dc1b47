"""Benches that swing freely, and two joints in a chain."""

from collections.abc import Mapping, Sequence

import numpy as np

from ..plant import (
    DRIVEN,
    JOINT,
    READ,
    FloatArray,
    Parameter,
    Plant,
    Programme,
    Signal,
    Site,
    damping_of,
    four_digits,
    near,
    only_if,
)
from .programmes import driven, releases, time_base


class FreeDecay(Plant):
    """A hinge let go: a pendulum, or a fin on its spring."""

    def __init__(self, rng: np.random.Generator) -> None:
        self.pendulum = rng.random() < 0.5
        inertia, natural_hz = near(rng, 3e-3, 2.0), rng.uniform(0.8, 2.2)
        total = four_digits(inertia * (2 * np.pi * natural_hz) ** 2)
        damping = four_digits(rng.uniform(0.01, 0.05) * np.sqrt(total * inertia))
        damped = rng.random() < 0.8
        start: float | str = str(rng.choice(["release_rad", "first", "free"]))
        restoring = "gravity_torque" if self.pendulum else "stiffness"
        law = "gravity_torque*sin(angle)" if self.pendulum else "stiffness*angle"
        effects = [*JOINT, *only_if(not damped, "viscous-damping")]
        if self.pendulum:
            effects += ["constant-force", "load-dependent-friction"]
        else:
            # let go from where nobody knows, a spring with another rest is a sensor with another zero
            effects += ["backlash", *only_if(start == "release_rad", "rest-offset")]
        super().__init__(
            name="free-swing" if self.pendulum else "fin-decay",
            states=("angle", "rate"),
            outputs=(Signal("angle", "rad", equation="angle"),),
            parameters=(
                Parameter("inertia", inertia, 0.0, "kg m^2"),
                Parameter(
                    restoring,
                    total,
                    "free" if rng.random() < 0.6 else 0.03,
                    "N m" if self.pendulum else "N m/rad",
                ),
                *only_if(damped, Parameter("damping", damping, "free", "N m s/rad")),
            ),
            equations={
                "angle": "rate",
                "rate": f"(force.hinge - {law}{' - damping*rate' if damped else ''}) / inertia",
            },
            sites=(
                Site(
                    "hinge",
                    "joint",
                    "angle",
                    "rate",
                    "" if self.pendulum else "stiffness",
                    "gravity_torque*cos(angle)" if self.pendulum else "",
                    effects=tuple(effects),
                ),
            ),
            initial={"angle": start, "rate": 0.0 if start == "release_rad" or rng.random() < 0.5 else "free"},
            output_effects={"angle": ("saturation", "drift")},
        )

    def start(self, conditions: Sequence[Mapping[str, float | str]]) -> FloatArray:
        start = np.zeros((2, len(conditions)))
        start[0] = [one["release_rad"] for one in conditions]
        return start

    def programme(self, rng: np.random.Generator, trials: int) -> Programme:
        return releases(rng, trials, time_base(rng), 10.0, 80.0 if self.pendulum else 45.0)


class Chain(Plant):
    """Two joints coupled by a spring, each with its own motor; the outer one feels gravity."""

    def __init__(self, rng: np.random.Generator) -> None:
        inner, outer = near(rng, 4e-3, 1.5), near(rng, 1.5e-3, 1.5)
        self.natural_hz = rng.uniform(0.9, 1.8)
        k1 = four_digits(inner * (2 * np.pi * self.natural_hz) ** 2)
        k2 = four_digits(outer * (2 * np.pi * self.natural_hz * 1.3) ** 2)
        shaft = rng.random() < 0.6
        known = rng.random() < 0.5
        tolerance = 0.0 if known else 0.04
        common = (*JOINT, *only_if(known, "added-inertia"))
        super().__init__(
            name="two-joint-chain",
            states=("angle_1", "rate_1", "angle_2", "rate_2"),
            inputs=(Signal("torque_1", "N m"), Signal("torque_2", "N m")),
            outputs=(
                Signal("angle_1", "rad", equation="angle_1"),
                Signal("angle_2", "rad", equation="angle_2"),
                *only_if(shaft, Signal("shaft_torque", "N m", equation="coupling*(angle_2 - angle_1)")),
            ),
            parameters=(
                Parameter("inertia_1", inner, tolerance, "kg m^2"),
                Parameter("inertia_2", outer, tolerance, "kg m^2"),
                Parameter("stiffness_1", k1, "free", "N m/rad"),
                Parameter("stiffness_2", k2, 0.05, "N m/rad"),
                Parameter("coupling", four_digits(k2 * rng.uniform(0.5, 1.2)), 0.05, "N m/rad"),
                damping_of(rng, "damping_1", (0.1, 0.3), k1 * inner),
                damping_of(rng, "damping_2", (0.1, 0.3), k2 * outer),
                Parameter("gravity_2", four_digits(k2 * rng.uniform(0.3, 0.7)), 0.03, "N m"),
            ),
            equations={
                "angle_1": "rate_1",
                "rate_1": "(torque_1 + force.shoulder - stiffness_1*angle_1 - damping_1*rate_1"
                " + coupling*(angle_2 - angle_1)) / inertia_1",
                "angle_2": "rate_2",
                "rate_2": "(torque_2 + force.elbow - stiffness_2*angle_2 - damping_2*rate_2"
                " - coupling*(angle_2 - angle_1) - gravity_2*sin(angle_2)) / inertia_2",
            },
            sites=(
                Site("shoulder", "joint", "angle_1", "rate_1", "stiffness_1", effects=(*common, "backlash")),
                Site(
                    "elbow",
                    "joint",
                    "angle_2",
                    "rate_2",
                    load="gravity_2*cos(angle_2)",
                    effects=(*common, "load-dependent-friction", "constant-force"),
                ),
            ),
            initial={"angle_1": 0.0, "rate_1": 0.0, "angle_2": 0.0, "rate_2": 0.0},
            input_effects={"torque_1": DRIVEN, "torque_2": (*DRIVEN, "bias")},
            output_effects={
                "angle_1": (*READ, "bias", "gain-error", "cross-talk"),
                "angle_2": (*READ, "bias", "gain-error", "cross-talk"),
            },
        )
        self.peak = [0.3 * k1, 0.3 * k2]

    def programme(self, rng: np.random.Generator, trials: int) -> Programme:
        return driven(rng, trials, time_base(rng), self.peak, self.natural_hz)
