r"""A twisted vane on a wedge-shaped foot in a slot of the disk: free tetrahedra, as meshes of CAD models have.

            /|
           / /    vane: turns by ``twist`` towards its tip
          / /
      ___| |______
     |   /  \    /|   y = 0: top of the foot and of the disk
     |  /    \  / |
     | /______\/  |   <- left, right: the flanks, on both walls of the slot
     |  disk   |  |
     |_________|__|   z runs along the slot

Physical groups: volumes ``blade`` and ``disk``; surfaces ``left`` and ``right`` (the flanks, faces of both bodies),
``stop`` (the foot's end at ``z = 0``, where a lock may hold it), ``clamp`` (bottom of the disk) and ``tip``. Lengths in
m; ``y`` points outwards. Flanks have the same mesh on both sides because gmsh takes them for periodic. What it makes of
the volumes differs a little from version to version.
"""

from __future__ import annotations

from math import cos, inf, radians, sin, tan

import gmsh

WALL = 0.5e-3  # gap below the foot [m]


def build(
    *,
    height: float = 50.0e-3,
    chord: float = 16.0e-3,
    thickness: float = 4.0e-3,
    twist: float = 40.0,
    depth: float = 20.0e-3,
    neck_width: float = 8.0e-3,
    flank_angle: float = 55.0,
    flank_height: float = 7.0e-3,
    disk_width: float = 36.0e-3,
    disk_height: float = 18.0e-3,
    flank_size: float = 5.0e-3,
    mesh_size: float = 6.0e-3,
) -> None:
    """Add blade and disk to the current gmsh model, mesh them and name their groups.

    Args:
        height: Of the vane [m].
        chord: Of the vane, along the slot where it begins [m].
        thickness: Of the vane where it begins [m]; half of it at the tip.
        twist: Angle by which the vane turns from foot to tip [degrees].
        depth: Length of slot and foot [m].
        neck_width: Width of the foot at its top [m].
        flank_angle: Of the flanks to the horizontal [degrees].
        flank_height: Of the foot [m].
        disk_width: Width of the disk [m].
        disk_height: Height of the disk [m].
        flank_size: Size of the cells on the flanks [m].
        mesh_size: Largest size of cells [m].

    Raises:
        ValueError: A parameter is out of its range; names it.
    """
    for name, value in locals().items():
        if name != "twist" and not 0 < value < inf:
            raise ValueError(f"{name} = {value}: expected a positive number")
    if not abs(twist) < 80.0:
        raise ValueError(f"twist = {twist}: expected degrees, less than 80")
    if not 20.0 < flank_angle < 80.0:
        raise ValueError(f"flank_angle = {flank_angle}: expected 20 to 80 degrees")
    if not chord < depth:
        raise ValueError(f"chord = {chord}: expected less than depth = {depth}")
    if not thickness < neck_width:
        raise ValueError(f"thickness = {thickness}: expected less than neck_width = {neck_width}")
    neck = neck_width / 2
    foot = neck + flank_height / tan(radians(flank_angle))
    if not foot < disk_width / 2:
        raise ValueError(f"disk_width = {disk_width}: expected more than the foot's, {2 * foot:.3g}")
    if not flank_height + WALL < disk_height:
        raise ValueError(f"disk_height = {disk_height}: expected more than {flank_height + WALL:.3g}, the slot's depth")
    flank = [(neck, 0.0), (foot, -flank_height)]
    slot = [*flank, (foot, -flank_height - WALL)]
    side = disk_width / 2
    root = _draw_prism([*flank, *_mirror(flank)], depth)
    wall = [(side, -disk_height), (side, 0.0)]
    disk = _draw_prism([*wall, *slot, *_mirror(slot), *_mirror(wall)], depth)
    vane = _draw_vane(height, chord, thickness, radians(twist), depth / 2)
    gmsh.model.occ.fragment([(3, root)], [(3, vane)])  # they share the nodes of the face between them
    gmsh.model.occ.synchronize()
    blade = [tag for _, tag in gmsh.model.getEntities(3) if tag != disk]
    _name(3, "blade", blade)
    _name(3, "disk", [disk])
    for name, sign in (("left", -1), ("right", 1)):
        ends = sorted((sign * neck, sign * foot))
        faces = _find_faces((ends[0], -flank_height, 0.0), (ends[1], 0.0, depth))
        identity = [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1]
        gmsh.model.mesh.setPeriodic(2, faces[1:], faces[:1], identity)
        _name(2, name, faces)
        for _, point in gmsh.model.getBoundary([(2, face) for face in faces], recursive=True):
            gmsh.model.mesh.setSize([(0, point)], flank_size)
    _name(2, "stop", _find_faces((-foot, -flank_height, 0.0), (foot, 0.0, 0.0)))
    _name(2, "clamp", _find_faces((-side, -disk_height, 0.0), (side, -disk_height, depth)))
    _name(2, "tip", _find_faces((-depth, height, -depth), (depth, height, 2 * depth)))
    gmsh.option.setNumber("Mesh.MeshSizeMax", mesh_size)
    gmsh.model.mesh.generate(3)


def _mirror(points: list[tuple[float, float]]) -> list[tuple[float, float]]:
    return [(-x, y) for x, y in reversed(points)]


def _draw_face(points: list[tuple[float, float, float]]) -> tuple[int, int]:
    """Tags of the face within a polygon, and of its boundary's loop."""
    occ = gmsh.model.occ
    tags = [occ.addPoint(*point) for point in points]
    loop = occ.addCurveLoop([occ.addLine(tags[k - 1], tags[k]) for k in range(len(tags))])
    return occ.addPlaneSurface([loop]), loop


def _draw_prism(profile: list[tuple[float, float]], depth: float) -> int:
    """Tag of the volume that a polygon of the x-y plane becomes along z."""
    face, _ = _draw_face([(x, y, 0.0) for x, y in profile])
    return next(tag for dimension, tag in gmsh.model.occ.extrude([(2, face)], 0.0, 0.0, depth) if dimension == 3)


def _draw_vane(height: float, chord: float, thickness: float, twist: float, middle: float) -> int:
    """Tag of the volume through three rectangles, each turned further about the vane's own axis."""
    loops = []
    for share in (0.0, 0.5, 1.0):
        half, wide, turn = chord / 2, thickness * (1 - share / 2) / 2, share * twist
        corners = [(-wide, -half), (wide, -half), (wide, half), (-wide, half)]
        turned = [(x * cos(turn) + z * sin(turn), z * cos(turn) - x * sin(turn)) for x, z in corners]
        tags = [gmsh.model.occ.addPoint(x, share * height, middle + z) for x, z in turned]
        loops.append(gmsh.model.occ.addWire([gmsh.model.occ.addLine(tags[k - 1], tags[k]) for k in range(4)]))
    return gmsh.model.occ.addThruSections(loops)[0][1]


def _find_faces(low: tuple[float, float, float], high: tuple[float, float, float]) -> list[int]:
    """Tags of the faces within a box [m]."""
    near = 1e-6
    box = [x - near for x in low] + [x + near for x in high]
    return [tag for _, tag in gmsh.model.getEntitiesInBoundingBox(*box, dim=2)]


def _name(dimension: int, name: str, tags: list[int]) -> None:
    gmsh.model.setPhysicalName(dimension, gmsh.model.addPhysicalGroup(dimension, tags), name)
