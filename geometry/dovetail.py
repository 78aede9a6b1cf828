"""A bladed-disk sector whose blade hangs in the disk by a dovetail: one straight flank on each side.

The coordinates and the names are those of ``fir_tree.py``; nothing else is shared. The disk is a straight block, and
the blade a prism with a trapezoidal foot. Coordinates in m; ``y`` points outwards, ``y = 0`` is the top of the disk.

                |    |  blade
        ________|____|________  y = 0
        |   disk \\    / disk  |
        |   right /    \\      |      <- the flank, on the lower part of the slot's wall
        |       /______\\     |
        |____________________|

Physical groups: surfaces ``blade`` and ``disk``; curves ``left`` and ``right`` (the flanks, curves of both bodies),
``clamp`` (bottom and both sides of the disk) and ``tip``.
"""

from __future__ import annotations

from math import cos, radians, sin, tan

import gmsh

Point = tuple[float, float]


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
    for name, value in dict(locals()).items():
        if not value > 0:
            raise ValueError(f"{name} = {value}: expected a positive number")
    if not 15.0 <= flank_angle <= 75.0:
        raise ValueError(f"flank_angle = {flank_angle}: expected degrees from the x direction, 15 to 75")
    if pairs < 2:
        raise ValueError(f"pairs = {pairs}: expected at least 2, the ends of the flank")
    neck, tip, edge = neck_width / 2, blade_thickness / 2, disk_width / 2
    foot = neck + flank_length * cos(radians(flank_angle))
    bottom = -neck_height - flank_length * sin(radians(flank_angle))
    beyond = clearance / tan(radians(flank_angle))  # the slot's wall goes on below the root in the flank's direction
    if foot + beyond >= edge:
        raise ValueError(f"disk_width = {disk_width}: expected more than {2 * (foot + beyond):.5g}, the slot's width")
    if bottom - clearance <= -disk_height:
        raise ValueError(f"disk_height = {disk_height}: expected more than {clearance - bottom:.5g}, the slot's depth")
    count = lambda length: max(1, round(length / mesh_size))  # noqa: E731
    across, aside, contact = count(neck), count(edge - foot), pairs - 1
    # Rows of blocks, downwards: the outline's upper and lower point, and the cells between them.
    blade = [
        ((tip, blade_height), (neck, 0.0), count(blade_height)),
        ((neck, 0.0), (neck, -neck_height), count(neck_height)),
        ((neck, -neck_height), (foot, bottom), contact),
    ]
    disk = [
        ((neck + clearance, 0.0), (neck, -neck_height), count(neck_height)),
        ((neck, -neck_height), (foot, bottom), contact),
        ((foot, bottom), (foot + beyond, bottom - clearance), 1),
        ((foot + beyond, bottom - clearance), (foot + beyond, -disk_height), count(disk_height + bottom)),
    ]
    surfaces: dict[str, list[int]] = {"blade": [], "disk": []}
    curves: dict[str, list[int]] = {"left": [], "right": [], "clamp": [], "tip": []}
    for body, rows, columns in (("blade", blade, across), ("disk", disk, aside)):
        drawn: dict[object, int] = {}
        far = 0.0 if body == "blade" else edge
        for side, hand in ((-1, "left"), (1, "right")):
            for upper, lower, cells in rows:
                corners = [(side * x, y) for x, y in (upper, lower, (far, lower[1]), (far, upper[1]))]
                surface, sides = _draw_block(corners, (cells, columns, cells, columns), drawn)
                surfaces[body].append(surface)
                if upper == (neck, -neck_height):
                    curves[hand].append(sides[0])
                if body == "disk":
                    curves["clamp"].append(sides[2])
            if body == "blade":
                curves["tip"].append(abs(drawn[(side * tip, blade_height), (0.0, blade_height)]))
            else:
                curves["clamp"].append(sides[1])
                below = [(0.0, bottom - clearance), (0.0, -disk_height), (side * lower[0], lower[1]),
                         (side * upper[0], upper[1])]
                surface, sides = _draw_block(below, (cells, across, cells, across), drawn)
                surfaces[body].append(surface)
                curves["clamp"].append(sides[1])

    gmsh.model.geo.synchronize()
    for dimension, groups in ((2, surfaces), (1, curves)):
        for name, members in groups.items():
            gmsh.model.setPhysicalName(dimension, gmsh.model.addPhysicalGroup(dimension, members), name)
    gmsh.model.mesh.generate(2)


def _draw_block(corners: list[Point], cells: tuple[int, ...], drawn: dict[object, int]) -> tuple[int, list[int]]:
    """A transfinite block of quadrilaterals; ``drawn`` holds the body's points and curves, shared by its blocks.

    Returns:
        Tags of the surface and of its four curves, the first from corner 0 to corner 1.
    """
    geo = gmsh.model.geo
    corners = [(x + 0.0, y) for x, y in corners]  # no negative zero: the axis belongs to both sides
    for corner in corners:
        if corner not in drawn:
            drawn[corner] = geo.addPoint(*corner, 0.0)
    sides, loop = [], []
    for start, end, number in zip(corners, corners[1:] + corners[:1], cells):
        if (start, end) not in drawn:
            tag = geo.addLine(drawn[start], drawn[end])
            geo.mesh.setTransfiniteCurve(tag, number + 1)
            drawn[start, end], drawn[end, start] = tag, -tag
        loop.append(drawn[start, end])
        sides.append(abs(drawn[start, end]))
    clockwise = sum(a[0] * b[1] - b[0] * a[1] for a, b in zip(corners, corners[1:] + corners[:1])) < 0
    surface = geo.addPlaneSurface([geo.addCurveLoop([-tag for tag in loop[::-1]] if clockwise else loop)])
    geo.mesh.setTransfiniteSurface(surface, cornerTags=[drawn[corner] for corner in corners])
    geo.mesh.setRecombine(2, surface)
    return surface, sides
