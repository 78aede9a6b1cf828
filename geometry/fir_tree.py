r"""A bladed-disk sector whose blade hangs in the disk by a fir-tree root.

The plane of the mesh is normal to the engine's axis: ``y`` is the radius through the blade, ``x`` the direction of
rotation, and the origin lies on the axis. The blade stands up (+y); both bodies are symmetric about ``x = 0``.

               |   |        tip above
               |   |
         ______|   |______
        |____platform_____|
               |   |
     __________|   |__________  rim
     \        /     \        /
      \      /       \  <----------- flank top_right: outward normal of the blade (sin a, cos a),
       \     \       /     /         a = flank_angle, measured from the x direction
    cut \     \     /     / cut
         \    / root\  <------------ flank bottom_right
          \  /_______\  /
           \   disk    /
            \_________/  hub

The flanks are the upward-facing sides of the blade's lobes: the centrifugal pull presses them on the disk's teeth.
Everywhere else the disk's outline is the blade's own outline slid outwards *along the flank*, which leaves the flank
in place and opens a gap of ``clearance`` on the undersides of the lobes, and a similar one beside the top neck.

Physical groups:
    surfaces: ``blade``, ``disk``
    curves: ``clamp`` (hub and both sector cuts), ``tip``, and the flanks, each holding the curves of both bodies:
        ``left``, ``right`` with one lobe; ``top_left``, ``top_right``, ``bottom_left``, ``bottom_right`` with two;
        ``lobe1_left``, ``lobe1_right``, ``lobe2_left`` ... from the top with more.

Every surface is a four-sided block with a transfinite quadrilateral mesh, so the same parameters give the same mesh
on every version of gmsh. The nodes of the two sides of a flank coincide but stay distinct.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from math import atan2, cos, hypot, radians, sin, sqrt, tan

import gmsh

GROWTH = 1.15  # ratio of neighbouring cells across the body, coarser with the distance from the joint
BLADE_ASPECT = 0.85  # mean height of the cells above the platform over mesh size ...
BLADE_GROWTH = 1.015  # ... and the ratio of neighbours along the blade: bending is strongest at its foot
HUB_SHARES = (0.0, 0.3, 0.5)  # of the half sector: where the mesh lines below the slot meet the hub
CORNER_SLOPE = 0.2  # of the mesh line from the slot's lower corner to the sector cut
FOOT_SHARE = 0.75  # of the blade's fillet above the mesh line to the shank, which slants outwards

Point = tuple[float, float]


@dataclass(frozen=True)
class Piece:
    """A straight or circular piece of an outline, followed downwards on the right side.

    Attributes:
        start, end: End points, [m].
        centre: Centre of the arc [m], None for a straight piece.
        cells: Number of cell edges along it.
        lobe: Number of the lobe whose contact flank it is, counted from the top; None elsewhere.
    """

    start: Point
    end: Point
    centre: Point | None
    cells: int
    lobe: int | None = None


@dataclass(frozen=True)
class Fillet:
    """An arc in a corner: its ends, its centre, and a point in between where blocks meet [m]."""

    start: Point
    split: Point
    end: Point
    centre: Point


@dataclass
class Body:
    """Draws one body as four-sided blocks; neighbouring blocks share points and curves, bodies share none."""

    name: str
    surfaces: list[int] = field(default_factory=list)
    _points: dict[Point, int] = field(default_factory=dict)
    _curves: dict[frozenset[int], tuple[int, int]] = field(default_factory=dict)

    def point(self, position: Point) -> int:
        key = (round(position[0], 12) + 0.0, round(position[1], 12) + 0.0)
        if key not in self._points:
            self._points[key] = gmsh.model.geo.addPoint(*key, 0.0)
        return self._points[key]

    def curve(self, start: Point, end: Point, cells: int, centre: Point | None = None, growth: float = 1.0) -> int:
        """Tag of the curve from start to end, negative where it was drawn the other way round."""
        first, last = self.point(start), self.point(end)
        key = frozenset((first, last))
        if key not in self._curves:
            geo = gmsh.model.geo
            tag = geo.addLine(first, last) if centre is None else geo.addCircleArc(first, self.point(centre), last)
            geo.mesh.setTransfiniteCurve(tag, cells + 1, "Progression", growth)
            self._curves[key] = (tag, first)
        tag, drawn_from = self._curves[key]
        return tag if drawn_from == first else -tag

    def block(self, corners: list[Point], sides: list[int]) -> None:
        """Fill four sides, each from one corner to the next, with quadrilaterals, counter-clockwise."""
        area = sum(a[0] * b[1] - b[0] * a[1] for a, b in zip(corners, corners[1:] + corners[:1]))
        if area < 0:  # the mirrored half: turn the loop so that every cell has a positive Jacobian
            corners, sides = corners[::-1], [-side for side in sides[::-1]]
        surface = gmsh.model.geo.addPlaneSurface([gmsh.model.geo.addCurveLoop(sides)])
        gmsh.model.geo.mesh.setTransfiniteSurface(surface, cornerTags=[self.point(corner) for corner in corners])
        gmsh.model.geo.mesh.setRecombine(2, surface)
        self.surfaces.append(surface)


def build(
    *,
    lobes: int = 2,
    flank_angle: float = 45.0,
    underside_angle: float = 45.0,
    flank_length: float = 5.0e-3,
    top_neck_width: float = 15.0e-3,
    bottom_neck_width: float = 11.0e-3,
    root_bottom_width: float = 8.0e-3,
    neck_height: float = 3.0e-3,
    fillet: float = 1.2e-3,
    clearance: float = 0.3e-3,
    bottom_clearance: float = 1.5e-3,
    bottom_fillet: float = 2.5e-3,
    shank_height: float = 4.0e-3,
    blade_height: float = 76.5e-3,
    blade_thickness: float = 8.0e-3,
    tip_thickness: float = 5.0e-3,
    platform_width: float = 36.0e-3,
    platform_thickness: float = 4.0e-3,
    platform_fillet: float = 2.0e-3,
    sector_angle: float = 12.0,
    rim_radius: float = 190.0e-3,
    hub_radius: float = 135.0e-3,
    pairs: int = 10,
    mesh_size: float = 1.4e-3,
) -> None:
    """Add the sector to the current gmsh model, mesh it and name its groups.

    Args:
        lobes: Lobes on each side of the root.
        flank_angle: Angle of the contact flanks from the x direction [degrees].
        underside_angle: Angle of the lobes' lower faces from the x direction [degrees].
        flank_length: Length of each contact flank [m].
        top_neck_width: Width of the root at the uppermost neck [m].
        bottom_neck_width: Width at the lowest neck; those between are interpolated. Unused with one lobe [m].
        root_bottom_width: Width of the root's flat bottom [m].
        neck_height: From the disk's rim down to the corner of the first flank [m].
        fillet: Radius of necks and lobe tips [m].
        clearance: Gap between the undersides of the lobes and the disk [m].
        bottom_clearance: Gap below the root [m].
        bottom_fillet: Radius in the lower corners of the disk's slot [m].
        shank_height: From the disk's rim up to the platform [m].
        blade_height: From the platform's top to the tip [m].
        blade_thickness: Thickness of the blade at the platform [m].
        tip_thickness: Thickness of the blade at the tip [m].
        platform_width: Width of the platform [m].
        platform_thickness: Thickness of the platform [m].
        platform_fillet: Radius between platform and blade, and between platform and shank [m].
        sector_angle: Angle between the sector cuts [degrees].
        rim_radius: Outer radius of the disk [m].
        hub_radius: Radius of the clamped inner edge [m].
        pairs: Nodes on each side of each flank, ends included.
        mesh_size: Size of the cells away from the flanks [m].

    Raises:
        ValueError: A parameter has the wrong sign or the pieces do not fit together; names the parameter.
    """
    _check_signs(dict(locals()))
    necks = [top_neck_width] if lobes == 1 else [
        top_neck_width + (bottom_neck_width - top_neck_width) * k / (lobes - 1) for k in range(lobes)]
    flank = (cos(radians(flank_angle)), -sin(radians(flank_angle)))
    underside = (-cos(radians(underside_angle)), -sin(radians(underside_angle)))
    slide = clearance / sin(radians(flank_angle + underside_angle))
    corners = _place_corners(necks, root_bottom_width / 2, rim_radius - neck_height, flank, underside,
                             flank_length + slide, fillet)
    platform = rim_radius + shank_height
    shank = _round((-1.0, 0.0), (necks[0] / 2, platform), (0.0, -1.0), platform_fillet)
    root = _follow([shank.end, *corners], fillet, pairs, mesh_size, slide, slide_at_start=True)

    shift = (slide * flank[0], slide * flank[1])
    slot = [(x + shift[0], y + shift[1]) for x, y in corners]
    slot[-1] = _along(slot[-1], underside, bottom_clearance / -underside[1])
    wall = slot[0][0]
    bottom = _round(underside, slot[-1], (-1.0, 0.0), bottom_fillet)
    posts = _follow([(wall, sqrt(rim_radius**2 - wall**2)), *slot[:-1], bottom.start], fillet, pairs, mesh_size, slide,
                    slide_at_start=False)
    posts.append(Piece(bottom.start, bottom.split, bottom.centre, _count(bottom_fillet / 2, mesh_size)))
    half_angle = radians(sector_angle / 2)
    _check_fit(root, posts, bottom, half_angle, hub_radius)
    if not necks[0] / 2 + platform_fillet < platform_width / 2 <= platform * tan(half_angle):
        raise ValueError(f"platform_width = {platform_width}: expected more than {necks[0] + 2 * platform_fillet:.5g}, "
                         f"the shank with its fillets, up to {2 * platform * tan(half_angle):.5g}, the sector's width")

    blade, disk = Body("blade"), Body("disk")
    flanks: dict[str, list[int]] = {}
    columns = _count(top_neck_width / 2, mesh_size)
    _draw_root(blade, root, columns, flanks, lobes)
    tip = _draw_blade(blade, shank, platform_width / 2, platform_thickness, platform_fillet, blade_height,
                      blade_thickness / 2, tip_thickness / 2, columns, mesh_size)
    clamp = _draw_disk(disk, posts, bottom, flanks, lobes, half_angle, hub_radius, rim_radius, mesh_size)

    gmsh.model.geo.synchronize()
    _drop_arc_centres()
    for body in (blade, disk):
        gmsh.model.setPhysicalName(2, gmsh.model.addPhysicalGroup(2, body.surfaces), body.name)
    for name, curves in {**flanks, "clamp": clamp, "tip": tip}.items():
        gmsh.model.setPhysicalName(1, gmsh.model.addPhysicalGroup(1, [abs(curve) for curve in curves]), name)
    gmsh.model.mesh.generate(2)


def name_flank(lobe: int, lobes: int, side: int) -> str:
    """Name of a flank: lobe counted from 1 at the top, side -1 (left, x < 0) or 1 (right)."""
    hand = "right" if side > 0 else "left"
    if lobes == 1:
        return hand
    return f"{('top', 'bottom')[lobe - 1]}_{hand}" if lobes == 2 else f"lobe{lobe}_{hand}"


def _check_signs(parameters: dict[str, float]) -> None:
    for name, value in parameters.items():
        if not value > 0:
            raise ValueError(f"{name} = {value}: expected a positive number")
    for name in ("flank_angle", "underside_angle"):
        if not 15.0 <= parameters[name] <= 75.0:
            raise ValueError(f"{name} = {parameters[name]}: expected degrees from the x direction, 15 to 75")
    if parameters["pairs"] < 2:
        raise ValueError(f"pairs = {parameters['pairs']}: expected at least 2, the ends of the flank")
    if parameters["sector_angle"] >= 90.0:
        raise ValueError(f"sector_angle = {parameters['sector_angle']}: expected less than 90 degrees")


def _check_fit(root: list[Piece], posts: list[Piece], bottom: Fillet, half_angle: float, hub_radius: float) -> None:
    """Stop before gmsh draws a body that overlaps itself or leaves the sector."""
    if bottom.end[0] <= 0:
        raise ValueError("bottom_fillet: the two corners of the slot overlap; reduce it or increase root_bottom_width")
    for body, outline in (("blade", root), ("disk", posts)):
        for piece in outline:
            x, y = piece.end
            if y >= piece.start[1] or x <= 0:
                raise ValueError(f"the {body}'s outline turns back at x = {x:.5g}, y = {y:.5g}: necks, lobes and "
                                 "fillets do not fit; reduce fillet or flank_length, or widen a neck")
            if body == "disk" and x >= y * tan(half_angle):
                raise ValueError(f"the root leaves the sector at x = {x:.5g}, y = {y:.5g}: expected x less than "
                                 f"{y * tan(half_angle):.5g}; increase sector_angle or rim_radius, or narrow the necks")
    if bottom.end[1] <= hub_radius:
        raise ValueError(f"hub_radius = {hub_radius}: expected less than {bottom.end[1]:.5g}, the slot's bottom")


def _place_corners(necks: list[float], bottom: float, first: float, flank: Point, underside: Point, straight: float,
                   fillet: float) -> list[Point]:
    """Sharp corners of the blade's right outline from the top neck down: neck, lobe, neck, ..., lobe, bottom [m]."""
    corners: list[Point] = []
    level = first
    for k, neck in enumerate(necks):
        before = (0.0, -1.0) if k == 0 else underside
        length = straight + _tangent_length(before, flank, fillet) + _tangent_length(flank, underside, fillet)
        lobe = (neck / 2 + length * flank[0], level + length * flank[1])
        inner = bottom if k == len(necks) - 1 else necks[k + 1] / 2
        descent = (lobe[0] - inner) / -underside[0]
        corners += [(neck / 2, level), lobe]
        level = lobe[1] + descent * underside[1]
    return corners + [(bottom, level)]


