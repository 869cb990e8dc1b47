"""Loads on the fish's fins: two pectoral five-bars and a tail, as flat plates in water that remembers.

The outer links of each five-bar carry the fin: blades (see `attachments`), cut into blade elements, each with the
force of `plate_force`, and with the drag of its edges (`edge_drag`): blades of laminate some 2 mm thick and 2.5 cm
deep, at a Reynolds number of 1e4 (chosen: 0.07, of which 0.02 is friction and the rest blunt edges). The struts
that hold the blades move with them, and have the drag of cylinders (`strut_drag`; chosen: four a fin, 4.3 mm
thick, coefficient 1.1). Blades and struts are a laminate that bends: their axes follow the mechanism's with a lag
(twice 25 ms, chosen), which makes of the snap through the flat state a swing. Added mass is left out: its force
averages out over a cycle. The tail is two plates, the second of which follows the first with a lag (a flexible
sheet, so thin that its edges count for nothing).

Each fin sets the water around it in motion: its reaction accelerates an entrained mass of water, whose speed
dies out over seconds (2 s, chosen). The mass is that of the water through which a fin sweeps, some 15 cm along the
body: 3 kg at a pectoral fin, 8 kg at the tail with its larger stroke (chosen). The next strokes, and the next
trial, meet that water. A fish that moves leaves it behind: water passes a fin's 15 cm, and is replaced by what
comes from ahead. That is still water at the pectoral fins; between them and the tail, 21 cm long, what the
pectoral fins left; at the tail, what comes from there. So the tail beats in the wake of the pectoral fins, a few
seconds later.

Body frame: x forward, y left, z up; the left side mirrors the right one (y -> -y), so that equal angles of
right and left joints are a mirrored motion. At zero angles a pectoral fin is a flat sheet that points
sideways; its normal points up and forward, 33.4 degrees from up.

The source gives no dimensions of the fins. Tilt and blades (see `attachments`), and the drag of the body (see
`model`), are those with which this law gives three of its findings: the drag at neutral and in the best pose, and
that pectoral fins alone do about as much as to cancel drag at 0.1 m/s.

A speed is taken over a step, from the directions at its two ends; directions are those in its middle, so that
the forces of a beat are right to second order in the step.

The blades that can be put on the pectoral five-bars: three of one piece, and one of two bodies.

The source compared three attachments and a fin of two bodies (experiment E6.a) and gives no dimensions; those here
are chosen. Each is blades that span the two outer sectors of the mechanism between two radii, cut into two rings of
blade elements; in the fin of two bodies the outer ring hangs at the inner one and follows it late.

Force of water on flat plates and thin struts that move through it.

Eq. (7.11) of the source work: ``F = rho u^2 A sin(alpha)``, normal to the plate, with u the speed of the plate
relative to the water and alpha its angle of attack. Its components along and across the flow are the drag (7.9)
and the lift (7.10). With the sign written out for motion that goes to and fro, and as a vector, it is
``F = -rho A |u| (u . n) n``, whichever way the normal n points.

A plate edge-on has a drag, too, which (7.11) leaves out: that of its edges and its two faces,
``F = -1/2 rho C A |u| (u - (u . n) n)``. And what holds a fin is struts: their drag is that of the flow across
them, ``F = -1/2 rho C d l |u - (u . s) s| (u - (u . s) s)`` for a strut along s (Hoerner, Fluid-Dynamic Drag
(1965), chapter 3: circular cylinders, and the principle of cross-flow).
"""

import math
from dataclasses import dataclass
from functools import cached_property
from typing import Literal

import numpy as np

from labrun.devices import FloatArray
from labrun.models import kernel
from labrun_plugins.rigs.fish.five_bar import ARC_RAD, link_axes, reached

RINGS = 2
AttachmentName = Literal["broad", "slender", "short", "two-body"]


