"""Outlines of lines and fillets in the plane, cut into the pieces along which blocks lie. Lengths in m."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from math import atan2, cos, hypot, sin, sqrt

from blocks import Point


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


def follow_outline(
    vertices: Sequence[Point], fillet: float, pairs: int, mesh_size: float, slide: float, slide_at_start: bool
) -> list[Piece]:
    """Pieces of an outline with rounded corners, from the top down.

    Args:
        vertices: Top, neck, lobe, neck, ..., lobe, bottom; all but the first and the last are rounded [m].
        fillet: Radius of the corners [m].
        pairs: Nodes on a contact flank.
        mesh_size: Size of the cells elsewhere [m].
        slide: Length of every flank that has no opposite [m].
        slide_at_start: It lies at the flank's upper end (the blade's neck), not at the lower end (the disk's groove).
    """
    directions = [find_direction(a, b) for a, b in pairwise(vertices)]
    rounded = [
        round_corner(before, corner, after, fillet)
        for (before, after), corner in zip(pairwise(directions), vertices[1:-1], strict=True)
    ]
    pieces, start = [], vertices[0]
    for k, direction in enumerate(directions):
        end = rounded[k].start if k < len(rounded) else vertices[-1]
        contact = Piece(start, end, None, pairs - 1, k // 2 + 1)
        if k % 2 == 0:  # a wall or the underside of a lobe
            pieces.append(Piece(start, end, None, count_cells(hypot(end[0] - start[0], end[1] - start[1]), mesh_size)))
        elif slide_at_start:
            joint = step_along(start, direction, slide)
            pieces += [Piece(start, joint, None, 1), replace(contact, start=joint)]
        else:
            joint = step_along(end, direction, -slide)
            pieces += [replace(contact, end=joint), Piece(joint, end, None, 1)]
        if k < len(rounded):
            arc = rounded[k]
            chord = hypot(arc.end[0] - arc.start[0], arc.end[1] - arc.start[1])
            pieces.append(Piece(arc.start, arc.end, arc.centre, max(2, count_cells(chord, mesh_size / 1.5))))
            start = arc.end
    return pieces


def spread_levels(outline: Sequence[Piece], top: float, bottom: float) -> list[float]:
    """Levels opposite the ends of an outline's pieces: their own height, bent towards ``top`` and ``bottom`` [m].

    The cubic keeps the mesh lines level, and so well inclined to flat flanks, but for the first and the last few.
    """
    first, last = outline[0].start[1], outline[-1].end[1]
    levels = [top]
    for piece in outline:
        below = (first - piece.end[1]) / (first - last)
        levels.append(piece.end[1] + (top - first) * (1 - below) ** 3 + (bottom - last) * below**3)
    return levels


def round_corner(before: Point, corner: Point, after: Point, radius: float, share: float = 0.5) -> Fillet:
    """Round the corner between two unit directions; a block boundary may meet the arc after ``share`` of it."""
    cut = measure_tangent(before, after, radius)
    start, end = step_along(corner, before, -cut), step_along(corner, after, cut)
    left = before[0] * after[1] - before[1] * after[0] > 0
    centre = step_along(start, (-before[1], before[0]) if left else (before[1], -before[0]), radius)
    turned = share * 2 * atan2(cut, radius) * (1 if left else -1)
    spoke = (start[0] - centre[0], start[1] - centre[1])
    split = (
        centre[0] + cos(turned) * spoke[0] - sin(turned) * spoke[1],
        centre[1] + sin(turned) * spoke[0] + cos(turned) * spoke[1],
    )
    return Fillet(start, split, end, centre)


def measure_tangent(before: Point, after: Point, radius: float) -> float:
    """Distance from a corner to where its fillet touches, for unit directions before and after it [m]."""
    cosine = before[0] * after[0] + before[1] * after[1]
    return radius * sqrt((1 - cosine) / (1 + cosine))


def find_direction(start: Point, end: Point) -> Point:
    """Unit vector from one point to another."""
    length = hypot(end[0] - start[0], end[1] - start[1])
    return (end[0] - start[0]) / length, (end[1] - start[1]) / length


def step_along(start: Point, direction: Point, distance: float) -> Point:
    """The point at a distance from ``start`` [m]."""
    return start[0] + distance * direction[0], start[1] + distance * direction[1]


def count_cells(length: float, mesh_size: float) -> int:
    """Cells of about ``mesh_size`` that fill a length, at least one."""
    return max(1, round(length / mesh_size))
