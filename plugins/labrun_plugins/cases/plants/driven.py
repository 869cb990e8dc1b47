"""Driven mechanisms (a hinge, an arm with a payload, a linear stage), two joints in a chain, and what swings freely."""

from collections.abc import Mapping, Sequence

import numpy as np

from ..plant import (
    ALL_READ,
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
    draw_between,
    four_digits,
    near,
    only_if,
)
from .programmes import driven, releases, time_base


class HingeDrive(Plant):
    """A pendulum on a spring hinge, driven by a torque; some with a cell that measures the hinge's reaction."""

    def __init__(self, rng: np.random.Generator) -> None:
        inertia, natural_hz = near(rng, 1.5e-3, 2.0), rng.uniform(0.8, 2.5)
        total = inertia * (2 * np.pi * natural_hz) ** 2
        sprung, cell, known = rng.random() < 0.5, rng.random() < 0.6, rng.random() < 0.5
        gravity = four_digits(total * rng.uniform(0.3, 0.6))
        damping = rng.random() < 0.8
        spring = four_digits(total - gravity)
        damper = " + damping*rate" if damping else ""
        self.peak, self.natural_hz = total, natural_hz
        reaction = Signal("reaction", "N m", equation=f"stiffness*angle{damper} - force.hinge")
        pull = f"stiffness*angle{damper.replace('+', '-')}"
        hidden = (
            *JOINT, "load-dependent-friction", "backlash" if sprung else "constant-force",
            *only_if(known, "added-inertia"), *only_if(not damping, "viscous-damping"),
        )  # fmt: skip
        super().__init__(
            name="hinge-drive",
            states=("angle", "rate"),
            inputs=(Signal("torque", "N m", draw_between(rng)),),
            outputs=(Signal("angle", "rad", equation="angle"), *only_if(cell, reaction)),
            parameters=(
                Parameter("inertia", inertia, 0.0 if known else 0.03, "kg m^2"),
                Parameter("gravity_torque", gravity, 0.03, "N m"),
                Parameter("stiffness", spring, "free", "N m/rad"),
                *only_if(damping, damping_of(rng, "damping", (0.06, 0.3), total * inertia)),
            ),
            equations={
                "angle": "rate",
                "rate": f"(torque + force.hinge - {pull} - gravity_torque*sin(angle)) / inertia",
            },
            sites=(
                Site(
                    "hinge", "joint", "angle", "rate", "stiffness" if sprung else "", "gravity_torque*cos(angle)",
                    "stiffness", hidden,
                ),
            ),
            initial={"angle": 0.0, "rate": 0.0},
            input_effects={
                "torque": (
                    *(DRIVEN if cell else ("saturation", "rate-limit", "dead-band")),
                    *only_if(not sprung, "bias"), *only_if(known and cell, "gain-error"),
                )
            },
            output_effects={"angle": (*(READ if cell else ("drift", "saturation")), "bias")}
            | ({"reaction": ALL_READ} if cell else {}),
        )  # fmt: skip

    def programme(self, rng: np.random.Generator, trials: int) -> Programme:
        return driven(rng, trials, time_base(rng), [self.peak * rng.uniform(0.15, 0.35)], self.natural_hz)


class PayloadArm(Plant):
    """An arm that lifts different payloads against gravity, held by a proportional loop on the commanded angle."""

    def __init__(self, rng: np.random.Generator) -> None:
        own, arm = near(rng, 2.5e-3, 1.5), near(rng, 0.12)
        self.natural_hz = rng.uniform(1.5, 3.0)
        held = own + 0.1 * arm**2
        loop = four_digits(held * (2 * np.pi * self.natural_hz) ** 2)
        known = rng.random() < 0.5
        self.payloads = (0.05, 0.1, 0.2) if rng.random() < 0.5 else (0.0, 0.08, 0.16, 0.24)
        pull, weight = (
            "loop_gain*(command - angle) - loop_damping*rate",
            "(own_gravity + 9.80665*payload_kg*arm)*sin(angle)",
        )
        hidden = (
            *JOINT, "load-dependent-friction", "viscous-damping", "constant-force",
            *only_if(known, "added-inertia"),
        )  # fmt: skip
        super().__init__(
            name="payload-arm",
            states=("angle", "rate"),
            inputs=(Signal("command", "rad", draw_between(rng)),),
            outputs=(Signal("angle", "rad", equation="angle"), Signal("motor_torque", "N m", equation=pull)),
            parameters=(
                Parameter("inertia", own, 0.0 if known else 0.05, "kg m^2"),
                Parameter("own_gravity", near(rng, 0.05, 1.5), 0.03, "N m"),
                Parameter("arm", arm, 0.0, "m"),
                Parameter("loop_gain", loop, "free", "N m/rad"),
                damping_of(rng, "loop_damping", (0.3, 0.8), loop * held),
            ),
            equations={
                "angle": "rate",
                "rate": f"({pull} + force.shaft - {weight}) / (inertia + payload_kg*arm^2)",
            },
            sites=(Site("shaft", "joint", "angle", "rate", load=weight, effects=hidden),),
            initial={"angle": 0.0, "rate": 0.0},
            conditions=("payload_kg",),
            input_effects={"command": (*DRIVEN, "bias", "gain-error")},
            output_effects={"angle": ALL_READ, "motor_torque": ALL_READ},
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
        sprung, tacho = rng.random() < 0.6, rng.random() < 0.5
        self.natural_hz, self.push = natural_hz, spring * near(rng, 0.02)
        known = rng.random() < 0.5
        pull = ("stiffness*position + " if sprung else "") + "damping*speed"
        damping = four_digits(rng.uniform(0.1, 0.5) * np.sqrt(spring * mass))
        site_spring = sprung and rng.random() < 0.5
        hidden = (*JOINT, "backlash" if site_spring else "constant-force")
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
            equations={"position": "speed", "speed": f"(force + force.carriage - ({pull})) / mass"},
            sites=(
                Site(
                    "carriage", "joint", "position", "speed", "stiffness" if site_spring else "",
                    spring="stiffness" if sprung else "", effects=hidden,
                ),
            ),
            initial={"position": 0.0, "speed": 0.0} if sprung else {"position": "free", "speed": 0.0},
            input_effects={
                "force": (
                    "saturation", "rate-limit", "dead-band", *only_if(tacho, "lag", "delay"),
                    *only_if(not site_spring, "bias"),
                )
            },
            output_effects={"position": ("saturation", "drift", *only_if(tacho, "lag", "delay"))}
            | (
                {"speed_sensor": ("lag", "delay", "bias", "drift", "saturation", "gain-error", "cross-talk")}
                if tacho
                else {}
            ),
        )  # fmt: skip

    def programme(self, rng: np.random.Generator, trials: int) -> Programme:
        return driven(rng, trials, time_base(rng), [self.push * rng.uniform(0.7, 1.3)], self.natural_hz)


