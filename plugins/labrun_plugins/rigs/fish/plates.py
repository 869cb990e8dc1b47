"""Force of water on flat plates that move through it.

Eq. (7.11) of the source work: ``F = rho u^2 A sin(alpha)``, normal to the plate, with u the speed of the plate
relative to the water and alpha its angle of attack. Its components along and across the flow are the drag (7.9)
and the lift (7.10). With the sign written out for motion that goes to and fro, and as a vector, it is
``F = -rho A |u| (u . n) n``, whichever way the normal n points.
"""

from labrun.models import kernel

WATER_KG_M3 = 1000.0


@kernel
def plate_force(
    u_x: float, u_y: float, u_z: float, n_x: float, n_y: float, n_z: float, area_m2: float
) -> float:
    """Return the force along the unit normal n, N, on a plate that moves through water at velocity u, m/s."""
    speed: float = (u_x * u_x + u_y * u_y + u_z * u_z) ** 0.5
    return -WATER_KG_M3 * area_m2 * speed * (u_x * n_x + u_y * n_y + u_z * n_z)
