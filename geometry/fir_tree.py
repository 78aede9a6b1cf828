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
    curves: ``clamp`` (hub and both sector cuts; with ``free_cuts`` the hub alone, and the cuts are ``low_cut``, at
        x > 0, and ``high_cut``, for ``[cyclic]`` of a scene), ``tip``, and the flanks, each holding the curves of both
        bodies:
        ``left``, ``right`` with one lobe; ``top_left``, ``top_right``, ``bottom_left``, ``bottom_right`` with two;
        ``lobe1_left``, ``lobe1_right``, ``lobe2_left`` ... from the top with more.

The nodes of the two sides of a flank coincide but stay distinct.
"""

from __future__ import annotations

from itertools import pairwise
from math import cos, hypot, radians, sin, sqrt, tan

from blocks import Body, Point, check_angle, check_pairs, check_positive, mesh_bodies, mirror
from outlines import (
    Fillet,
    Piece,
    count_cells,
    find_direction,
    follow_outline,
    measure_tangent,
    round_corner,
    spread_levels,
    step_along,
)

GROWTH = 1.15  # ratio of neighbouring cells across the body, coarser with the distance from the joint
BLADE_ASPECT = 0.85  # mean height of the cells above the platform over mesh size ...
BLADE_GROWTH = 1.015  # ... and the ratio of neighbours along the blade: bending is strongest at its foot
HUB_SHARES = (0.0, 0.3, 0.5)  # of the half sector: where the mesh lines below the slot meet the hub
CORNER_SLOPE = 0.2  # of the mesh line from the slot's lower corner to the sector cut
FOOT_SHARE = 0.75  # of the blade's fillet above the mesh line to the shank, which slants outwards


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
    free_cuts: bool = False,
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
        free_cuts: Whether the sector cuts are boundaries of their own, and not clamped.

    Raises:
        ValueError: A parameter has the wrong sign or the pieces do not fit together; names the parameter.
    """
    _check_parameters(locals())
    necks = (
        [top_neck_width]
        if lobes == 1
        else [top_neck_width + (bottom_neck_width - top_neck_width) * k / (lobes - 1) for k in range(lobes)]
    )
    flank = (cos(radians(flank_angle)), -sin(radians(flank_angle)))
    underside = (-cos(radians(underside_angle)), -sin(radians(underside_angle)))
    slide = clearance / sin(radians(flank_angle + underside_angle))
    corners = _place_corners(
        necks, root_bottom_width / 2, rim_radius - neck_height, flank, underside, flank_length + slide, fillet
    )
    platform = rim_radius + shank_height
    shank = round_corner((-1.0, 0.0), (necks[0] / 2, platform), (0.0, -1.0), platform_fillet)
    root = follow_outline([shank.end, *corners], fillet, pairs, mesh_size, slide, slide_at_start=True)

    shift = (slide * flank[0], slide * flank[1])
    slot = [(x + shift[0], y + shift[1]) for x, y in corners]
    slot[-1] = step_along(slot[-1], underside, bottom_clearance / -underside[1])
    wall = slot[0][0]
    bottom = round_corner(underside, slot[-1], (-1.0, 0.0), bottom_fillet)
    posts = follow_outline(
        [(wall, sqrt(rim_radius**2 - wall**2)), *slot[:-1], bottom.start],
        fillet,
        pairs,
        mesh_size,
        slide,
        slide_at_start=False,
    )
    posts.append(Piece(bottom.start, bottom.split, bottom.centre, count_cells(bottom_fillet / 2, mesh_size)))
    half_angle = radians(sector_angle / 2)
    _check_fit(root, posts, bottom, half_angle, hub_radius)
    if not necks[0] / 2 + platform_fillet < platform_width / 2 <= platform * tan(half_angle):
        raise ValueError(
            f"platform_width = {platform_width}: expected more than {necks[0] + 2 * platform_fillet:.5g}, "
            f"the shank with its fillets, up to {2 * platform * tan(half_angle):.5g}, the sector's width"
        )

    blade, disk = Body("blade"), Body("disk")
    flanks: dict[str, list[int]] = {}
    columns = count_cells(top_neck_width / 2, mesh_size)
    _draw_root(blade, root, columns, flanks, lobes)
    tip = _draw_blade(
        blade,
        shank,
        platform_width / 2,
        platform_thickness,
        platform_fillet,
        blade_height,
        blade_thickness / 2,
        tip_thickness / 2,
        columns,
        mesh_size,
    )
    hub, *cuts = _draw_disk(disk, posts, bottom, flanks, lobes, half_angle, hub_radius, rim_radius, mesh_size)
    held = {"clamp": hub} | dict(zip(("high_cut", "low_cut"), cuts, strict=True))
    if not free_cuts:
        held = {"clamp": [curve for curves in held.values() for curve in curves]}

    mesh_bodies((blade, disk), {**flanks, **held, "tip": tip})


