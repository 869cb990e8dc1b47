"""A robot's body as MJCF: an arm, or two legs on a stand, of random lengths, masses and axes."""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]

SERVO_HZ = (3.0, 6.0)
SERVO_DAMPING = (0.6, 1.0)
_AXES = ((0, 0, 1), (0, 1, 0), (0, 1, 0), (0, 0, 1), (0, 1, 0), (0, 0, 1), (0, 1, 0), (0, 0, 1))
_HIP = ((1, 0, 0), (0, 1, 0), (0, 0, 1), (0, 1, 0), (0, 1, 0), (1, 0, 0))


@dataclass(frozen=True)
class Link:
    """One link and the joint that it hangs on.

    Attributes
    ----------
    parent
        Place of the link it hangs on; -1 for the stand.
    at, length_m
        Where the joint is in the frame of the parent, and how long the link is, along z.
    armature, damping, kp, kv
        Rotor inertia behind the gear, viscous damping, gains of the position servo; SI.
    """

    name: str
    parent: int
    at: tuple[float, float, float]
    axis: tuple[int, int, int]
    length_m: float
    radius_m: float
    mass: float
    armature: float = 0.0
    damping: float = 0.0
    kp: float = 0.0
    kv: float = 0.0


@dataclass(frozen=True)
class Body:
    """A robot; `upright` tells whether links point up (an arm) or down (legs)."""

    name: str
    links: tuple[Link, ...]
    upright: bool

    def xml(self, *, gravity: tuple[float, float, float] = (0.0, 0.0, -9.81), payload: float = 0.0) -> str:
        """Return MJCF; `payload` in kg sits at the end of the first chain."""
        tip = max((k for k in range(len(self.links)) if self._first(k)), default=0)
        worldbody = "".join(
            self._element(k, tip, payload) for k, link in enumerate(self.links) if link.parent < 0
        )
        actuators = "".join(
            f'<position name="{link.name}" joint="{link.name}" kp="{link.kp:.9g}" kv="{link.kv:.9g}"/>'
            for link in self.links
        )
        return (
            f'<mujoco model="{self.name}"><option gravity="{gravity[0]:.9g} {gravity[1]:.9g} {gravity[2]:.9g}"/>'
            '<compiler angle="radian"/><default><geom contype="0" conaffinity="0"/></default>'
            f"<worldbody>{worldbody}</worldbody><actuator>{actuators}</actuator></mujoco>"
        )

    def _first(self, k: int) -> bool:
        while self.links[k].parent >= 0:
            k = self.links[k].parent
        return k == 0

    def _element(self, k: int, tip: int, payload: float) -> str:
        link = self.links[k]
        end = link.length_m if self.upright else -link.length_m
        inner = "".join(
            self._element(j, tip, payload) for j, other in enumerate(self.links) if other.parent == k
        )
        if k == tip and payload:
            ball = f'<geom type="sphere" size="0.02" mass="{payload:.9g}"/>'
            inner += f'<body name="payload" pos="0 0 {end:.6g}">{ball}</body>'
        return (
            f'<body name="{link.name}_link" pos="{link.at[0]:.6g} {link.at[1]:.6g} {link.at[2]:.6g}">'
            f'<joint name="{link.name}" axis="{link.axis[0]} {link.axis[1]} {link.axis[2]}" '
            f'damping="{link.damping:.9g}" '
            f'armature="{link.armature:.9g}"/>'
            f'<geom type="capsule" fromto="0 0 0 0.01 0.015 {end:.6g}" size="{link.radius_m:.6g}" '
            f'mass="{link.mass:.9g}"/>'
            f"{inner}</body>"
        )

    def scattered(self, rng: np.random.Generator, mass: float, gain: float) -> "Body":
        """Return the robot as built: masses and gains off by these relative standard deviations."""

        def off(value: float, share: float) -> float:
            return value * (1.0 + share * float(np.clip(rng.standard_normal(), -2.0, 2.0)))

        links = tuple(
            replace(
                link, mass=off(link.mass, mass), kp=off(link.kp, gain), kv=off(link.kv, gain),
                damping=link.damping * float(np.exp(0.3 * rng.standard_normal())),
            )
            for link in self.links
        )  # fmt: skip
        return replace(self, links=links)


def draw(rng: np.random.Generator) -> Body:
    """Return a random robot with servos that fit its inertia."""
    import mujoco

    legs = rng.random() < 0.4
    count = 2 * int(rng.integers(3, 7)) if legs else int(rng.integers(6, 9))
    if rng.random() < 0.15 and not legs:
        count = 12
    links: list[Link] = []
    size = float(np.exp(rng.uniform(np.log(0.5), np.log(1.5))))
    per = count // 2 if legs else count
    for chain in range(2 if legs else 1):
        for k in range(per):
            length = size * float(rng.uniform(0.1, 0.3)) * (0.9**k)
            mass = 4.0 * size**2 * float(rng.uniform(0.6, 1.4)) * 0.72**k
            parent = -1 if k == 0 else len(links) - 1
            before = links[-1].length_m if k else 0.0
            at = (
                (0.0, (0.15 - 0.3 * chain) * size * legs, 1.5)
                if k == 0
                else (0.0, 0.0, before * (-1.0 if legs else 1.0))
            )
            axis = _HIP[k % 6] if legs else _AXES[k % 8]
            name = f"{('left', 'right')[chain]}_{k + 1}" if legs else f"joint_{k + 1}"
            links.append(Link(name, parent, at, axis, length, 0.04 * size, mass))
    body = Body("legs" if legs else "arm", tuple(links), upright=not legs)
    model = mujoco.MjModel.from_xml_string(body.xml())
    data = mujoco.MjData(model)
    data.qpos[:] = rng.uniform(-0.4, 0.4, model.nq)
    mujoco.mj_forward(model, data)
    full = np.zeros((model.nv, model.nv))
    mujoco.mj_fullM(model, data, full)
    sized = []
    for link, link_inertia in zip(links, np.diag(full), strict=True):
        armature = float(link_inertia * rng.uniform(0.3, 1.5)) + 1e-3 * size**4
        omega = 2.0 * np.pi * float(rng.uniform(*SERVO_HZ))
        inertia = float(link_inertia) + armature
        zeta = float(rng.uniform(*SERVO_DAMPING))
        sized.append(
            replace(
                link, armature=armature, kp=inertia * omega**2, kv=2 * zeta * inertia * omega,
                damping=0.1 * inertia * omega,
            )
        )  # fmt: skip
    return replace(body, links=tuple(sized))
