"""Pictures of a solid mesh, with its joint and loads, and of motions such as a mode: as of a plane one, seen askew.

The outer faces are gathered on rank 0, which draws; the other ranks only take part in the gathering. The box around
each drawing is measured, so that drawings of any shape fill the picture.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from itertools import product
from math import ceil
from pathlib import Path

import numpy as np
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize, to_rgb
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator
from mpl_toolkits.mplot3d import Axes3D, proj3d
from mpl_toolkits.mplot3d.art3d import Line3DCollection, Poly3DCollection

from ewr_fenicsx.given import RealArray
from ewr_fenicsx.output.gathering import Cells, gather_cells
from ewr_fenicsx.output.mesh_plots import (
    AT_REST,
    MESH_LINES,
    SIZES,
    caption_mesh,
    caption_motion,
    choose_body_colours,
    draw_loads,
    gather_edges,
    mark_held,
    mark_pairs,
    place_arrows,
    place_legend,
)
from ewr_fenicsx.output.plots import DPI, INK, in_own_style, put_title, save_picture
from ewr_fenicsx.structure.chain import Chain

ABOVE, ASIDE = 36.0, 26.0  # where the eye is, from the z direction upwards and towards x [degrees]
LIGHT = np.array([0.35, 0.85, 0.4])  # where it comes from
NEAR, NORMALS = 0.27, 0.09  # how far around the pairs faces are drawn, and length of normals, over the joint's extent
SIDE, FILLED = 6.0, 0.95  # of the square that a drawing is in [in], and how far it fills it
LEFT, GAP, TOP, BELOW, LINE = 0.9, 0.7, 0.8, 0.75, 0.18  # around and between drawings, and a line of a legend [in]
BAR = 1.1  # width that a colour bar takes [in]
TICKS = 7  # about as many numbers along the longest edge of a box


@in_own_style
def draw_mesh(path: Path, chain: Chain) -> None:
    """Mesh, clamp, loads and, enlarged, the joint's pairs on faces of body A, or all if sectors touch; collective."""
    cells, edge = gather_cells(chain), gather_edges(chain)
    if cells is None:
        return
    scene, interface = chain.scene, chain.interface
    figure, colours, arrows = Figure(), choose_body_colours(cells), place_arrows(scene, edge, cells)
    whole, joint = _add_axes(figure), _add_axes(figure)
    upright = replace(interface, position=stand(interface.position), position_b=stand(interface.position_b))
    _set_box(whole, cells.corners, *(arrow.reach for arrow in arrows.values()))
    fill_bodies(whole, cells, colours, opacity=0.6)
    mark_held(whole, scene, {name: stand(nodes) for name, nodes in edge.items()}, size=2)
    mark_pairs(whole, upright, size=1.5)
    draw_loads(whole, scene, arrows, lambda places: _project(whole, places))

    tag, extent = chain.mesh.bodies[scene.contact.body_a], np.ptp(interface.position, axis=0).max()
    shown = (cells.body == tag) | np.any(interface.is_next)  # where it is next, A is any body
    body = replace(cells, **{name: values[shown] for name, values in vars(cells).items()})
    low, high = interface.position.min(axis=0) - NEAR * extent, interface.position.max(axis=0) + NEAR * extent
    is_near = lambda places: np.all((low < places) & (places < high), axis=(1, 2))  # noqa: E731
    normals = np.stack([interface.position, interface.position + NORMALS * extent * interface.normal], axis=1)
    _set_box(joint, body.corners[is_near(body.corners)], normals)
    fill_bodies(joint, body, colours, opacity=0.35, is_shown=is_near)
    mark_pairs(joint, upright, size=4, labelled=True)
    draw_lines(joint, normals, colors=INK, linewidths=0.9, zorder=5)

    caption_mesh(figure, whole, joint, chain)
    _lay_out(figure, {whole: 3.0, joint: 5.5}, columns=(1, 3))
    save_picture(figure, path, dpi=DPI)


