"""Loads on the fish's fins: two pectoral five-bars and a tail, as flat plates in water that remembers.

The outer links of each five-bar carry the fin: blades that span its two sectors of 72 degrees from 11 to 15.5
cm from the mechanism's centre (chosen, with the range of gaits, so that good turning gaits give some 0.05 N m),
cut into blade elements, each with the force of `plate_force`. They are a laminate that bends: their axes follow the
mechanism's with a lag (twice 25 ms, chosen), which makes of the snap through the flat state a swing. Added mass
is left out: its force averages out over a cycle. The tail is two plates, the second of which follows the first
with a lag (a flexible sheet).

Each fin sets the water around it in motion: its reaction accelerates an entrained mass of water, whose speed
dies out over seconds (chosen: 8 kg, 2 s). The next strokes, and the next trial, meet that water; towing
leaves it behind within 0.15 m (chosen: about a fin's length).

Body frame: x forward, y left, z up; the left side mirrors the right one (y -> -y), so that equal angles of
right and left joints are a mirrored motion. At zero angles a pectoral fin is a flat sheet that points
sideways; its normal points up and forward, 27 degrees from up (chosen: its drag at neutral then matches the
measured one, see `model`).
"""

import math

import numpy as np

from labrun.devices import FloatArray
from labrun.models import kernel
from labrun_plugins.rigs.fish.five_bar import ARC_RAD, link_axes, reached

WATER_KG_M3 = 1000.0
JOINTS = ("right_1", "right_2", "left_1", "left_2", "tail")

_ROOT_M = (0.05, 0.05, 0.0)
_TILT_RAD = math.radians(27.0)
_INNER_M, _OUTER_M = 0.11, 0.155
_RINGS, _DIRECTIONS = 2, 4
_TAIL_ROOT_M = -0.25
_TAIL_PIECE_M, _TAIL_HEIGHT_M = 0.06, 0.10
_TAIL_LAG_S = 0.08
_ENTRAINED_KG = 8.0
_WAKE_S = 2.0
_LEFT_BEHIND_M = 0.15

_edges = np.linspace(_INNER_M, _OUTER_M, _RINGS + 1)
_RING_M = 2.0 / 3.0 * (_edges[1:] ** 3 - _edges[:-1] ** 3) / (_edges[1:] ** 2 - _edges[:-1] ** 2)
"""Distance of the blade elements from the mechanism's centre."""
_RING_M2 = 0.5 * (ARC_RAD / 2.0) * (_edges[1:] ** 2 - _edges[:-1] ** 2)
"""Area of a blade element: half a sector."""
FIN_AREA_M2 = float(4 * _RING_M2.sum())

_BEND_S = 0.025
_STAGES = 2

_ELEMENTS = 2 * _DIRECTIONS * 3
_BENT = 2 * _STAGES * 9
FIN_MEMORY = _ELEMENTS + _BENT + 2
"""Numbers that `fin_loads` keeps in `motion`: directions of the blade elements, axes of both fins as they are
bent in each stage of the lag, and both tail angles."""


@kernel
def plate_force(
    u_x: float, u_y: float, u_z: float, n_x: float, n_y: float, n_z: float, area_m2: float
) -> float:
    """Return the force along the unit normal n, N, on a plate that moves through water at velocity u, m/s.

    Eq. (7.11) of the source work: ``F = rho u^2 A sin(alpha)``, normal to the plate, with u the speed of the plate
    relative to the water and alpha its angle of attack. Its components along and across the flow are the drag (7.9)
    and the lift (7.10). With the sign written out for motion that goes to and fro, and as a vector, it is
    ``F = -rho A |u| (u . n) n``, whichever way the normal n points.
    """
    speed: float = (u_x * u_x + u_y * u_y + u_z * u_z) ** 0.5
    return -WATER_KG_M3 * area_m2 * speed * (u_x * n_x + u_y * n_y + u_z * n_z)


@kernel
def _bend(axes: FloatArray, share: float, bent: FloatArray, now: FloatArray) -> None:
    """Let a fin's axes follow its mechanism's by this share of the way, and write them, as unit vectors."""
    for axis in range(3):
        for i in range(3):
            value = axes[axis, i]
            for stage in range(_STAGES):
                bent[stage, axis, i] += share * (value - bent[stage, axis, i])
                value = bent[stage, axis, i]
            now[axis, i] = value
    _normalize(now)


