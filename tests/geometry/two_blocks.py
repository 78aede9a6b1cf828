"""Two stacked rectangular blocks with one straight joint: the smallest model that has everything the chain needs.

The blade stands on the disk; a force towards the disk closes the joint. The nodes of the two sides coincide and are
distinct, unless the blocks are welded.
"""

from __future__ import annotations

import math

import gmsh


def build(
    *,
    width: float = 0.04,
    blade_height: float = 0.06,
    disk_height: float = 0.03,
    columns: int = 6,
    disk_columns: int | None = None,
    blade_rows: int = 8,
    disk_rows: int = 4,
    inclination: float = 0.0,
    shift: float = 0.0,
    skew: float = 0.0,
    quadrilaterals: bool = True,
    welded: bool = False,
) -> None:
    """Adds the blocks, their mesh and the groups blade, disk, joint, clamp and tip to the current gmsh model.

    Args:
        width: Of both blocks [m].
        blade_height: Of the upper block [m].
        disk_height: Of the lower block [m].
        columns: Elements along the joint on the blade's side.
        disk_columns: Elements along the joint on the disk's side; None: as many as the blade.
        blade_rows: Elements over the blade's height.
        disk_rows: Elements over the disk's height.
        inclination: The whole model is turned by this angle, counter-clockwise [degree].
        shift: Distance between the two sides of the joint [m].
        skew: Sideways offset of the blade's upper edge [m]: elements that are no rectangles.
        quadrilaterals: Or triangles.
        welded: Whether the two sides share their nodes.
    """
    angle = math.radians(inclination)

    def point(x: float, y: float) -> int:
        return gmsh.model.geo.addPoint(
            x * math.cos(angle) - y * math.sin(angle), x * math.sin(angle) + y * math.cos(angle), 0.0
        )

    def block(bottom: float, top: float, offset: float, columns: int, rows: int) -> tuple[int, list[int]]:
        points = [point(0, bottom), point(width, bottom), point(width + offset, top), point(offset, top)]
        lines = [gmsh.model.geo.addLine(points[k], points[(k + 1) % 4]) for k in range(4)]
        surface = gmsh.model.geo.addPlaneSurface([gmsh.model.geo.addCurveLoop(lines)])
        for line, count in zip(lines, (columns, rows, columns, rows), strict=True):
            gmsh.model.geo.mesh.setTransfiniteCurve(line, count + 1)
        gmsh.model.geo.mesh.setTransfiniteSurface(surface)
        if quadrilaterals:
            gmsh.model.geo.mesh.setRecombine(2, surface)
        return surface, lines

    disk, disk_lines = block(0.0, disk_height, 0.0, disk_columns or columns, disk_rows)
    joint = disk_height + shift
    blade, blade_lines = block(joint, joint + blade_height, skew, columns, blade_rows)
    gmsh.model.geo.synchronize()
    for name, dimension, entities in (
        ("blade", 2, [blade]),
        ("disk", 2, [disk]),
        ("joint", 1, [blade_lines[0], disk_lines[2]]),
        ("clamp", 1, [disk_lines[0]]),
        ("tip", 1, [blade_lines[2]]),
    ):
        group = gmsh.model.addPhysicalGroup(dimension, entities)
        gmsh.model.setPhysicalName(dimension, group, name)
    gmsh.model.mesh.generate(2)
    if welded:
        gmsh.model.mesh.removeDuplicateNodes()
        gmsh.model.mesh.renumberNodes()  # dolfinx wants node tags without holes