@in_own_style
def draw_motion(path: Path, cells: Cells | None, title: str) -> None:
    """A displaced shape, as ``gather_mode`` has it, over the undeformed outline; ranks without cells draw nothing."""
    if cells is None:
        return
    size, moved = np.linalg.norm(cells.values, axis=2), cells.corners + cells.values
    figure, colours = Figure(), ScalarMappable(Normalize(0.0, 1.0), SIZES)
    axes = _add_axes(figure)
    _set_box(axes, cells.corners, moved)
    draw_lines(axes, cells.outline(), colors=AT_REST, linewidths=0.8, linestyles="--", zorder=0.5)
    _draw_faces(axes, moved, facecolors=colours.to_rgba(size.mean(axis=1) / size.max()))
    _lay_out(figure, {axes: 3.5}, columns=(1,), beside=BAR)
    wide = 1 / figure.get_figwidth()
    caption_motion(figure, colours, title, cax=figure.add_axes((1 - BAR * wide, 0.2, 0.2 * wide, 0.6)))
    save_picture(figure, path, dpi=DPI)


def _add_axes(figure: Figure) -> Axes3D:
    """Axes in which what has a larger zorder is over the rest, and not what is nearer."""
    axes = figure.add_axes((0, 0, 1, 1), projection="3d", computed_zorder=False, proj_type="ortho", facecolor="none")
    axes.view_init(ABOVE, ASIDE)
    axes.set_axis_off()
    return axes


def stand(vectors: RealArray) -> RealArray:
    """The components z, x, y of vectors ``(..., 3)``: mplot3d's third axis is upright."""
    return np.roll(vectors, 1, axis=-1)


def _project(axes: Axes3D, places: RealArray) -> RealArray:
    """Where places ``(n, 3)`` [mm] are in the picture's plane, once the box of the axes is set."""
    return np.transpose(proj3d.proj_transform(*stand(places).T, axes.get_proj())[:2])


def _set_box(axes: Axes3D, *places: RealArray) -> None:
    """Limits around places ``(..., 3)`` [m], and numbers along them, with mm of one length in all directions."""
    every = 1e3 * np.concatenate([some.reshape(-1, 3) for some in places])
    low, high = every.min(axis=0), every.max(axis=0)
    axes.set(**dict(zip(("xlim", "ylim", "zlim"), stand(np.array([low, high])).T, strict=True)))
    axes.set_box_aspect(stand(high - low))
    axes.set_box_aspect(stand(high - low), zoom=FILLED / np.ptp(_measure_box(axes), axis=0).max())
    _draw_rulers(axes, low, high)


def _measure_box(axes: Axes3D) -> RealArray:
    """Lower left and upper right end of the box as it is drawn, over the sides of the axes, ``(2, 2)``."""
    corners = np.array(list(product(axes.get_ylim(), axes.get_zlim(), axes.get_xlim())))
    drawn = (axes.transData - axes.transAxes).transform(_project(axes, corners))
    return np.array([drawn.min(axis=0), drawn.max(axis=0)])


def _draw_rulers(axes: Axes3D, low: RealArray, high: RealArray) -> None:
    """Numbers [mm] along three edges of a box, beside it: mplot3d's own lie over each other where a box is slender."""
    runs = np.tile([[low[0], low[1], high[2]], [low[0], low[1], high[2]], [high[0], low[1], low[2]]], (2, 1, 1))
    for k in range(3):
        runs[:, k, k] = low[k], high[k]
    starts, ends = (_project(axes, run) for run in runs)
    lengths, centre = np.linalg.norm(ends - starts, axis=1), _project(axes, (low + high)[None] / 2)[0]
    for k, name in enumerate("xyz"):
        ticker = MaxNLocator(ceil(TICKS * lengths[k] / lengths.max()), steps=[1, 2, 5, 10])
        values = [value for value in ticker.tick_values(low[k], high[k]) if low[k] <= value <= high[k]]
        points = np.tile(runs[0, k], (len(values), 1))
        points[:, k] = values
        axes.plot(*stand(runs[:, k]).T, color=INK, linewidth=0.6)
        axes.plot(*stand(points).T, ".", color=INK, markersize=3)
        along, middle = (ends - starts)[k] / lengths[k], (starts + ends)[k] / 2
        outwards = np.array([along[1], -along[0]])
        outwards *= np.sign(outwards @ (middle - centre))
        slope = (np.degrees(np.arctan2(along[1], along[0])) + 89) % 180 - 89  # never upside down
        style = {"textcoords": "offset points", "ha": "center", "va": "center", "fontsize": 9, "annotation_clip": False}
        wide = 7 * abs(outwards[0])  # numbers are, more than high
        for value, place in zip(values, _project(axes, points), strict=True):
            axes.annotate(f"{value:g}".replace("-", "−"), place, (10 + wide) * outwards, **style)
        axes.annotate(f"{name} [mm]", middle, (27 + wide) * outwards, rotation=slope, **style)


