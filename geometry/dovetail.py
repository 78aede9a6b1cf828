"""A bladed-disk sector whose blade hangs in the disk by a dovetail: one straight flank on each side.

The directions and the names are those of ``fir_tree.py``. The disk is a straight block, and the blade a prism with a
trapezoidal foot. Coordinates in m; ``y`` points outwards, ``y = 0`` is the top of the disk.

                |    |  blade
        ________|____|________  y = 0
        |   disk \\    / disk  |
        |    left /    \\ right|      <- the flanks, on the lower part of the slot's walls
        |       /______\\     |
        |____________________|

Physical groups: surfaces ``blade`` and ``disk``; curves ``left`` and ``right`` (the flanks, curves of both bodies),
``clamp`` (bottom and both sides of the disk) and ``tip``.
"""

from __future__ import annotations

from math import cos, radians, sin, tan

from blocks import Body, check_angle, check_pairs, check_positive, mesh_bodies, mirror
from outlines import count_cells


def build(
    *,
    flank_angle: float = 50.0,
    flank_length: float = 8.0e-3,
    neck_width: float = 12.0e-3,
    neck_height: float = 4.0e-3,
    clearance: float = 0.4e-3,
    blade_height: float = 70.0e-3,
    blade_thickness: float = 8.0e-3,
    disk_width: float = 40.0e-3,
    disk_height: float = 30.0e-3,
    pairs: int = 8,
    mesh_size: float = 2.0e-3,
) -> None:
    """Add the sector to the current gmsh model, mesh it and name its groups.

    Args:
        flank_angle: Angle of the flanks from the x direction [degrees].
        flank_length: Length of each flank [m].
        neck_width: Width of the blade at the upper end of the flanks [m].
        neck_height: From the top of the disk down to the flanks [m].
        clearance: Gap beside the neck and below the root [m].
        blade_height: From the top of the disk to the tip [m].
        blade_thickness: Thickness at the tip [m].
        disk_width: Width of the sector [m].
        disk_height: Height of the disk [m].
        pairs: Nodes on each side of each flank, ends included.
        mesh_size: Size of the cells away from the flanks [m].

    Raises:
        ValueError: A parameter has the wrong sign, or the root does not fit into the disk; names the parameter.
    """
    check_positive(locals())
    check_angle("flank_angle", flank_angle)
    check_pairs(pairs)
    neck, tip, edge = neck_width / 2, blade_thickness / 2, disk_width / 2
    foot = neck + flank_length * cos(radians(flank_angle))
    bottom = -neck_height - flank_length * sin(radians(flank_angle))
    beyond = clearance / tan(radians(flank_angle))  # the slot's wall goes on below the root in the flank's direction
    if foot + beyond >= edge:
        raise ValueError(f"disk_width = {disk_width}: expected more than {2 * (foot + beyond):.5g}, the slot's width")
    if bottom - clearance <= -disk_height:
        raise ValueError(f"disk_height = {disk_height}: expected more than {clearance - bottom:.5g}, the slot's depth")
    across, aside, contact = count_cells(neck, mesh_size), count_cells(edge - foot, mesh_size), pairs - 1
    shank, below_root = count_cells(neck_height, mesh_size), count_cells(disk_height + bottom, mesh_size)
    # Rows of blocks, downwards: the outline's upper and lower point, and the cells between them.
    blade = [
        ((tip, blade_height), (neck, 0.0), count_cells(blade_height, mesh_size)),
        ((neck, 0.0), (neck, -neck_height), shank),
        ((neck, -neck_height), (foot, bottom), contact),
    ]
    disk = [
        ((neck + clearance, 0.0), (neck, -neck_height), shank),
        ((neck, -neck_height), (foot, bottom), contact),
        ((foot, bottom), (foot + beyond, bottom - clearance), 1),
        ((foot + beyond, bottom - clearance), (foot + beyond, -disk_height), below_root),
    ]
    curves: dict[str, list[int]] = {"left": [], "right": [], "clamp": [], "tip": []}
    bodies = Body("blade"), Body("disk")
    for body, rows, far, columns in zip(bodies, (blade, disk), (0.0, edge), (across, aside), strict=True):
        for side, hand in ((-1, "left"), (1, "right")):
            for upper, lower, cells in rows:
                corners = [upper, lower, (far, lower[1]), (far, upper[1])]
                outline, _, opposite, top = body.patch(mirror(corners, side), (cells, columns))
                if upper == (neck, -neck_height):
                    curves[hand].append(outline)
                if upper == (tip, blade_height):
                    curves["tip"].append(top)
                if body.name == "disk":
                    curves["clamp"].append(opposite)
            if body.name == "disk":
                aside_of_bottom = body.curve((side * lower[0], lower[1]), (side * far, lower[1]), columns)
                below = [(0.0, bottom - clearance), (0.0, -disk_height), lower, upper]
                curves["clamp"] += [aside_of_bottom, body.patch(mirror(below, side), (cells, across))[1]]
    mesh_bodies(bodies, curves)
