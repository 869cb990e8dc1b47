"""Force of water on flat plates and thin struts that move through it.

Eq. (7.11) of the source work: ``F = rho u^2 A sin(alpha)``, normal to the plate, with u the speed of the plate
relative to the water and alpha its angle of attack. Its components along and across the flow are the drag (7.9)
and the lift (7.10). With the sign written out for motion that goes to and fro, and as a vector, it is
``F = -rho A |u| (u . n) n``, whichever way the normal n points.

A plate edge-on has a drag, too, which (7.11) leaves out: that of its edges and its two faces,
``F = -1/2 rho C A |u| (u - (u . n) n)``. And what holds a fin is struts: their drag is that of the flow across
them, ``F = -1/2 rho C d l |u - (u . s) s| (u - (u . s) s)`` for a strut along s (Hoerner, Fluid-Dynamic Drag
(1965), chapter 3: circular cylinders, and the principle of cross-flow).
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