def _draw_faces(axes: Axes3D, corners: RealArray, **style: object) -> None:
    axes.add_collection3d(
        Poly3DCollection(1e3 * stand(corners), edgecolors=MESH_LINES, linewidths=0.25, zorder=1, **style)
    )


def draw_lines(axes: Axes3D, lines: RealArray, **style: object) -> None:
    """Lines between places ``(n, 2, 3)`` [m]."""
    axes.add_collection3d(Line3DCollection(1e3 * stand(lines), **style))


def fill_bodies(
    axes: Axes3D,
    cells: Cells,
    colours: Mapping[int, str],
    opacity: float,
    is_shown: Callable[[RealArray], np.ndarray] = lambda places: slice(None),
) -> None:
    """Faces in the colour of their body, lighter towards the light, and the outline over them.

    Args:
        axes: Where to.
        cells: What there is.
        colours: Of the tag of each body.
        opacity: 0 to 1.
        is_shown: Which faces or edges are, by the places of their corners ``(n, k, 3)``.
    """
    lit = 0.8 + 0.2 * np.abs(cells.normals @ (LIGHT / np.linalg.norm(LIGHT)))
    own = np.array([to_rgb(colours[tag]) for tag in cells.body])
    faces = np.column_stack([own * lit[:, None], np.full(len(own), opacity)])
    shown, outline = is_shown(cells.corners), cells.outline()
    _draw_faces(axes, cells.corners[shown], facecolors=faces[shown])
    draw_lines(axes, outline[is_shown(outline)], colors=INK, linewidths=0.7, zorder=2)


def _lay_out(figure: Figure, panels: Mapping[Axes3D, float], columns: Sequence[int], beside: float = 0.0) -> None:
    """Puts drawings beside each other, with titles above and legends below.

    Args:
        figure: Which takes the size that they need.
        panels: Axes, and what widths [in] their titles and legends need.
        columns: Of each legend.
        beside: Room that is left on the right [in].
    """
    boxes = np.array([_measure_box(axes) for axes in panels])
    entries = [len(axes.get_legend_handles_labels()[1]) for axes in panels]
    sizes = SIDE * np.ptp(boxes, axis=1)
    widths, height = np.maximum(sizes[:, 0], list(panels.values())), sizes[:, 1].max()
    below = BELOW + LINE * max(ceil(some / n) for some, n in zip(entries, columns, strict=True))
    total = np.array([LEFT + np.sum(widths + GAP) + beside, TOP + height + below])
    figure.set_size_inches(total)
    for title in figure.texts:
        put_title(figure, title.get_text())
    places = LEFT + np.cumsum(widths + GAP) - GAP - widths / 2
    for axes, place, middle, some, n in zip(panels, places, boxes.mean(axis=1), entries, columns, strict=True):
        corner = np.array([place, below + height / 2]) - SIDE * middle
        axes.set_position([*corner / total, *SIDE / total])
        top = middle[1] + height / SIDE / 2
        axes.set_title(axes.get_title(), y=top).set_y(top)  # of what it is given mplot3d takes 92 %
        if some:
            place_legend(axes, n, bottom=middle[1] - height / SIDE / 2)