class FreeDecay(Plant):
    """A hinge let go: a pendulum, or a fin on its spring."""

    def __init__(self, rng: np.random.Generator) -> None:
        self.pendulum = rng.random() < 0.5
        inertia, natural_hz = near(rng, 3e-3, 2.0), rng.uniform(0.8, 2.2)
        total = four_digits(inertia * (2 * np.pi * natural_hz) ** 2)
        damping = four_digits(rng.uniform(0.01, 0.05) * np.sqrt(total * inertia))
        damped = rng.random() < 0.8
        start: float | str = str(rng.choice(["release_rad", "first", "free"]))
        if self.pendulum:
            restoring, unit, law = "gravity_torque", "N m", "gravity_torque*sin(angle)"
            more: tuple[str, ...] = ("constant-force", "load-dependent-friction")
        else:
            restoring, unit, law = "stiffness", "N m/rad", "stiffness*angle"
            # let go from where nobody knows, a spring with another rest is a sensor with another zero
            more = ("backlash", *only_if(start == "release_rad", "rest-offset"))
        super().__init__(
            name="free-swing" if self.pendulum else "fin-decay",
            states=("angle", "rate"),
            outputs=(Signal("angle", "rad", equation="angle"),),
            parameters=(
                Parameter("inertia", inertia, 0.0, "kg m^2"),
                Parameter(restoring, total, "free" if rng.random() < 0.6 else 0.03, unit),
                *only_if(damped, Parameter("damping", damping, "free", "N m s/rad")),
            ),
            equations={
                "angle": "rate",
                "rate": f"(force.hinge - {law}{' - damping*rate' if damped else ''}) / inertia",
            },
            sites=(
                Site(
                    "hinge", "joint", "angle", "rate", "" if self.pendulum else "stiffness",
                    "gravity_torque*cos(angle)" if self.pendulum else "",
                    effects=(*JOINT, *only_if(not damped, "viscous-damping"), *more),
                ),
            ),
            initial={"angle": start, "rate": 0.0 if start == "release_rad" or rng.random() < 0.5 else "free"},
            output_effects={"angle": ("saturation", "drift")},
        )  # fmt: skip

    def start(self, conditions: Sequence[Mapping[str, float | str]]) -> FloatArray:
        start = np.zeros((2, len(conditions)))
        start[0] = [condition["release_rad"] for condition in conditions]
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
        shaft, known = rng.random() < 0.6, rng.random() < 0.5
        tolerance = 0.0 if known else 0.04
        hidden = (*JOINT, *only_if(known, "added-inertia"))
        twist = "coupling*(angle_2 - angle_1)"
        super().__init__(
            name="two-joint-chain",
            states=("angle_1", "rate_1", "angle_2", "rate_2"),
            inputs=(Signal("torque_1", "N m"), Signal("torque_2", "N m")),
            outputs=(
                Signal("angle_1", "rad", equation="angle_1"),
                Signal("angle_2", "rad", equation="angle_2"),
                *only_if(shaft, Signal("shaft_torque", "N m", equation=twist)),
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
                f" + {twist}) / inertia_1",
                "angle_2": "rate_2",
                "rate_2": "(torque_2 + force.elbow - stiffness_2*angle_2 - damping_2*rate_2"
                f" - {twist} - gravity_2*sin(angle_2)) / inertia_2",
            },
            sites=(
                Site("shoulder", "joint", "angle_1", "rate_1", "stiffness_1", effects=(*hidden, "backlash")),
                Site(
                    "elbow", "joint", "angle_2", "rate_2", load="gravity_2*cos(angle_2)",
                    effects=(*hidden, "load-dependent-friction", "constant-force"),
                ),
            ),
            initial={"angle_1": 0.0, "rate_1": 0.0, "angle_2": 0.0, "rate_2": 0.0},
            input_effects={"torque_1": DRIVEN, "torque_2": (*DRIVEN, "bias")},
            output_effects={"angle_1": ALL_READ, "angle_2": ALL_READ},
        )  # fmt: skip
        self.peak = [0.3 * k1, 0.3 * k2]

    def programme(self, rng: np.random.Generator, trials: int) -> Programme:
        return driven(rng, trials, time_base(rng), self.peak, self.natural_hz)