@dataclass(frozen=True)
class Attachment:
    """One kind of blade.

    Attributes
    ----------
    inner_m, outer_m
        Distance of its edges from the mechanism's centre.
    outer_lag_s
        How late the outer ring follows the inner one; 0 for a blade of one piece.
    """

    inner_m: float
    outer_m: float
    outer_lag_s: float = 0.0

    @cached_property
    def ring_m(self) -> FloatArray:
        """Distance of the blade elements from the mechanism's centre, shape (RINGS,)."""
        edges = self._edges()
        return 2.0 / 3.0 * (edges[1:] ** 3 - edges[:-1] ** 3) / (edges[1:] ** 2 - edges[:-1] ** 2)

    @cached_property
    def ring_m2(self) -> FloatArray:
        """Area of a blade element, half a sector of each ring, shape (RINGS,)."""
        edges = self._edges()
        return 0.5 * (ARC_RAD / 2.0) * (edges[1:] ** 2 - edges[:-1] ** 2)

    @cached_property
    def area_m2(self) -> float:
        """Area of one fin."""
        return float(4 * self.ring_m2.sum())

    def _edges(self) -> FloatArray:
        return np.linspace(self.inner_m, self.outer_m, RINGS + 1)


ATTACHMENTS: dict[str, Attachment] = {
    "broad": Attachment(0.08, 0.1048),
    "slender": Attachment(0.098, 0.1048),
    "short": Attachment(0.06, 0.085),
    "two-body": Attachment(0.08, 0.1048, outer_lag_s=0.06),
}


WATER_KG_M3 = 1000.0


@kernel
def plate_force(
    u_x: float, u_y: float, u_z: float, n_x: float, n_y: float, n_z: float, area_m2: float
) -> float:
    """Return the force along the unit normal n, N, on a plate that moves through water at velocity u, m/s."""
    speed: float = (u_x * u_x + u_y * u_y + u_z * u_z) ** 0.5
    return -WATER_KG_M3 * area_m2 * speed * (u_x * n_x + u_y * n_y + u_z * n_z)


@kernel
def edge_drag(
    u_x: float, u_y: float, u_z: float, n_x: float, n_y: float, n_z: float, area_m2: float, coefficient: float
) -> tuple[float, float, float]:
    """Return the force in a plate's own plane, N: against the part of its velocity u, m/s, that lies in it."""
    across = u_x * n_x + u_y * n_y + u_z * n_z
    share = -0.5 * WATER_KG_M3 * coefficient * area_m2 * (u_x * u_x + u_y * u_y + u_z * u_z) ** 0.5
    return share * (u_x - across * n_x), share * (u_y - across * n_y), share * (u_z - across * n_z)


@kernel
def strut_drag(
    u_x: float, u_y: float, u_z: float, s_x: float, s_y: float, s_z: float, area_m2: float, coefficient: float
) -> tuple[float, float, float]:
    """Return the force on a thin strut along the unit vector s, N, of frontal area diameter times length."""
    along = u_x * s_x + u_y * s_y + u_z * s_z
    a_x, a_y, a_z = u_x - along * s_x, u_y - along * s_y, u_z - along * s_z
    share = -0.5 * WATER_KG_M3 * coefficient * area_m2 * (a_x * a_x + a_y * a_y + a_z * a_z) ** 0.5
    return share * a_x, share * a_y, share * a_z


JOINTS = ("right_1", "right_2", "left_1", "left_2", "tail")
TILT_RAD = math.radians(33.4)
ROOT_M = (0.05, 0.035, 0.0)
EDGE_COEFFICIENT = 0.07
STRUT_COEFFICIENT = 1.1
STRUT_M = 0.0043
"""Diameter of a strut."""
TAIL_ROOT_M = -0.25
_DIRECTIONS = 4
_TAIL_PIECE_M, _TAIL_HEIGHT_M = 0.06, 0.10
_TAIL_LAG_S = 0.08
_BEND_S = 0.025
_STAGES = 2

_ENTRAINED_KG = (3.0, 3.0, math.inf, 8.0)
_WATER_X_M = (0.05, 0.05, -0.13, -0.31)
_WATER_LONG_M = (0.15, 0.15, 0.21, 0.15)
_WAKE_S = 2.0
WATERS = 4
"""Stretches of water that remember: at the right and the left fin, between them and the tail, and at the tail."""

_ELEMENTS = 2 * 2 * _DIRECTIONS * 3
_BENT = 2 * (_STAGES + 1) * 9
FIN_MEMORY = _ELEMENTS + _BENT + 2
"""Numbers that `fin_loads` keeps in `motion`: directions of the blade elements of both rings, axes of both fins as they
are bent in each stage of the lag and in the outer ring, and both tail angles."""


