"""Pictures of the mesh: with its joint and loads, and the first full-stick mode.

The mesh is gathered on rank 0, which draws; the other ranks only take part in the gathering.
"""

from __future__ import annotations

from collections.abc import Mapping
from itertools import cycle
from pathlib import Path

import dolfinx
import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection, PolyCollection
from matplotlib.figure import Figure
from matplotlib.transforms import ScaledTranslation
from matplotlib.tri import Triangulation
from scipy.spatial import cKDTree

from ewr_fenicsx.given import RealArray
from ewr_fenicsx.output.gathering import Cells, gather_boundary, gather_cells
from ewr_fenicsx.output.plots import DPI, FLANK_COLOURS, INK, save_picture
from ewr_fenicsx.scene.scene import Scene
from ewr_fenicsx.structure.chain import Chain
from ewr_fenicsx.structure.interface import Interface

WIDE, LOWEST = 2.0, 0.2  # from which width over height panels are stacked; least height over width of a panel
LONGEST_ARROW, SHORTEST = 0.12, 0.4  # over the mesh's largest extent; of tiny forces, over the longest
BODY_COLOURS = ("#dbe7f3", "#f3e6d3", "#e0eedd", "#eee0ee")


def draw_mesh(path: Path, chain: Chain) -> None:
    """Mesh, clamp, loads and, enlarged, the joint's pairs; collective."""
    cells = gather_cells(chain)
    scene = chain.scene
    edges = sorted({*scene.supports.clamp, *(load.boundary for load in scene.loads.values() if load.kind == "force")})
    edge = {name: gather_boundary(chain, name) for name in edges}
    if cells is None:
        return
    interface = chain.interface
    figure, whole, joint = _lay_panels(cells, interface)
    for axes in (whole, joint):
        _fill_bodies(axes, cells, linewidth=0.25 if axes is whole else 0.5)
        axes.add_collection(LineCollection(1e3 * cells.outline(), colors=INK, linewidths=0.9))
        axes.set_aspect("equal")
        axes.set_xlabel("x [mm]")
        axes.set_ylabel("y [mm]")
    for name in scene.supports.clamp:
        whole.plot(*(1e3 * edge[name].T), "^", color=INK, markersize=3, label=f"held: {name}")
    _draw_loads(whole, scene, edge, cells)
    for k, flank in enumerate(interface.flanks):
        mine = interface.flank_of_pair == k
        colour = FLANK_COLOURS[k % len(FLANK_COLOURS)]
        for axes, size in ((whole, 2), (joint, 6)):
            label = f"{flank}, {mine.sum()} pairs" if axes is joint else None
            axes.plot(*(1e3 * interface.position[mine].T), "o", color=colour, markersize=size, label=label, zorder=4)
    whole.update_datalim(np.transpose([joint.get_xlim(), joint.get_ylim()]))  # its frame lies within
    whole.autoscale_view()
    middle, spare = np.mean(whole.get_ylim()), LOWEST * np.ptp(whole.get_xlim()) / 2
    if spare > np.ptp(whole.get_ylim()) / 2:
        whole.set_ylim(middle - spare, middle + spare)
    length = 0.11 * 1e3 * np.ptp(interface.position, axis=0).max()
    joint.quiver(
        *(1e3 * interface.position.T),
        *(length * interface.normal.T),
        angles="xy",
        scale_units="xy",
        scale=1,
        width=0.0025,
        color=INK,
        zorder=5,
    )
    joint.plot([], [], color=INK, linewidth=1.2, label=f"outward normal of the {scene.contact.body_a}")
    whole.indicate_inset(joint.viewLim.bounds, edgecolor=INK, alpha=0.6)  # no lines to it: they would cross the labels
    closed = any(scene.laws_on(flank).initial_gap for flank in interface.flanks)
    joint.set_title(f"joint: {len(interface.area)} pairs" + closed * ", drawn without initial gaps")
    whole.set_title(f"{chain.structure.space.dofmap.index_map.size_global} nodes, {len(cells.body)} cells")
    below = ScaledTranslation(0, -0.55, figure.dpi_scale_trans)  # of numbers and label, however low the panel is
    for axes in (whole, joint):
        axes.legend(
            loc="upper center",
            bbox_to_anchor=(0.5, 0.0),
            bbox_transform=axes.transAxes + below,
            fontsize=8,
            facecolor="white",
            edgecolor="none",
            ncols=1 if axes is whole and whole.get_gridspec().ncols > 1 else 3,
        )
    figure.suptitle(scene.title or scene.geometry.source.stem)
    save_picture(figure, path, dpi=DPI, bbox_inches="tight", pad_inches=0.1)  # labels hang over narrow panels