@kernel
def _directions(axes: FloatArray, directions: FloatArray, normals: FloatArray) -> None:
    """Write the directions of a fin's blade elements and the normals of its links, all unit vectors."""
    near, far = math.sin(0.75 * ARC_RAD) / math.sin(ARC_RAD), math.sin(0.25 * ARC_RAD) / math.sin(ARC_RAD)
    for link in range(2):
        for i in range(3):
            directions[2 * link, i] = near * axes[link, i] + far * axes[2, i]
            directions[2 * link + 1, i] = far * axes[link, i] + near * axes[2, i]
            j, k = (i + 1) % 3, (i + 2) % 3
            normals[link, i] = axes[link, j] * axes[2, k] - axes[link, k] * axes[2, j]
    _normalize(directions)
    _normalize(normals)


@kernel
def _normalize(vectors: FloatArray) -> None:
    for row in range(len(vectors)):
        scale = 1.0 / math.sqrt(vectors[row, 0] ** 2 + vectors[row, 1] ** 2 + vectors[row, 2] ** 2)
        for i in range(3):
            vectors[row, i] *= scale


@kernel
def _to_body(side: float, vectors: FloatArray, count: int) -> None:
    """Turn rows (outward, along the sheet, normal) into body coordinates; side is -1 right, +1 left."""
    cosine, sine = math.cos(_TILT_RAD), math.sin(_TILT_RAD)
    for row in range(count):
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
    joints: FloatArray, tow_m_s: FloatArray, step_s: float, motion: FloatArray, wake: FloatArray
) -> FloatArray:
    """Return the loads on all fins at each step, about the body's origin.

    Parameters
    ----------
    joints : (n, 5)
        Angles at the end of each step, rad, in the order of `JOINTS`.
    tow_m_s : (n,)
        Speed of the body along x, through water at rest.
    step_s
        Length of a step.
    motion : (FIN_MEMORY,), wake : (3, 3)
        Memory, updated: the last directions; velocity of the water at right fin, left fin and tail (m/s).

    Returns
    -------
    (n, 7)
        Force (N) and torque (N m), six axes; and the mean size of the forces (N), a measure of how the water
        is stirred.
    """
    before = motion[:_ELEMENTS].reshape(2, _DIRECTIONS, 3)
    bent = motion[_ELEMENTS:-2].reshape(2, _STAGES, 3, 3)
    loads = np.zeros((len(joints), 7))
    _add_loads(joints, tow_m_s, step_s, before, bent, motion[-2:], wake, loads)
    return loads


@kernel
def _add_loads(
    joints: FloatArray, tow_m_s: FloatArray, step_s: float, before: FloatArray, bent: FloatArray, tail: FloatArray,
    wake: FloatArray, loads: FloatArray,
) -> None:  # fmt: skip
    count = len(joints)
    mechanism, axes, normals = np.empty((2, 3, 3)), np.empty((3, 3)), np.empty((2, 3))
    now = np.empty((_DIRECTIONS, 3))
    share = 1.0 - math.exp(-step_s / _BEND_S)
    rate_hz = 1.0 / step_s
    fin = np.zeros(6)
    for n in range(count):
        for which in range(2):
            side = -1.0 if which == 0 else 1.0
            for i in range(6):
                fin[i] = 0.0
            first, second = joints[n, 2 * which], joints[n, 2 * which + 1]
            if n == 0 or first != joints[n - 1, 2 * which] or second != joints[n - 1, 2 * which + 1]:
                link_axes(*reached(first, second), mechanism[which])
            _bend(mechanism[which], share, bent[which], axes)
            _directions(axes, now, normals)
            _to_body(side, now, _DIRECTIONS)
            _to_body(side, normals, 2)
            for d in range(_DIRECTIONS):
                link = d // 2
                n_x, n_y, n_z = normals[link, 0], normals[link, 1], normals[link, 2]
                r_x = (now[d, 0] - before[which, d, 0]) * rate_hz
                r_y = (now[d, 1] - before[which, d, 1]) * rate_hz
                r_z = (now[d, 2] - before[which, d, 2]) * rate_hz
                for ring in range(_RINGS):
                    radius = _RING_M[ring]
                    force = plate_force(
                        radius * r_x + tow_m_s[n] - wake[which, 0],
                        radius * r_y - wake[which, 1],
                        radius * r_z - wake[which, 2],
                        n_x, n_y, n_z, _RING_M2[ring],
                    )  # fmt: skip
                    _add(
                        fin, force * n_x, force * n_y, force * n_z,
                        _ROOT_M[0] + radius * now[d, 0], side * _ROOT_M[1] + radius * now[d, 1],
                        _ROOT_M[2] + radius * now[d, 2],
                    )  # fmt: skip
            for d in range(_DIRECTIONS):
                for i in range(3):
                    before[which, d, i] = now[d, i]
            _take_along(wake, which, fin, tow_m_s[n], step_s)
            for i in range(6):
                loads[n, i] += fin[i]
            loads[n, 6] += math.sqrt(fin[0] ** 2 + fin[1] ** 2 + fin[2] ** 2)
        for i in range(6):
            fin[i] = 0.0
        _tail(joints[n, 4], tow_m_s[n], step_s, tail, wake, fin)
        _take_along(wake, 2, fin, tow_m_s[n], step_s)
        for i in range(6):
            loads[n, i] += fin[i]
        loads[n, 6] += math.sqrt(fin[0] ** 2 + fin[1] ** 2)


