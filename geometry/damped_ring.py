r"""One sector of a ring of blades: a blade, and the wedge between it and the next one, under both platforms.

                    |  |                     The blade stands on the y axis, its foot on the hub; the origin lies on
                    |  |   airfoil           the engine's axis. The wedge lies on the ray half-way to the next blade,
             _______|  |_______              counter-clockwise, so that its sides are at equal angles to both.
     __     |                  |
    /  \ <----- near (flank within the sector: the wedge's side and the underside of its own blade's platform)
   / \  \    |                |
  /___\__\   |     shank      | <- far_blade (under the other half of the platform: the wedge of the sector before)
   ^         |                |
   far_wedge (the wedge's other side, for the next sector's far_blade)
             |________________|
               clamp (foot)

Physical groups: surfaces ``blade`` and ``wedge``; curves ``near``, ``far_wedge``, ``far_blade``, ``clamp``, ``tip``. A
scene joins the sectors by ``[cyclic]`` ``flanks = { far = ["far_wedge", "far_blade"] }``, without cuts. Lengths in m.
"""

from __future__ import annotations

from itertools import pairwise
from math import cos, pi, radians, sin, tan

from blocks import Body, Point, check_angle, check_pairs, check_positive, check_sectors, mesh_bodies
from outlines import count_cells


def build(
    *,
    sectors: int = 30,
    hub_radius: float = 150.0e-3,
    flank_angle: float = 53.0,
    wedge_width: float = 20.0e-3,
    wedge_height: float = 8.0e-3,
    shank_height: float = 40.0e-3,
    platform_thickness: float = 4.0e-3,
    airfoil_height: float = 80.0e-3,
    airfoil_thickness: float = 6.0e-3,
    pairs: int = 8,
    mesh_size: float = 2.0e-3,
) -> None:
    """Add a blade and its wedge to the current gmsh model, mesh them and name their groups.

    Args:
        sectors: Number of blades in the ring.
        hub_radius: Of the feet [m].
        flank_angle: Angle of the wedge's sides from its lower side [degrees].
        wedge_width: Of the wedge's lower side, which is the distance between the shanks [m].
        wedge_height: Of the wedge [m].
        shank_height: From the foot to the wedge's lower side [m].
        platform_thickness: Of the platform above the wedge [m].
        airfoil_height: From the platform to the tip [m].
        airfoil_thickness: Of the airfoil [m].
        pairs: Nodes on each side of each flank, ends included.
        mesh_size: Size of the cells away from the flanks [m].

    Raises:
        ValueError: A parameter has the wrong sign, or the pieces do not fit together; names the parameter.
    """
    check_positive(locals())
    check_angle("flank_angle", flank_angle)
    check_pairs(pairs)
    check_sectors(sectors)
    wide = wedge_width / 2
    narrow = wide - wedge_height / tan(radians(flank_angle))
    if narrow <= 0:
        raise ValueError(
            f"wedge_height = {wedge_height}: expected less than {wide * tan(radians(flank_angle)):.5g}, where the "
            "flanks meet"
        )
    half_angle = pi / sectors
    levels = [hub_radius, hub_radius + shank_height]
    levels += [levels[1] + wedge_height, levels[1] + wedge_height + platform_thickness]
    edges = [wide, wide, narrow, narrow]  # of the shank and the platform, from the ray half-way to the next blade
    foot = hub_radius * sin(half_angle) - wide * cos(half_angle)
    if foot <= airfoil_thickness / 2:
        raise ValueError(
            f"hub_radius = {hub_radius}: {sectors} shanks with {wedge_width:g} m between them are {2 * foot:.3g} m "
            f"thick there, expected more than the airfoil's {airfoil_thickness}; take fewer sectors or a narrower wedge"
        )

    def beside(level: float, across: float, side: int = -1) -> Point:
        """A point by its way along a ray half-way to a neighbour, and from there towards the blade on the y axis."""
        x, y = across * cos(half_angle) - level * sin(half_angle), level * cos(half_angle) + across * sin(half_angle)
        return (-side * x, y)

    rows = [count_cells(above - below, mesh_size) for below, above in pairwise(levels)]
    rows[1] = pairs - 1
    outer, inner = count_cells(foot - airfoil_thickness / 2, mesh_size), count_cells(airfoil_thickness / 2, mesh_size)
    blade, wedge = Body("blade"), Body("wedge")
    curves: dict[str, list[int]] = {"clamp": [], "tip": []}
    for side, flank in ((-1, "near"), (1, "far_blade")):
        lines = [
            [beside(level, edge, side), (side * airfoil_thickness / 2, level), (0.0, level)]
            for level, edge in zip(levels, edges, strict=True)
        ]
        for row, (lower, upper) in enumerate(pairwise(lines)):
            for column, cells in enumerate((outer, inner)):
                corners = [upper[column], lower[column], lower[column + 1], upper[column + 1]]
                edge, bottom, *_ = blade.patch(corners, (rows[row], cells))
                if row == 0:
                    curves["clamp"].append(bottom)
                if (row, column) == (1, 0):
                    curves[flank] = [edge]
        root, top = levels[-1], levels[-1] + airfoil_height
        x = side * airfoil_thickness / 2
        corners = [(x, top), (x, root), (0.0, root), (0.0, top)]
        *_, tip = blade.patch(corners, (count_cells(airfoil_height, mesh_size), inner))
        curves["tip"].append(tip)
    corners = [beside(levels[2], -narrow), beside(levels[1], -wide), beside(levels[1], wide), beside(levels[2], narrow)]
    far, _, near, _ = wedge.patch(corners, (pairs - 1, count_cells(wedge_width, mesh_size)))
    curves["near"].append(near)
    mesh_bodies((blade, wedge), {**curves, "far_wedge": [far]})