@kernel
def _bend(axes: FloatArray, share: float, outer_share: float, bent: FloatArray) -> None:
    """Let a fin's axes follow its mechanism's by this share of the way, and those of its outer ring follow these."""
    for axis in range(3):
        for i in range(3):
            value = axes[axis, i]
            for stage in range(_STAGES):
                bent[stage, axis, i] += share * (value - bent[stage, axis, i])
                value = bent[stage, axis, i]
            bent[_STAGES, axis, i] += outer_share * (value - bent[_STAGES, axis, i])


@kernel
def _directions(bent: FloatArray, axes: FloatArray, directions: FloatArray) -> None:
    """Write the directions of a ring's blade elements, from axes that need not be unit vectors."""
    near, far = math.sin(0.75 * ARC_RAD) / math.sin(ARC_RAD), math.sin(0.25 * ARC_RAD) / math.sin(ARC_RAD)
    for axis in range(3):
        for i in range(3):
            axes[axis, i] = bent[axis, i]
    _normalize(axes)
    for link in range(2):
        for i in range(3):
            directions[2 * link, i] = near * axes[link, i] + far * axes[2, i]
            directions[2 * link + 1, i] = far * axes[link, i] + near * axes[2, i]
    _normalize(directions)


@kernel
def _normalize(vectors: FloatArray) -> None:
    for row in range(len(vectors)):
        scale = 1.0 / math.sqrt(vectors[row, 0] ** 2 + vectors[row, 1] ** 2 + vectors[row, 2] ** 2)
        for i in range(3):
            vectors[row, i] *= scale


@kernel
def _to_body(side: float, vectors: FloatArray) -> None:
    """Turn rows (outward, along the sheet, normal) into body coordinates; side is -1 right, +1 left."""
    cosine, sine = math.cos(TILT_RAD), math.sin(TILT_RAD)
    for row in range(len(vectors)):
        outward, along, normal = vectors[row, 0], vectors[row, 1], vectors[row, 2]
        vectors[row, 0] = cosine * along + sine * normal
        vectors[row, 1] = side * outward
        vectors[row, 2] = cosine * normal - sine * along


@kernel
def _add(load: FloatArray, fx: float, fy: float, fz: float, x: float, y: float, z: float) -> None:
    """Add a force that acts at (x, y, z) to a wrench about the origin."""
    load[0] += fx
    load[1] += fy
    load[2] += fz
    load[3] += y * fz - z * fy
    load[4] += z * fx - x * fz
    load[5] += x * fy - y * fx


def fin_loads(
    joints: FloatArray,
    going: FloatArray,
    step_s: float,
    motion: FloatArray,
    wake: FloatArray,
    attachment: Attachment = ATTACHMENTS["broad"],
    caudal: bool = True,
) -> FloatArray:
    """Return the loads on all fins at each step, about the body's origin.

    Parameters
    ----------
    joints : (n, 5)
        Angles at the end of each step, rad, in the order of `JOINTS`.
    going : (n, 3)
        Speed of the body ahead and to its left (m/s), and its rate of turn to the left (rad/s).
    step_s
        Length of a step.
    motion : (FIN_MEMORY,), wake : (WATERS, 3)
        Memory, updated: the last directions; velocity of the water at right fin, left fin, between these and the tail,
        and at the tail (m/s), along the body's axes.
    attachment
        Blades of the pectoral fins.
    caudal
        Whether the tail is on.

    Returns
    -------
    (n, 7)
        Force (N) and torque (N m), six axes; and the mean size of the forces (N), a measure of how the water
        is stirred.
    """
    before = motion[:_ELEMENTS].reshape(2, 2, _DIRECTIONS, 3)
    bent = motion[_ELEMENTS:-2].reshape(2, _STAGES + 1, 3, 3)
    loads = np.zeros((len(joints), 7))
    _add_loads(
        joints, going, step_s, before, bent, motion[-2:], wake, loads,
        attachment.ring_m, attachment.ring_m2, attachment.inner_m, attachment.outer_lag_s,
        _TAIL_PIECE_M * _TAIL_HEIGHT_M if caudal else 0.0,
    )  # fmt: skip
    return loads


