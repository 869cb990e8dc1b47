"""Motion of a body with two fins on buckling hinges, in the plane: what every rig with such fins is made of.

A servo on the body prescribes the angle ``theta`` of a rigid link (length ``d1``) from the body's side, positive to the
front; a hinge bends by ``q``; on it sits a plate whose middle is ``r`` away. With ``phi = theta + q``, less the body's
yaw, along and square to the plate are ``t = (sin phi, s cos phi)`` and ``n = (cos phi, -s sin phi)``, where s is +1 for
the left and -1 for the right fin (section 7.3 of the source work):

    V = d/dt (shoulder + d1 t(theta) + r t(phi))                     of the plate's middle
    F = -rho A |V| (V . n)                                           flat plate, (7.11)
    m r (V' . n) = F r - S(q) - c q'                                 hinge
    S(q) = k q between -M_eq and +M_opp, on the slope k_b beyond     curved beam, sections 7.2 and 7.3

and of the body ``m_B v' + sum(m V') = sum(F n) - rho A_B v |v| + mount``, likewise about its yaw. The mass of a plate
is at its middle; links have no mass, and no drag. Of V' what is along n is known from the hinge, so that only three
unknowns are left, the body's accelerations.

Numbers stand in `p` in the order of `PARAMETERS`.
"""

import math
from typing import Any

from labrun.models import Parameter, kernel

PARAMETERS: tuple[Parameter, ...] = (
    Parameter("stiffness", 0.506, 0.05, "N m/rad", lower=1e-3),
    Parameter("equal_limit", 0.1063, 0.05, "N m", lower=0.0),
    Parameter("opposite_limit", 0.76, 0.05, "N m", lower=0.0),
    Parameter("buckled_stiffness", 0.0152, 0.1, "N m/rad", lower=0.0),
    Parameter("damping", 0.0065, 0.1, "N m s/rad", lower=0.0),
    Parameter("plate_mass", 0.020, 0.05, "kg", lower=1e-4),
    Parameter("added_mass", 0.0045, 0.1, "kg", lower=0.0),
    Parameter("plate_area", 0.080 * 0.0669, 0.02, "m^2", lower=0.0),
    Parameter("link", 0.1232, 0.01, "m", lower=0.0),
    Parameter("arm", 0.0790 + 0.5 * 0.0669, 0.01, "m", lower=1e-3),
    Parameter("density", 1000.0, 0.0, "kg/m^3"),
    Parameter("servo_frequency", 6.0, 0.05, "Hz", lower=0.5),
    Parameter("servo_damping", 0.8, 0.1, "1", lower=0.1),
    Parameter("body_mass", 1.0, 0.05, "kg", lower=0.0),
    Parameter("body_area", 2e-6, 0.05, "m^2", lower=0.0),
    Parameter("motor_spacing", 0.040, 0.01, "m", lower=0.0),
    Parameter("body_inertia", 5e-3, 0.05, "kg m^2", lower=0.0),
    Parameter("body_side_area", 0.0, 0.05, "m^2", lower=0.0),
    Parameter("yaw_drag", 0.0, 0.1, "N m s^2", lower=0.0),
    Parameter("mount_stiffness", 0.0, 0.05, "N/m", lower=0.0),
    Parameter("mount_damping", 0.0, 0.1, "N s/m", lower=0.0),
    Parameter("yaw_stiffness", 0.0, 0.05, "N m/rad", lower=0.0),
    Parameter("yaw_damping", 0.0, 0.1, "N m s/rad", lower=0.0),
)
"""Of the wing in water (section 7.6) and a body of 1 kg. Width of the fin and limits of the hinge (section 7.5.1: 0.1
and 0.76 N m, the first a little higher here) are the source's; the rest is chosen, since the source has it in figures
or not at all."""

FREE_X, FREE_Y, FREE_YAW, FINS = (len(PARAMETERS) + i for i in range(4))
"""Where in `p`, behind the parameters, stands which ways the body is free (1 or 0), and how many fins it has."""

STATES = (
    "x", "y", "yaw", "speed", "side_speed", "yaw_rate",
    "base_1", "base_rate_1", "bend_1", "bend_rate_1", "base_2", "base_rate_2", "bend_2", "bend_rate_2",
)  # fmt: skip


@kernel
def hinge_torque(bend: float, p: Any) -> float:
    """Return what a hinge pulls its plate back with, N m: straight between its two limits, softer beyond either.

    A negative bend is in equal sense, where the curved beam buckles early.
    """
    straight = min(max(bend, -p[1] / p[0]), p[2] / p[0])
    return float(p[0] * straight + p[3] * (bend - straight))


