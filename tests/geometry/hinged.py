"""A blade on a disk, that go on to a corner beside their flank: the same point of both, or one of each.

On the corner may hang a flap, a square to the left of it, which is of the blade as well.

  ________________
 |                |
 |     blade      |
 |____ ___________|
s|  _- |   joint  |     <- the corner s; below the blade the disk ends in a spike up to there
 |_-   |__________|
 |      disk      |
 |________________|
"""

from __future__ import annotations

import gmsh

WIDTH, HEIGHT, DEPTH, FREE = 0.04, 0.06, 0.03, 0.01  # of the blade, its height, that of the disk, and left of the joint


def build(*, share: bool = True, flap: bool = False) -> None:
    """Adds both, their mesh and the groups blade, disk, joint, tip, side and clamp to the current gmsh model."""
    geo = gmsh.model.geo
    corner = geo.addPoint(0.0, 0.0, 0.0)

    def draw(start: int, *places: tuple[float, float]) -> tuple[int, list[int]]:
        points = [start, *(geo.addPoint(x, y, 0.0) for x, y in places)]
        lines = [geo.addLine(points[k - 1], points[k]) for k in range(len(points))]
        return geo.addPlaneSurface([geo.addCurveLoop(lines)]), lines

    blade, above = draw(corner, (FREE, 0.0), (WIDTH, 0.0), (WIDTH, HEIGHT), (0.0, HEIGHT))
    spike = (FREE / 2, -2e-3), (FREE, 0.0), (WIDTH, 0.0), (WIDTH, -DEPTH), (0.0, -DEPTH)
    disk, below = draw(corner if share else geo.addPoint(0.0, 0.0, 0.0), *spike)
    beside = [draw(corner, (-FREE, 0.0), (-FREE, -FREE), (0.0, -FREE))[0]] if flap else []
    joint = [above[2], below[3]]
    for curve in joint:
        geo.mesh.setTransfiniteCurve(curve, 6)
    geo.synchronize()
    groups = {"joint": joint, "tip": [above[4]], "side": [above[3]], "clamp": [below[5]]}
    for dimension, members in ((2, {"blade": [blade, *beside], "disk": [disk]}), (1, groups)):
        for name, entities in members.items():
            gmsh.model.setPhysicalName(dimension, gmsh.model.addPhysicalGroup(dimension, entities), name)
    gmsh.option.setNumber("Mesh.CharacteristicLengthMax", 6e-3)
    gmsh.model.mesh.generate(2)