@kernel
def _add_loads(
    joints: FloatArray, going: FloatArray, step_s: float, before: FloatArray, bent: FloatArray, tail: FloatArray,
    wake: FloatArray, loads: FloatArray, ring_m: FloatArray, ring_m2: FloatArray, inner_m: float, outer_lag_s: float,
    tail_m2: float,
) -> None:  # fmt: skip
    mechanism, axes = np.empty((2, 3, 3)), np.empty((3, 3))
    share = 1.0 - math.exp(-step_s / _BEND_S)
    outer_share = 1.0 - math.exp(-step_s / outer_lag_s) if outer_lag_s > 0.0 else 1.0
    fin, now = np.zeros(6), np.empty((_DIRECTIONS, 3))
    for n in range(len(joints)):
        ahead, aside, turning = going[n, 0], going[n, 1], going[n, 2]
        for which in range(2):
            side = -1.0 if which == 0 else 1.0
            fin[:] = 0.0
            first, second = joints[n, 2 * which], joints[n, 2 * which + 1]
            if n == 0 or first != joints[n - 1, 2 * which] or second != joints[n - 1, 2 * which + 1]:
                link_axes(*reached(first, second), mechanism[which])
            _bend(mechanism[which], share, outer_share, bent[which])
            for ring in range(len(ring_m)):
                if ring == 0 or outer_lag_s > 0.0:
                    _directions(bent[which, _STAGES if ring > 0 else _STAGES - 1], axes, now)
                    _to_body(side, now)
                _blades(
                    side, now, before[which, ring], ring_m[ring], ring_m2[ring], inner_m if ring == 0 else 0.0,
                    ahead, aside, turning, wake[which], 1.0 / step_s, fin,
                )  # fmt: skip
                before[which, ring] = now
            _take_along(wake, which, fin, ahead, aside, turning, step_s)
            for i in range(6):
                loads[n, i] += fin[i]
            loads[n, 6] += math.sqrt(fin[0] ** 2 + fin[1] ** 2 + fin[2] ** 2)
        fin[:] = 0.0
        _take_along(wake, 2, fin, ahead, aside, turning, step_s)
        _tail(joints[n, 4], ahead, aside, turning, step_s, tail_m2, tail, wake[3], fin)
        _take_along(wake, 3, fin, ahead, aside, turning, step_s)
        for i in range(6):
            loads[n, i] += fin[i]
        loads[n, 6] += math.sqrt(fin[0] ** 2 + fin[1] ** 2)