@kernel
def fin(side: float, start: int, goal_rad: float, x: Any, p: Any, at_hinge: float, at_plate: float) -> Any:
    """Return what one fin does to the body, as numbers that are linear in the body's accelerations.

    Parameters
    ----------
    side
        +1 left, -1 right.
    start
        Where in `x` the fin's four states begin: angle and rate of the base, bend and its rate.
    goal_rad
        Angle that the servo follows, rad.
    at_hinge, at_plate
        Further torque at the hinge (N m), further force along n (N).

    Returns
    -------
    nx, ny, ng
        How the normal of the plate moves with the body's x, y and yaw; likewise tx, ty, tg along the plate.
    hinge
        Force that the hinge passes on to the plate along n, times -1, with the water's already in it: m (V' . n), N.
    water
        Force of the water along n, N.
    along, across
        V' along t and n without the body's accelerations, m/s^2.
    base_acceleration
        rad/s^2.
    lever_n, lever_t
        By which forces along n and t turn the base, m.
    speed
        V . n, m/s.
    """
    mass, d1, r = p[5] + p[6], p[8], p[9]
    base, base_rate = x[start], x[start + 1]
    bend, bend_rate = x[start + 2], x[start + 3]
    natural = 2.0 * math.pi * p[11]
    base_acceleration = natural * natural * (goal_rad - base) - 2.0 * p[12] * natural * base_rate
    yaw, yaw_rate = x[2], x[5]
    half = 0.5 * side * p[15]
    theta, phi = base - side * yaw, base + bend - side * yaw
    theta_rate, phi_rate = base_rate - side * yaw_rate, base_rate + bend_rate - side * yaw_rate
    link_tx, link_ty = math.sin(theta), side * math.cos(theta)
    link_nx, link_ny = math.cos(theta), -side * math.sin(theta)
    tx, ty = math.sin(phi), side * math.cos(phi)
    nx, ny = math.cos(phi), -side * math.sin(phi)
    front_x, front_y = math.cos(yaw), math.sin(yaw)
    vx = x[3] - half * yaw_rate * front_x + d1 * theta_rate * link_nx + r * phi_rate * nx
    vy = x[4] - half * yaw_rate * front_y + d1 * theta_rate * link_ny + r * phi_rate * ny
    speed = vx * nx + vy * ny
    water = -p[10] * p[7] * math.sqrt(vx * vx + vy * vy) * speed + at_plate
    hinge = water - (hinge_torque(bend, p) + p[4] * bend_rate - at_hinge) / r
    ax = (
        half * yaw_rate * yaw_rate * front_y
        + d1 * (base_acceleration * link_nx - theta_rate * theta_rate * link_tx)
        + r * (base_acceleration * nx - phi_rate * phi_rate * tx)
    )
    ay = (
        -half * yaw_rate * yaw_rate * front_x
        + d1 * (base_acceleration * link_ny - theta_rate * theta_rate * link_ty)
        + r * (base_acceleration * ny - phi_rate * phi_rate * ty)
    )
    gx = -half * front_x - side * (d1 * link_nx + r * nx)
    gy = -half * front_y - side * (d1 * link_ny + r * ny)
    ng, tg = gx * nx + gy * ny, gx * tx + gy * ty
    along, across = ax * tx + ay * ty, ax * nx + ay * ny
    lever_n = d1 * (link_nx * nx + link_ny * ny) + r
    lever_t = d1 * (link_nx * tx + link_ny * ty)
    return (
        nx, ny, ng, tx, ty, tg, hinge, water, along, across, base_acceleration, lever_n, lever_t, speed, mass,
    )  # fmt: skip


@kernel
def plate_speed(base: float, base_rate: float, bend: float, bend_rate: float, speed: float, p: Any) -> float:
    """Return how fast a plate moves along its normal while its body goes ahead without turning, m/s."""
    phi = base + bend
    return float(speed * math.cos(phi) + p[8] * base_rate * math.cos(bend) + p[9] * (base_rate + bend_rate))


