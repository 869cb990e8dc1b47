"""Driven mechanisms: a hinge with a torque, an arm with a payload, a linear stage."""

import numpy as np

from ..plant import (
    DRIVEN,
    JOINT,
    READ,
    Parameter,
    Plant,
    Programme,
    Signal,
    Site,
    damping_of,
    draw_between,
    four_digits,
    near,
    only_if,
)
from .programmes import driven, time_base


class HingeDrive(Plant):
    """A pendulum on a spring hinge, driven by a torque; some with a cell that measures the hinge's reaction."""

    def __init__(self, rng: np.random.Generator) -> None:
        inertia, natural_hz = near(rng, 1.5e-3, 2.0), rng.uniform(0.8, 2.5)
        total = inertia * (2 * np.pi * natural_hz) ** 2
        sprung = rng.random() < 0.5
        cell = rng.random() < 0.6
        known = rng.random() < 0.5
        gravity = four_digits(total * rng.uniform(0.3, 0.6))
        damping = rng.random() < 0.8
        spring = four_digits(total - gravity)
        self.peak = total
        super().__init__(
            name="hinge-drive",
            states=("angle", "rate"),
            inputs=(Signal("torque", "N m", draw_between(rng)),),
            outputs=(
                Signal("angle", "rad", equation="angle"),
                *only_if(
                    cell,
                    Signal(
                        "reaction",
                        "N m",
                        equation=f"stiffness*angle{' + damping*rate' if damping else ''} - force.hinge",
                    ),
                ),
            ),
            parameters=(
                Parameter("inertia", inertia, 0.0 if known else 0.03, "kg m^2"),
                Parameter("gravity_torque", gravity, 0.03, "N m"),
                Parameter("stiffness", spring, "free", "N m/rad"),
                *only_if(damping, damping_of(rng, "damping", (0.06, 0.3), total * inertia)),
            ),
            equations={
                "angle": "rate",
                "rate": "(torque + force.hinge - stiffness*angle"
                + (" - damping*rate" if damping else "")
                + " - gravity_torque*sin(angle)) / inertia",
            },
            sites=(
                Site(
                    "hinge",
                    "joint",
                    "angle",
                    "rate",
                    "stiffness" if sprung else "",
                    "gravity_torque*cos(angle)",
                    "stiffness",
                    effects=(
                        *JOINT,
                        "load-dependent-friction",
                        *(("backlash",) if sprung else ("constant-force",)),
                        *only_if(known, "added-inertia"),
                        *only_if(not damping, "viscous-damping"),
                    ),
                ),
            ),
            initial={"angle": 0.0, "rate": 0.0},
            input_effects={
                "torque": (
                    *(DRIVEN if cell else ("saturation", "rate-limit", "dead-band")),
                    *only_if(not sprung, "bias"),
                    *only_if(known and cell, "gain-error"),
                )
            },
            output_effects={"angle": (*(READ if cell else ("drift", "saturation")), "bias")}
            | ({"reaction": (*READ, "bias", "gain-error", "cross-talk")} if cell else {}),
        )
        self.natural_hz = natural_hz

    def programme(self, rng: np.random.Generator, trials: int) -> Programme:
        return driven(rng, trials, time_base(rng), [self.peak * rng.uniform(0.15, 0.35)], self.natural_hz)