def _lay_panels(cells: Cells, interface: Interface) -> tuple[Figure, Axes, Axes]:
    """Panels for all of the mesh and for the joint, enlarged: side by side, or one above the other where it is wide."""
    low, high = 1e3 * interface.position.min(axis=0), 1e3 * interface.position.max(axis=0)
    width, height = np.ptp(cells.corners.reshape(-1, 2), axis=0)
    half = 0.62 * (high - low).max() * np.array([1.0, 1.15])
    if width > WIDE * height:
        half[1] = max(0.5 * (high - low)[1] + 0.12 * (high - low).max(), 0.31 * (high - low)[0])  # room for normals
        half[0] = max(0.62 * (high - low)[0], 1.6 * half[1])
        heights = 2.2 + 9.5 * max(LOWEST, height / width), 1.2 + 9.5 * half[1] / half[0]
        figure = Figure(figsize=(11, sum(heights)), layout="constrained")
        whole, joint = figure.subplots(2, 1, gridspec_kw={"height_ratios": heights})
    else:
        figure = Figure(figsize=(11, 8), layout="constrained")
        whole, joint = figure.subplots(1, 2, gridspec_kw={"width_ratios": [1, 1.9]})
    for set_limits, middle, side in zip((joint.set_xlim, joint.set_ylim), (low + high) / 2, half, strict=True):
        set_limits(middle - side, middle + side)
    return figure, whole, joint


def draw_mode(path: Path, chain: Chain) -> None:
    """Shape of the first full-stick mode, over the undeformed outline; collective."""
    modes = chain.reduction.full_stick
    shape = dolfinx.fem.Function(chain.structure.space)
    owned = modes.vectors[0].array
    shape.x.array[: owned.size] = owned
    shape.x.scatter_forward()
    cells = gather_cells(chain, shape)
    if cells is None:
        return
    size = np.linalg.norm(cells.values, axis=2)
    stretch = 0.08 * cells.scale / size.max()
    width, height = np.ptp(cells.corners.reshape(-1, 2), axis=0)
    figure = Figure(figsize=(2.3 + 6.6 * min(1.5, width / height), 7.5), layout="constrained")
    axes = figure.subplots()
    axes.add_collection(LineCollection(1e3 * cells.outline(), colors="#999999", linewidths=0.8, linestyles="--"))
    moved = 1e3 * (cells.corners + stretch * cells.values).reshape(-1, 2)
    n = cells.corners.shape[1]
    first = n * np.arange(len(cells.body))[:, None]
    triangles = np.concatenate([first + np.array([0, k, k + 1]) for k in range(1, n - 1)])
    colours = axes.tripcolor(
        Triangulation(*moved.T, triangles), size.ravel() / size.max(), shading="gouraud", cmap="YlGnBu"
    )
    axes.add_collection(LineCollection(1e3 * cells.outline(stretch), colors=INK, linewidths=0.9))
    axes.autoscale_view()
    axes.set_aspect("equal")
    axes.set(xlabel="x [mm]", ylabel="y [mm]")
    figure.suptitle(f"full-stick mode 1: {modes.frequency[0]:.1f} Hz")
    figure.colorbar(colours, ax=axes, label="displacement / its largest value", shrink=0.7)
    save_picture(figure, path, dpi=DPI)