def name_flank(lobe: int, lobes: int, side: int) -> str:
    """Name of a flank: lobe counted from 1 at the top, side -1 (left, x < 0) or 1 (right)."""
    hand = "right" if side > 0 else "left"
    if lobes == 1:
        return hand
    return f"{('top', 'bottom')[lobe - 1]}_{hand}" if lobes == 2 else f"lobe{lobe}_{hand}"


def _check_parameters(parameters: dict[str, float]) -> None:
    check_positive({name: value for name, value in parameters.items() if name != "free_cuts"})
    for name in ("flank_angle", "underside_angle"):
        check_angle(name, parameters[name])
    check_pairs(parameters["pairs"])
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
                raise ValueError(
                    f"the {body}'s outline turns back at x = {x:.5g}, y = {y:.5g}: necks, lobes and "
                    "fillets do not fit; reduce fillet or flank_length, or widen a neck"
                )
            if body == "disk" and x >= y * tan(half_angle):
                raise ValueError(
                    f"the root leaves the sector at x = {x:.5g}, y = {y:.5g}: expected x less than "
                    f"{y * tan(half_angle):.5g}; increase sector_angle or rim_radius, or narrow the necks"
                )
    if bottom.end[1] <= hub_radius:
        raise ValueError(f"hub_radius = {hub_radius}: expected less than {bottom.end[1]:.5g}, the slot's bottom")


def _place_corners(
    necks: list[float], bottom: float, first: float, flank: Point, underside: Point, straight: float, fillet: float
) -> list[Point]:
    """Sharp corners of the blade's right outline from the top neck down: neck, lobe, neck, ..., lobe, bottom [m]."""
    corners: list[Point] = []
    level = first
    for k, neck in enumerate(necks):
        before = (0.0, -1.0) if k == 0 else underside
        length = straight + measure_tangent(before, flank, fillet) + measure_tangent(flank, underside, fillet)
        lobe = (neck / 2 + length * flank[0], level + length * flank[1])
        inner = bottom if k == len(necks) - 1 else necks[k + 1] / 2
        descent = (lobe[0] - inner) / -underside[0]
        corners += [(neck / 2, level), lobe]
        level = lobe[1] + descent * underside[1]
    return [*corners, (bottom, level)]


def _draw_row(body: Body, piece: Piece, far_start: Point, far_end: Point, columns: int, side: int) -> int:
    """One block from an outline's piece inwards to the points opposite its ends; tag of the outline's curve."""
    start, end, far_end, far_start = mirror([piece.start, piece.end, far_end, far_start], side)
    outline = body.curve(start, end, piece.cells, mirror([piece.centre], side)[0] if piece.centre else None)
    body.block(
        [start, end, far_end, far_start],
        [
            outline,
            body.curve(end, far_end, columns, growth=GROWTH),
            body.curve(far_end, far_start, piece.cells),
            -body.curve(start, far_start, columns, growth=GROWTH),
        ],
    )
    return outline


def _draw_root(body: Body, outline: list[Piece], columns: int, flanks: dict[str, list[int]], lobes: int) -> None:
    """The blade below the platform, from its outline to the axis of symmetry; adds its curves to ``flanks``."""
    levels = spread_levels(outline, outline[0].start[1], outline[-1].end[1])
    for side in (-1, 1):
        for piece, (upper, lower) in zip(outline, pairwise(levels), strict=True):
            curve = _draw_row(body, piece, (0.0, upper), (0.0, lower), columns, side)
            if piece.lobe:
                flanks.setdefault(name_flank(piece.lobe, lobes, side), []).append(curve)