@kernel
def _take_along(wake: FloatArray, which: int, force: FloatArray, tow_m_s: float, step_s: float) -> None:
    """Let the water around a fin take up the reaction to its force, and come to rest over time."""
    rate = 1.0 / _WAKE_S + abs(tow_m_s) / _LEFT_BEHIND_M
    for i in range(3):
        wake[which, i] += step_s * (-force[i] / _ENTRAINED_KG - wake[which, i] * rate)


@kernel
def _tail(
    angle: float, tow_m_s: float, step_s: float, angles: FloatArray, wake: FloatArray, load: FloatArray
) -> None:
    """Add the load on the tail's two plates, and update their angles."""
    stem_before, tip_before = angles[0], angles[1]
    tip = angle + (tip_before - angle) * math.exp(-step_s / _TAIL_LAG_S)
    stem_rate, tip_rate = (angle - stem_before) / step_s, (tip - tip_before) / step_s
    angles[0], angles[1] = angle, tip
    area = _TAIL_PIECE_M * _TAIL_HEIGHT_M
    half = 0.5 * _TAIL_PIECE_M
    # Points backward at zero; a positive angle swings it to the right (turn about z).
    cosine, sine = math.cos(angle), math.sin(angle)
    u_x = half * sine * stem_rate + tow_m_s - wake[2, 0]
    u_y = -half * cosine * stem_rate - wake[2, 1]
    force = plate_force(u_x, u_y, 0.0, -sine, cosine, 0.0, area)
    _add(load, -force * sine, force * cosine, 0.0, _TAIL_ROOT_M - half * cosine, -half * sine, 0.0)
    tip_cosine, tip_sine = math.cos(tip), math.sin(tip)
    u_x = _TAIL_PIECE_M * sine * stem_rate + half * tip_sine * tip_rate + tow_m_s - wake[2, 0]
    u_y = -_TAIL_PIECE_M * cosine * stem_rate - half * tip_cosine * tip_rate - wake[2, 1]
    force = plate_force(u_x, u_y, 0.0, -tip_sine, tip_cosine, 0.0, area)
    x = _TAIL_ROOT_M - _TAIL_PIECE_M * cosine - half * tip_cosine
    y = -_TAIL_PIECE_M * sine - half * tip_sine
    _add(load, -force * tip_sine, force * tip_cosine, 0.0, x, y, 0.0)


def motion_at(joints: FloatArray) -> FloatArray:
    """Return the `motion` memory of fins at rest at these joint angles, shape (FIN_MEMORY,)."""
    motion = np.zeros(FIN_MEMORY)
    # One step that is longer than any lag.
    fin_loads(joints[None, :], np.zeros(1), 1e6, motion, np.zeros((3, 3)))
    motion[-1] = joints[4]
    return motion
