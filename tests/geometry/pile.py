"""Three blocks, one on the other: disk, blade and a cover, whose own seat on the blade is the boundary "lid"."""

from __future__ import annotations

import gmsh


def build(
    *,
    cover: str = "cover",
    glued: bool = False,
    pinned: bool = False,
    gap: float = 0.0,
    lid: str = "lid",
    sides: int = 2,
) -> None:
    """Adds the blocks, their mesh and the groups disk, blade, joint, lid, tip and clamp to the current gmsh model.

    Args:
        cover: Name of the uppermost block's body.
        glued: Whether it shares nodes with the blade.
        pinned: Whether it shares those at the ends of its seat alone, and has fewer cells along that.
        gap: Between both [m].
        lid: Name of the group that the cover's seat is in; none where it is empty.
        sides: Of that seat in the group; one: the cover's.
    """
    geo, width, height = gmsh.model.geo, 0.04, 0.02
    groups: dict[tuple[int, str], list[int]] = {}

    def level(y: float) -> list[int]:
        return [geo.addPoint(0.0, y, 0.0), geo.addPoint(width, y, 0.0)]

    def block(body: str, corners: list[int], below: int | None = None) -> list[int]:
        lines = [geo.addLine(corners[k], corners[(k + 1) % 4]) for k in range(4) if k or below is None]
        lines = lines if below is None else [-below, *lines]
        surface = geo.addPlaneSurface([geo.addCurveLoop(lines)])
        for line in lines:
            geo.mesh.setTransfiniteCurve(abs(line), 6)
        geo.mesh.setTransfiniteSurface(surface)
        geo.mesh.setRecombine(2, surface)
        groups.setdefault((2, body), []).append(surface)
        return lines

    ground, seat, root, neck, top = (level(k * height) for k in (0, 1, 1, 2, 3))
    disk, blade = block("disk", [*ground, *seat[::-1]]), block("blade", [*root, *neck[::-1]])
    if glued:
        upper, cover_seat = block(cover, [*neck, *top[::-1]], blade[2]), [blade[2]]
    else:
        upper = block(cover, [*(neck if pinned else level(2 * height + gap)), *top[::-1]])
        for line in (upper[0], upper[2]) if pinned else ():
            geo.mesh.setTransfiniteCurve(line, 5)
        cover_seat = [blade[2], upper[0]]
    groups |= {(1, "joint"): [disk[2], blade[0]], (1, "tip"): [blade[1]], (1, "clamp"): [disk[0], upper[2]]}
    if lid:
        groups.setdefault((1, lid), []).extend(cover_seat[-sides:])
    geo.synchronize()
    for (dimension, name), members in groups.items():
        gmsh.model.setPhysicalName(dimension, gmsh.model.addPhysicalGroup(dimension, members), name)
    gmsh.model.mesh.generate(2)