def _tangent_length(before: Point, after: Point, radius: float) -> float:
    """Distance from a corner to where its fillet touches, for unit directions before and after it [m]."""
    cosine = before[0] * after[0] + before[1] * after[1]
    return radius * sqrt((1 - cosine) / (1 + cosine))


def _round(before: Point, corner: Point, after: Point, radius: float, share: float = 0.5) -> Fillet:
    """Round the corner between two unit directions; a block boundary may meet the arc after ``share`` of it."""
    cut = _tangent_length(before, after, radius)
    start, end = _along(corner, before, -cut), _along(corner, after, cut)
    left = before[0] * after[1] - before[1] * after[0] > 0
    centre = _along(start, (-before[1], before[0]) if left else (before[1], -before[0]), radius)
    turned = share * 2 * atan2(cut, radius) * (1 if left else -1)
    spoke = (start[0] - centre[0], start[1] - centre[1])
    split = (centre[0] + cos(turned) * spoke[0] - sin(turned) * spoke[1],
             centre[1] + sin(turned) * spoke[0] + cos(turned) * spoke[1])
    return Fillet(start, split, end, centre)


def _follow(vertices: list[Point], fillet: float, pairs: int, mesh_size: float, slide: float,
            slide_at_start: bool) -> list[Piece]:
    """Pieces of an outline with rounded corners, from the top down.

    Args:
        vertices: Top, neck, lobe, neck, ..., lobe, bottom; all but the first and the last are rounded [m].
        fillet: Radius of the corners [m].
        pairs: Nodes on a contact flank.
        mesh_size: Size of the cells elsewhere [m].
        slide: Length of every flank that has no opposite [m].
        slide_at_start: It lies at the flank's upper end (the blade's neck), not at the lower end (the disk's groove).
    """
    directions = [_direction(a, b) for a, b in zip(vertices, vertices[1:])]
    rounded = [_round(before, corner, after, fillet)
               for before, corner, after in zip(directions, vertices[1:], directions[1:])]
    pieces, start = [], vertices[0]
    for k, direction in enumerate(directions):
        end = rounded[k].start if k < len(rounded) else vertices[-1]
        contact = Piece(start, end, None, pairs - 1, k // 2 + 1)
        if k % 2 == 0:  # a wall or the underside of a lobe
            pieces.append(Piece(start, end, None, _count(hypot(end[0] - start[0], end[1] - start[1]), mesh_size)))
        elif slide_at_start:
            joint = _along(start, direction, slide)
            pieces += [Piece(start, joint, None, 1), replace(contact, start=joint)]
        else:
            joint = _along(end, direction, -slide)
            pieces += [replace(contact, end=joint), Piece(joint, end, None, 1)]
        if k < len(rounded):
            arc = rounded[k]
            chord = hypot(arc.end[0] - arc.start[0], arc.end[1] - arc.start[1])
            pieces.append(Piece(arc.start, arc.end, arc.centre, max(2, _count(chord, mesh_size / 1.5))))
            start = arc.end
    return pieces


def _count(length: float, mesh_size: float) -> int:
    return max(1, round(length / mesh_size))


def _direction(start: Point, end: Point) -> Point:
    length = hypot(end[0] - start[0], end[1] - start[1])
    return (end[0] - start[0]) / length, (end[1] - start[1]) / length


def _along(start: Point, direction: Point, distance: float) -> Point:
    return start[0] + distance * direction[0], start[1] + distance * direction[1]


def _mirror(points: list[Point], side: int) -> list[Point]:
    return [(side * x, y) for x, y in points]


def _spread(outline: list[Piece], top: float, bottom: float) -> list[float]:
    """Levels opposite the ends of an outline's pieces: their own height, bent towards ``top`` and ``bottom`` [m].

    The cubic keeps the mesh lines level, and so well inclined to flat flanks, but for the first and the last few.
    """
    first, last = outline[0].start[1], outline[-1].end[1]
    levels = [top]
    for piece in outline:
        below = (first - piece.end[1]) / (first - last)
        levels.append(piece.end[1] + (top - first) * (1 - below) ** 3 + (bottom - last) * below**3)
    return levels


def _draw_row(body: Body, piece: Piece, far_start: Point, far_end: Point, columns: int, side: int) -> int:
    """One block from an outline's piece inwards to the points opposite its ends; tag of the outline's curve."""
    start, end, far_end, far_start = _mirror([piece.start, piece.end, far_end, far_start], side)
    outline = body.curve(start, end, piece.cells, _mirror([piece.centre], side)[0] if piece.centre else None)
    body.block([start, end, far_end, far_start], [
        outline,
        body.curve(end, far_end, columns, growth=GROWTH),
        body.curve(far_end, far_start, piece.cells),
        -body.curve(start, far_start, columns, growth=GROWTH),
    ])
    return outline


def _draw_root(body: Body, outline: list[Piece], columns: int, flanks: dict[str, list[int]], lobes: int) -> None:
    """The blade below the platform, from its outline to the axis of symmetry; adds its curves to ``flanks``."""
    levels = _spread(outline, outline[0].start[1], outline[-1].end[1])
    for side in (-1, 1):
        for piece, upper, lower in zip(outline, levels, levels[1:]):
            curve = _draw_row(body, piece, (0.0, upper), (0.0, lower), columns, side)
            if piece.lobe:
                flanks.setdefault(name_flank(piece.lobe, lobes, side), []).append(curve)


def _draw_blade(body: Body, shank: Fillet, half_width: float, thickness: float, fillet: float, height: float,
                half_base: float, half_tip: float, columns: int, mesh_size: float) -> list[int]:
    """Platform and blade above ``shank``, the fillet below the platform; returns the curves of the tip."""
    platform = shank.start[1]
    top = platform + thickness
    tip = (half_tip, top + height)
    foot = _round(_direction(tip, (half_base, top)), (half_base, top), (1.0, 0.0), fillet, FOOT_SHARE)
    arc, rows = max(2, _count(fillet, mesh_size)), max(2, _count(thickness, mesh_size))
    above = _count(height, BLADE_ASPECT * mesh_size)
    flat = _count(half_width - max(foot.end[0], shank.start[0]), mesh_size)
    tips = []
    for side in (-1, 1):
        column = [
            Piece(tip, foot.start, None, above),
            Piece(foot.start, foot.split, foot.centre, arc),
            Piece(foot.split, shank.split, None, rows),
            Piece(shank.split, shank.end, shank.centre, arc),
        ]
        for x in (side * tip[0], 0.0):  # the row above the foot finds its long sides drawn
            base = (side * foot.start[0], foot.start[1]) if x else (0.0, foot.start[1])
            body.curve(base, (x, tip[1]), above, growth=BLADE_GROWTH)
        levels = [tip[1], foot.start[1], (foot.start[1] + top) / 2, (platform + shank.end[1]) / 2, shank.end[1]]
        for piece, upper, lower in zip(column, levels, levels[1:]):
            _draw_row(body, piece, (0.0, upper), (0.0, lower), columns, side)
        upper = _mirror([foot.split, foot.end, (half_width, top), foot.centre], side)
        lower = _mirror([shank.split, shank.start, (half_width, platform), shank.centre], side)
        for k, cells, centres in ((0, arc, (upper[3], lower[3])), (1, flat, (None, None))):
            body.block([upper[k], upper[k + 1], lower[k + 1], lower[k]], [
                body.curve(upper[k], upper[k + 1], cells, centres[0]),
                body.curve(upper[k + 1], lower[k + 1], rows),
                body.curve(lower[k + 1], lower[k], cells, centres[1]),
                body.curve(lower[k], upper[k], rows),
            ])
        tips.append(body.curve((side * tip[0], tip[1]), (0.0, tip[1]), columns))
    return tips


def _draw_disk(body: Body, posts: list[Piece], bottom: Fillet, flanks: dict[str, list[int]], lobes: int,
               half_angle: float, hub_radius: float, rim_radius: float, mesh_size: float) -> list[int]:
    """Both posts and the disk below the slot; adds to ``flanks``, returns the curves of hub and sector cuts."""
    centre, corner = (0.0, 0.0), bottom.split
    rim, hub = ((radius * sin(half_angle), radius * cos(half_angle)) for radius in (rim_radius, hub_radius))
    at_cut = lambda level: (level * tan(half_angle), level)  # noqa: E731
    # The three blocks that meet in the slot's corner share its angle about evenly.
    depth = corner[1] - (at_cut(corner[1])[0] - corner[0]) * CORNER_SLOPE
    levels = _spread(posts, rim[1], depth)
    columns = max(2, _count(at_cut(corner[1])[0] - corner[0], 1.6 * mesh_size))
    arc = _count(hypot(corner[0] - bottom.end[0], corner[1] - bottom.end[1]), mesh_size)
    middle = _count(bottom.end[0], mesh_size)
    rows = max(2, _count(bottom.end[1] - hub_radius, 2 * mesh_size))
    feet = [(hub_radius * sin(share * half_angle), hub_radius * cos(share * half_angle)) for share in HUB_SHARES]
    clamp = []
    for side in (-1, 1):
        start, cut = _mirror([posts[0].start, rim], side)
        body.curve(start, cut, columns, centre, GROWTH)  # the rim; the first row of the post finds it drawn
        for piece, upper, lower in zip(posts, levels, levels[1:]):
            curve = _draw_row(body, piece, at_cut(upper), at_cut(lower), columns, side)
            clamp.append(body.curve(*_mirror([at_cut(upper), at_cut(lower)], side), piece.cells))
            if piece.lobe:
                flanks.setdefault(name_flank(piece.lobe, lobes, side), []).append(curve)
        above = _mirror([(0.0, bottom.end[1]), bottom.end, corner, at_cut(depth)], side)
        below = _mirror([*feet, hub], side)
        arc_centre = _mirror([bottom.centre], side)[0]
        for k, (cells, round_which) in enumerate(((middle, None), (arc, arc_centre), (columns, None))):
            growth = GROWTH if k == 2 else 1.0
            hub_curve = body.curve(below[k], below[k + 1], cells, centre, growth)
            outer = body.curve(above[k + 1], below[k + 1], rows, growth=GROWTH)
            body.block([above[k], below[k], below[k + 1], above[k + 1]], [
                body.curve(above[k], below[k], rows, growth=GROWTH), hub_curve, -outer,
                -body.curve(above[k], above[k + 1], cells, round_which, growth)])
            clamp.append(hub_curve)
        clamp.append(outer)
    return clamp


def _drop_arc_centres() -> None:
    """Points that no curve ends in would become nodes without a cell."""
    ends = set(gmsh.model.getBoundary(gmsh.model.getEntities(1), combined=False, oriented=False))
    gmsh.model.removeEntities([point for point in gmsh.model.getEntities(0) if point not in ends])