def _draw_blade(
    body: Body,
    shank: Fillet,
    half_width: float,
    thickness: float,
    fillet: float,
    height: float,
    half_base: float,
    half_tip: float,
    columns: int,
    mesh_size: float,
) -> list[int]:
    """Platform and blade above ``shank``, the fillet below the platform; returns the curves of the tip."""
    platform = shank.start[1]
    top = platform + thickness
    tip = (half_tip, top + height)
    foot = round_corner(find_direction(tip, (half_base, top)), (half_base, top), (1.0, 0.0), fillet, FOOT_SHARE)
    arc, rows = max(2, count_cells(fillet, mesh_size)), max(2, count_cells(thickness, mesh_size))
    above = count_cells(height, BLADE_ASPECT * mesh_size)
    flat = count_cells(half_width - max(foot.end[0], shank.start[0]), mesh_size)
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
        for piece, (upper, lower) in zip(column, pairwise(levels), strict=True):
            _draw_row(body, piece, (0.0, upper), (0.0, lower), columns, side)
        upper = mirror([foot.split, foot.end, (half_width, top), foot.centre], side)
        lower = mirror([shank.split, shank.start, (half_width, platform), shank.centre], side)
        for k, cells, centres in ((0, arc, (upper[3], lower[3])), (1, flat, (None, None))):
            body.block(
                [upper[k], upper[k + 1], lower[k + 1], lower[k]],
                [
                    body.curve(upper[k], upper[k + 1], cells, centres[0]),
                    body.curve(upper[k + 1], lower[k + 1], rows),
                    body.curve(lower[k + 1], lower[k], cells, centres[1]),
                    body.curve(lower[k], upper[k], rows),
                ],
            )
        tips.append(body.curve((side * tip[0], tip[1]), (0.0, tip[1]), columns))
    return tips


def _draw_disk(
    body: Body,
    posts: list[Piece],
    bottom: Fillet,
    flanks: dict[str, list[int]],
    lobes: int,
    half_angle: float,
    hub_radius: float,
    rim_radius: float,
    mesh_size: float,
) -> tuple[list[int], list[int], list[int]]:
    """Both posts and the disk below the slot; adds to ``flanks``, returns the curves of the hub and both cuts."""
    centre, corner = (0.0, 0.0), bottom.split
    rim, hub = ((radius * sin(half_angle), radius * cos(half_angle)) for radius in (rim_radius, hub_radius))
    at_cut = lambda level: (level * tan(half_angle), level)  # noqa: E731
    # The three blocks that meet in the slot's corner share its angle about evenly.
    depth = corner[1] - (at_cut(corner[1])[0] - corner[0]) * CORNER_SLOPE
    levels = spread_levels(posts, rim[1], depth)
    columns = max(2, count_cells(at_cut(corner[1])[0] - corner[0], 1.6 * mesh_size))
    arc = count_cells(hypot(corner[0] - bottom.end[0], corner[1] - bottom.end[1]), mesh_size)
    middle = count_cells(bottom.end[0], mesh_size)
    rows = max(2, count_cells(bottom.end[1] - hub_radius, 2 * mesh_size))
    feet = [(hub_radius * sin(share * half_angle), hub_radius * cos(share * half_angle)) for share in HUB_SHARES]
    at_hub, cuts = [], {-1: [], 1: []}
    for side in (-1, 1):
        start, cut = mirror([posts[0].start, rim], side)
        body.curve(start, cut, columns, centre, GROWTH)  # the rim; the first row of the post finds it drawn
        for piece, (upper, lower) in zip(posts, pairwise(levels), strict=True):
            curve = _draw_row(body, piece, at_cut(upper), at_cut(lower), columns, side)
            cuts[side].append(body.curve(*mirror([at_cut(upper), at_cut(lower)], side), piece.cells))
            if piece.lobe:
                flanks.setdefault(name_flank(piece.lobe, lobes, side), []).append(curve)
        above = mirror([(0.0, bottom.end[1]), bottom.end, corner, at_cut(depth)], side)
        below = mirror([*feet, hub], side)
        arc_centre = mirror([bottom.centre], side)[0]
        for k, (cells, round_which) in enumerate(((middle, None), (arc, arc_centre), (columns, None))):
            growth = GROWTH if k == 2 else 1.0
            hub_curve = body.curve(below[k], below[k + 1], cells, centre, growth)
            outer = body.curve(above[k + 1], below[k + 1], rows, growth=GROWTH)
            body.block(
                [above[k], below[k], below[k + 1], above[k + 1]],
                [
                    body.curve(above[k], below[k], rows, growth=GROWTH),
                    hub_curve,
                    -outer,
                    -body.curve(above[k], above[k + 1], cells, round_which, growth),
                ],
            )
            at_hub.append(hub_curve)
        cuts[side].append(outer)
    return at_hub, cuts[-1], cuts[1]
