r"""One sector of a ring of shrouded blades: each blade's shroud presses on those of its neighbours.

      behind \____________________________\ ahead (flank towards the next sector, counter-clockwise)
              \_________shroud_____________\
                          |  |
                          |  |   airfoil       The blade stands on the y axis; the origin lies on the engine's axis.
                          |  |                 Sectors follow one another counter-clockwise, to the left: here they are
                          |  |                 drawn the other way round.
                          clamp (foot)

Physical groups: surface ``blade``; curves ``ahead``, ``behind``, ``clamp``, ``tip``. A scene joins the sectors by
``[cyclic]`` ``flanks = { shroud = ["ahead", "behind"] }``, without cuts; shrouds press where their ``initial_gap`` is
negative. Lengths in m.
"""

from __future__ import annotations

from math import cos, hypot, pi, radians, sin

from blocks import Body, Point, check_angle, check_pairs, check_positive, check_sectors, mesh_bodies
from outlines import count_cells


def build(
    *,
    sectors: int = 30,
    hub_radius: float = 150.0e-3,
    airfoil_height: float = 80.0e-3,
    airfoil_thickness: float = 6.0e-3,
    shroud_thickness: float = 6.0e-3,
    face_angle: float = 40.0,
    pairs: int = 8,
    mesh_size: float = 2.0e-3,
) -> None:
    """Add a blade with its shroud to the current gmsh model, mesh it and name its groups.

    Args:
        sectors: Number of blades in the ring.
        hub_radius: Of the feet [m].
        airfoil_height: From the foot to the shroud [m].
        airfoil_thickness: Of the airfoil [m].
        shroud_thickness: In the direction of the radius [m].
        face_angle: Angle of the shroud's end faces from the ray half-way to the next blade [degrees].
        pairs: Nodes on each side of a flank, ends included.
        mesh_size: Size of the cells away from the flanks [m].

    Raises:
        ValueError: A parameter has the wrong sign, or the pieces do not fit together; names the parameter.
    """
    check_positive(locals())
    check_angle("face_angle", face_angle)
    check_pairs(pairs)
    check_sectors(sectors)
    half_angle, edge = pi / sectors, airfoil_thickness / 2
    root, under, over = hub_radius, hub_radius + airfoil_height, hub_radius + airfoil_height + shroud_thickness
    middle, reach = (under + over) / 2 / cos(half_angle), shroud_thickness / 2 / cos(radians(face_angle))

    def end(side: int, way: int) -> Point:
        """Where the face towards a neighbour (1: the next one) ends: at its lower (-1) or upper (1) side."""
        ray, face = side * half_angle, side * half_angle + radians(face_angle)
        return (-middle * sin(ray) - way * reach * sin(face), middle * cos(ray) + way * reach * cos(face))

    room = min(side * -end(side, way)[0] for side in (1, -1) for way in (1, -1))
    if room <= edge:
        raise ValueError(
            f"face_angle = {face_angle}: with {sectors} sectors faces reach within {room:.3g} m of the blade's middle, "
            f"expected more than half the airfoil's thickness, {edge:g}; take fewer sectors or a smaller angle"
        )
    blade, faces = Body("blade"), {}
    up, across = count_cells(airfoil_height, mesh_size), count_cells(airfoil_thickness, mesh_size)
    *_, foot = blade.patch([(edge, root), (edge, under), (-edge, under), (-edge, root)], (up, across))
    corners = [(edge, under), (edge, over), (-edge, over), (-edge, under)]
    _, tip, *_ = blade.patch(corners, (pairs - 1, across))
    for side in (1, -1):
        lower, upper = end(side, -1), end(side, 1)
        wide = count_cells(hypot(lower[0] + side * edge, lower[1] - under), mesh_size)
        corners = [lower, upper, (-side * edge, over), (-side * edge, under)]
        faces[side], *_ = blade.patch(corners, (pairs - 1, wide))
    mesh_bodies([blade], {"ahead": [faces[1]], "behind": [faces[-1]], "clamp": [foot], "tip": [tip]})
