"""A sector of a solid disk, cut like a pie, or with a bore about its axis: a blade stands on the middle of its rim."""

from __future__ import annotations

from itertools import pairwise
from math import cos, pi, sin

import gmsh

RIM, TIP = 0.05, 0.07  # radii [m]


def build(*, sectors: int = 6, bore: float = 0.0) -> None:
    """Adds blade and disk, their mesh and the groups blade, disk, seat, tip, low, high and clamp, beside the seat.

    Args:
        sectors: How many make a disk.
        bore: Its radius [m].
    """
    geo = gmsh.model.geo
    axis = geo.addPoint(0.0, 0.0, 0.0)

    def at(radius: float, share: float) -> int:
        angle = 2 * pi / sectors * share
        return geo.addPoint(radius * cos(angle), radius * sin(angle), 0.0)

    def arc(points: list[int], cells: int) -> int:
        return mesh(geo.addCircleArc(points[0], axis, points[1]), cells)

    def mesh(curve: int, cells: int) -> int:
        geo.mesh.setTransfiniteCurve(curve, cells + 1)
        return curve

    rim, inner = [at(RIM, share) for share in (0.0, 0.2, 0.8, 1.0)], [axis, axis]
    if bore:
        inner = [at(bore, share) for share in (0.0, 1.0)]
    low, high = mesh(geo.addLine(inner[0], rim[0]), 6), mesh(geo.addLine(rim[3], inner[1]), 6)
    ground = [arc(ends, cells) for ends, cells in zip(pairwise(rim), (2, 4, 2), strict=True)]
    hub = [-arc(inner, 3)] if bore else []
    foot, top = ([at(radius, share) for share in (0.2, 0.8)] for radius in (RIM, TIP))
    seat, tip = arc(foot, 4), arc(top, 4)
    sides = [mesh(geo.addLine(*ends), 2) for ends in zip(foot, top, strict=True)]
    disk = geo.addPlaneSurface([geo.addCurveLoop([low, *ground, high, *hub])])
    blade = geo.addPlaneSurface([geo.addCurveLoop([seat, sides[1], -tip, -sides[0]])])
    geo.synchronize()
    for dimension, name, members in (
        (2, "blade", [blade]),
        (2, "disk", [disk]),
        (1, "seat", [seat, ground[1]]),
        (1, "tip", [tip]),
        (1, "low", [low]),
        (1, "high", [high]),
        (1, "clamp", [ground[0], ground[2]]),
    ):
        gmsh.model.setPhysicalName(dimension, gmsh.model.addPhysicalGroup(dimension, members), name)
    gmsh.option.setNumber("Mesh.CharacteristicLengthMax", 10e-3)
    gmsh.model.mesh.generate(2)