@kernel
def _blades(
    side: float, now: FloatArray, before: FloatArray, radius: float, area: float, strut_m: float, ahead: float,
    aside: float, turning: float, water: FloatArray, rate_hz: float, load: FloatArray,
) -> None:  # fmt: skip
    """Add the load on one ring of blade elements, and on the struts of that length."""
    middle, rate = np.empty((_DIRECTIONS, 3)), np.empty(3)
    for d in range(_DIRECTIONS):
        for i in range(3):
            middle[d, i] = 0.5 * (now[d, i] + before[d, i])
    root_x, root_y = ROOT_M[0], side * ROOT_M[1]
    strut_at = strut_m / math.sqrt(3.0)  # where the mean of the squared speed of a turning strut is found
    for d in range(_DIRECTIONS):
        for i in range(3):
            rate[i] = (now[d, i] - before[d, i]) * rate_hz
        # The plate of a link holds both of its elements: its normal is square to them.
        first, other = 2 * (d // 2), 2 * (d // 2) + 1
        n_x = middle[first, 1] * middle[other, 2] - middle[first, 2] * middle[other, 1]
        n_y = middle[first, 2] * middle[other, 0] - middle[first, 0] * middle[other, 2]
        n_z = middle[first, 0] * middle[other, 1] - middle[first, 1] * middle[other, 0]
        scale = 1.0 / math.sqrt(n_x * n_x + n_y * n_y + n_z * n_z)
        n_x, n_y, n_z = scale * n_x, scale * n_y, scale * n_z
        x, y, z = root_x + radius * middle[d, 0], root_y + radius * middle[d, 1], radius * middle[d, 2]
        u_x = radius * rate[0] + ahead - turning * y - water[0]
        u_y = radius * rate[1] + aside + turning * x - water[1]
        u_z = radius * rate[2] - water[2]
        force = plate_force(u_x, u_y, u_z, n_x, n_y, n_z, area)
        e_x, e_y, e_z = edge_drag(u_x, u_y, u_z, n_x, n_y, n_z, area, EDGE_COEFFICIENT)
        _add(load, force * n_x + e_x, force * n_y + e_y, force * n_z + e_z, x, y, z)
        if strut_m > 0.0:
            x, y = root_x + strut_at * middle[d, 0], root_y + strut_at * middle[d, 1]
            u_x = strut_at * rate[0] + ahead - turning * y - water[0]
            u_y = strut_at * rate[1] + aside + turning * x - water[1]
            u_z = strut_at * rate[2] - water[2]
            e_x, e_y, e_z = strut_drag(
                u_x, u_y, u_z, middle[d, 0], middle[d, 1], middle[d, 2], STRUT_M * strut_m, STRUT_COEFFICIENT
            )
            _add(load, e_x, e_y, e_z, x, y, strut_at * middle[d, 2])


@kernel
def _take_along(
    wake: FloatArray, which: int, force: FloatArray, ahead: float, aside: float, turning: float, step_s: float
) -> None:
    """Let a stretch of water take up the reaction to a force, come to rest over time, and be replaced by what comes."""
    passing = math.sqrt(ahead**2 + (aside + turning * _WATER_X_M[which]) ** 2) / _WATER_LONG_M[which]
    from_ahead = max(0.0, ahead) / _WATER_LONG_M[which] if which >= 2 else 0.0
    turned_x, turned_y = turning * wake[which, 1], -turning * wake[which, 0]
    for i in range(3):
        comes = 0.0
        if which == 2:
            comes = 0.5 * (wake[0, i] + wake[1, i])
        elif which == 3:
            comes = wake[2, i]
        turned = turned_x if i == 0 else (turned_y if i == 1 else 0.0)
        wake[which, i] += step_s * (
            -force[i] / _ENTRAINED_KG[which]
            - wake[which, i] * (1.0 / _WAKE_S + passing)
            + comes * from_ahead
            + turned
        )


@kernel
def _tail(
    angle: float, ahead: float, aside: float, turning: float, step_s: float, area: float, angles: FloatArray,
    water: FloatArray, load: FloatArray,
) -> None:  # fmt: skip
    """Add the load on the tail's two plates, and update their angles."""
    stem_before, tip_before = angles[0], angles[1]
    tip_end = angle + (tip_before - angle) * math.exp(-step_s / _TAIL_LAG_S)
    stem_rate, tip_rate = (angle - stem_before) / step_s, (tip_end - tip_before) / step_s
    stem, tip = 0.5 * (angle + stem_before), 0.5 * (tip_end + tip_before)
    angles[0], angles[1] = angle, tip_end
    half = 0.5 * _TAIL_PIECE_M
    # Points backward at zero; a positive angle swings it to the right (turn about z).
    cosine, sine = math.cos(stem), math.sin(stem)
    x, y = TAIL_ROOT_M - half * cosine, -half * sine
    u_x = half * sine * stem_rate + ahead - turning * y - water[0]
    u_y = -half * cosine * stem_rate + aside + turning * x - water[1]
    force = plate_force(u_x, u_y, 0.0, -sine, cosine, 0.0, area)
    _add(load, -force * sine, force * cosine, 0.0, x, y, 0.0)
    tip_cosine, tip_sine = math.cos(tip), math.sin(tip)
    x = TAIL_ROOT_M - _TAIL_PIECE_M * cosine - half * tip_cosine
    y = -_TAIL_PIECE_M * sine - half * tip_sine
    u_x = _TAIL_PIECE_M * sine * stem_rate + half * tip_sine * tip_rate + ahead - turning * y - water[0]
    u_y = -_TAIL_PIECE_M * cosine * stem_rate - half * tip_cosine * tip_rate + aside + turning * x - water[1]
    force = plate_force(u_x, u_y, 0.0, -tip_sine, tip_cosine, 0.0, area)
    _add(load, -force * tip_sine, force * tip_cosine, 0.0, x, y, 0.0)


def motion_at(joints: FloatArray) -> FloatArray:
    """Return the `motion` memory of fins at rest at these joint angles, shape (FIN_MEMORY,)."""
    motion = np.zeros(FIN_MEMORY)
    # One step that is longer than any lag.
    fin_loads(joints[None, :], np.zeros((1, 3)), 1e6, motion, np.zeros((WATERS, 3)))
    motion[-1] = joints[4]
    return motion