def _fill_bodies(axes, cells: Cells, linewidth: float) -> None:
    for k, body in enumerate(np.unique(cells.body)):
        polygons = 1e3 * cells.corners[cells.body == body]
        colour = BODY_COLOURS[k % len(BODY_COLOURS)]
        axes.add_collection(PolyCollection(polygons, facecolors=colour, edgecolors="#8a97a5", linewidths=linewidth))


def _draw_loads(axes: Axes, scene: Scene, edge: dict[str, RealArray], cells: Cells) -> None:
    """An arrow a force: from its boundary, or up to it where the force presses on the body.

    Of the static forces the largest has the longest arrow, and so has the largest of those that oscillate.
    """
    forces = {name: load for name, load in scene.loads.items() if load.kind == "force"}
    sizes = {name: float(np.hypot(*load.force)) for name, load in forces.items()}
    colours = _choose_colours({name: load.harmonic > 0 for name, load in forces.items()})
    for name, load in scene.loads.items():
        if load.kind != "force":
            axes.plot([], [], " ", label=f"{name}: {load.speed:g} rpm")
            continue
        start = 1e3 * edge[load.boundary].mean(axis=0)
        size, colour, pulsating = sizes[name], colours[name], load.harmonic > 0
        largest = max(sizes[other] for other in forces if (forces[other].harmonic > 0) == pulsating)
        length = LONGEST_ARROW * 1e3 * cells.scale * (SHORTEST + (1 - SHORTEST) * size / largest)
        step = length * np.array(load.force) / size
        presses = not pulsating and np.dot(step, _point_inwards(edge[load.boundary], cells)) > 0.5 * length
        tail, head = (start - step, start) if presses else (start - step if pulsating else start, start + step)
        axes.annotate(
            "",
            head,
            tail,
            annotation_clip=False,
            # on one line: static ones over those that go both ways, then short ones over long ones
            zorder=(3.0 if pulsating else 3.5) - 0.4 * size / largest,
            arrowprops={
                "arrowstyle": "<|-|>" if pulsating else "-|>",
                "color": colour,
                "linewidth": 1.8,
                "shrinkA": 0,
                "shrinkB": 0,
            },
        )
        axes.plot(*np.transpose([tail, head + 0.1 * (head - tail)]), alpha=0)  # makes room for the arrow
        time = f" at {_say_frequency(scene, load.harmonic)} Hz" if pulsating else ", static"
        axes.plot([], [], color=colour, linewidth=1.8, label=f"{name}: {size:.4g} N{time}")


def _choose_colours(pulsating: Mapping[str, bool]) -> dict[str, str]:
    """A colour for each force: red for the first that oscillates, blue for the first that is static."""
    first = [next((name for name, does in pulsating.items() if does == kind), None) for kind in (True, False)]
    others = [name for name in pulsating if name not in first]
    return dict(zip(first, FLANK_COLOURS, strict=False)) | dict(zip(others, cycle(FLANK_COLOURS[2:]), strict=False))


def _point_inwards(edge: RealArray, cells: Cells) -> RealArray:
    """Unit vector ``(2,)`` from a boundary to the middle of the cells along it."""
    near = cKDTree(edge).query(cells.corners.reshape(-1, 2))[0].reshape(cells.corners.shape[:2]) < 1e-6 * cells.scale
    along = near.sum(axis=1) >= 2
    inwards = cells.corners[along].mean(axis=(0, 1)) - edge.mean(axis=0)
    return inwards / max(np.linalg.norm(inwards), 1e-300)


def _say_frequency(scene: Scene, harmonic: int) -> str:
    ends = sorted({min(scene.frequencies), max(scene.frequencies)})
    return " to ".join(f"{harmonic * end:g}" for end in ends)