class PayloadArm(Plant):
    """An arm that lifts different payloads against gravity, held by a proportional loop on the commanded angle."""

    def __init__(self, rng: np.random.Generator) -> None:
        own, arm = near(rng, 2.5e-3, 1.5), near(rng, 0.12)
        natural_hz = rng.uniform(1.5, 3.0)
        self.natural_hz = natural_hz
        held = own + 0.1 * arm**2
        loop = four_digits(held * (2 * np.pi * natural_hz) ** 2)
        known = rng.random() < 0.5
        self.payloads = (0.05, 0.1, 0.2) if rng.random() < 0.5 else (0.0, 0.08, 0.16, 0.24)
        super().__init__(
            name="payload-arm",
            states=("angle", "rate"),
            inputs=(Signal("command", "rad", draw_between(rng)),),
            outputs=(
                Signal("angle", "rad", equation="angle"),
                Signal("motor_torque", "N m", equation="loop_gain*(command - angle) - loop_damping*rate"),
            ),
            parameters=(
                Parameter("inertia", own, 0.0 if known else 0.05, "kg m^2"),
                Parameter("own_gravity", near(rng, 0.05, 1.5), 0.03, "N m"),
                Parameter("arm", arm, 0.0, "m"),
                Parameter("loop_gain", loop, "free", "N m/rad"),
                damping_of(rng, "loop_damping", (0.3, 0.8), loop * held),
            ),
            equations={
                "angle": "rate",
                "rate": "(loop_gain*(command - angle) - loop_damping*rate + force.shaft"
                " - (own_gravity + 9.80665*payload_kg*arm)*sin(angle)) / (inertia + payload_kg*arm^2)",
            },
            sites=(
                Site(
                    "shaft",
                    "joint",
                    "angle",
                    "rate",
                    load="(own_gravity + 9.80665*payload_kg*arm)*sin(angle)",
                    effects=(
                        *JOINT,
                        "load-dependent-friction",
                        "viscous-damping",
                        "constant-force",
                        *only_if(known, "added-inertia"),
                    ),
                ),
            ),
            initial={"angle": 0.0, "rate": 0.0},
            conditions=("payload_kg",),
            input_effects={"command": (*DRIVEN, "bias", "gain-error")},
            output_effects={
                "angle": (*READ, "bias", "gain-error", "cross-talk"),
                "motor_torque": (*READ, "bias", "gain-error", "cross-talk"),
            },
        )

    def programme(self, rng: np.random.Generator, trials: int) -> Programme:
        base = driven(rng, trials, time_base(rng), [np.deg2rad(rng.uniform(25, 60))], self.natural_hz * 0.5)
        for index, condition in enumerate(base.conditions):
            condition["payload_kg"] = self.payloads[index % len(self.payloads)]
        return base


class LinearStage(Plant):
    """A carriage pushed by a force: metres and newtons; some on a spring, some with a speed sensor."""

    def __init__(self, rng: np.random.Generator) -> None:
        mass, natural_hz = near(rng, 6.0, 1.6), rng.uniform(0.6, 2.0)
        spring = four_digits(mass * (2 * np.pi * natural_hz) ** 2)
        sprung = rng.random() < 0.6
        tacho = rng.random() < 0.5
        self.natural_hz, self.push = natural_hz, spring * near(rng, 0.02)
        known = rng.random() < 0.5
        names = ("stiffness*position + " if sprung else "") + "damping*speed"
        damping = four_digits(rng.uniform(0.1, 0.5) * np.sqrt(spring * mass))
        site_spring = sprung and rng.random() < 0.5
        super().__init__(
            name="linear-stage",
            states=("position", "speed"),
            inputs=(Signal("force", "N", draw_between(rng)),),
            outputs=(
                Signal("position", "m", equation="position"),
                *only_if(tacho, Signal("speed_sensor", "m/s", equation="speed")),
            ),
            parameters=(
                Parameter("mass", mass, 0.0 if known else 0.05, "kg"),
                *only_if(sprung, Parameter("stiffness", spring, "free", "N/m")),
                Parameter("damping", damping, "free", "N s/m"),
            ),
            equations={"position": "speed", "speed": f"(force + force.carriage - ({names})) / mass"},
            sites=(
                Site(
                    "carriage",
                    "joint",
                    "position",
                    "speed",
                    "stiffness" if site_spring else "",
                    spring="stiffness" if sprung else "",
                    effects=(
                        *JOINT,
                        *only_if(site_spring, "backlash"),
                        *only_if(not site_spring, "constant-force"),
                    ),
                ),
            ),
            initial={"position": 0.0, "speed": 0.0} if sprung else {"position": "free", "speed": 0.0},
            input_effects={
                "force": (
                    "saturation",
                    "rate-limit",
                    "dead-band",
                    *only_if(tacho, "lag", "delay"),
                    *only_if(not site_spring, "bias"),
                )
            },
            output_effects={"position": ("saturation", "drift", *only_if(tacho, "lag", "delay"))}
            | (
                {"speed_sensor": ("lag", "delay", "bias", "drift", "saturation", "gain-error", "cross-talk")}
                if tacho
                else {}
            ),
        )

    def programme(self, rng: np.random.Generator, trials: int) -> Programme:
        return driven(rng, trials, time_base(rng), [self.push * rng.uniform(0.7, 1.3)], self.natural_hz)