@kernel
def motion(x: Any, u: Any, p: Any, force: Any) -> Any:
    """Return accelerations of the body, what it does to its mount, both fins, and both bends' accelerations.

    `u` is what the two servos are told (rad); `force` stands at hinge 1, hinge 2, plate 1, plate 2 and the body.

    Returns
    -------
    (x'', y'', yaw''), (force x, force y, torque z on the mount), fin 1, fin 2, bend 1'', bend 2''
        Of a way in which the body is free the mount feels its spring and its damper.
    """
    left = fin(1.0, 6, u[0], x, p, force[0], force[2])
    right = fin(-1.0, 10, u[1], x, p, force[1], force[3])
    two = 1.0 if p[26] > 1.5 else 0.0
    mount_x = p[19] * x[0] + p[20] * x[3]
    mount_y = p[19] * x[1] + p[20] * x[4]
    mount_z = p[21] * x[2] + p[22] * x[5]
    mass_l, mass_r = left[14], two * right[14]
    # body, and plates that move with it along themselves only
    mxx = p[13] + mass_l * left[3] * left[3] + mass_r * right[3] * right[3]
    mxy = mass_l * left[3] * left[4] + mass_r * right[3] * right[4]
    mxz = mass_l * left[3] * left[5] + mass_r * right[3] * right[5]
    myy = p[13] + mass_l * left[4] * left[4] + mass_r * right[4] * right[4]
    myz = mass_l * left[4] * left[5] + mass_r * right[4] * right[5]
    mzz = p[16] + mass_l * left[5] * left[5] + mass_r * right[5] * right[5]
    push_l, push_r = left[7] - left[6], two * (right[7] - right[6])
    pull_l, pull_r = mass_l * left[8], mass_r * right[8]
    front_x, front_y = math.cos(x[2]), math.sin(x[2])
    ahead, aside = front_x * x[3] + front_y * x[4], front_x * x[4] - front_y * x[3]
    drag = -p[10] * p[14] * ahead * abs(ahead) + force[4]
    side_drag = -p[10] * p[17] * aside * abs(aside)
    fx = push_l * left[0] + push_r * right[0] - pull_l * left[3] - pull_r * right[3]
    fx += front_x * drag - front_y * side_drag
    fy = push_l * left[1] + push_r * right[1] - pull_l * left[4] - pull_r * right[4]
    fy += front_y * drag + front_x * side_drag
    fz = push_l * left[2] + push_r * right[2] - pull_l * left[5] - pull_r * right[5]
    fz -= p[18] * x[5] * abs(x[5])
    free_x, free_y, free_z = p[23] > 0.5, p[24] > 0.5, p[25] > 0.5
    ax, ay, az = _solved(
        mxx, mxy, mxz, myy, myz, mzz, fx - mount_x, fy - mount_y, fz - mount_z, free_x, free_y, free_z
    )
    held_x = mount_x if free_x else fx - mxy * ay - mxz * az
    held_y = mount_y if free_y else fy - mxy * ax - myz * az
    held_z = mount_z if free_z else fz - mxz * ax - myz * ay
    bend_l = (left[6] / left[14] - left[9] - left[0] * ax - left[1] * ay - left[2] * az) / p[9]
    bend_r = (right[6] / right[14] - right[9] - right[0] * ax - right[1] * ay - right[2] * az) / p[9]
    return (ax, ay, az), (held_x, held_y, held_z), left, right, bend_l, bend_r


@kernel
def _solved(
    mxx: float, mxy: float, mxz: float, myy: float, myz: float, mzz: float,
    fx: float, fy: float, fz: float, free_x: bool, free_y: bool, free_z: bool,
) -> Any:  # fmt: skip
    """Return the accelerations that three forces give a symmetric matrix of masses; none where it is not free."""
    if not free_x:
        mxx, mxy, mxz, fx = 1.0, 0.0, 0.0, 0.0
    if not free_y:
        myy, mxy, myz, fy = 1.0, 0.0, 0.0, 0.0
    if not free_z:
        mzz, mxz, myz, fz = 1.0, 0.0, 0.0, 0.0
    determinant = myy * mzz - myz * myz
    two = mxz * myz - mxy * mzz
    three = mxy * myz - mxz * myy
    whole = mxx * determinant + mxy * two + mxz * three
    ax = (determinant * fx + two * fy + three * fz) / whole
    ay = (two * fx + (mxx * mzz - mxz * mxz) * fy + (mxy * mxz - mxx * myz) * fz) / whole
    az = (three * fx + (mxy * mxz - mxx * myz) * fy + (mxx * myy - mxy * mxy) * fz) / whole
    return ax, ay, az


@kernel
def base_torque(wing: Any, body: Any) -> float:
    """Return what the servo turns its fin with, N m, positive towards the front, given the body's accelerations."""
    along = wing[8] + wing[3] * body[0] + wing[4] * body[1] + wing[5] * body[2]
    return float((wing[6] - wing[7]) * wing[11] + wing[14] * along * wing[12])
