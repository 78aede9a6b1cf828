"""Pictures of a plane mesh, with its joint and loads, and of motions such as the first full-stick mode.

The mesh is gathered on rank 0, which draws; the other ranks only take part in the gathering. What these pictures have
in common with those of solids (``solid_plots.py``) is in public functions, for two and three dimensions.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from itertools import cycle
from pathlib import Path

import dolfinx
import numpy as np
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.collections import LineCollection, PolyCollection
from matplotlib.figure import Figure
from matplotlib.transforms import ScaledTranslation
from matplotlib.tri import Triangulation
from scipy.spatial import cKDTree

from ewr_fenicsx.given import RealArray
from ewr_fenicsx.output.gathering import Cells, gather_boundary, gather_cells
from ewr_fenicsx.output.plots import DPI, FLANK_COLOURS, INK, in_own_style, put_title, save_picture
from ewr_fenicsx.scene.scene import Scene
from ewr_fenicsx.structure.chain import Chain
from ewr_fenicsx.structure.interface import Interface

WIDE, LOWEST = 2.0, 0.2  # from which width over height panels are stacked; least height over width of a panel
LONGEST_ARROW, SHORTEST = 0.12, 0.4  # over the mesh's largest extent; of tiny forces, over the longest
LARGEST_MOTION = 0.08  # of a mode as it is drawn, over the mesh's largest extent
MESH_LINES, AT_REST, SIZES = "#8a97a5", "#999999", "YlGnBu"  # the last is the colour map of displacements
BODY_COLOURS = ("#dbe7f3", "#f3e6d3", "#e0eedd", "#eee0ee")


@in_own_style
def draw_mesh(path: Path, chain: Chain) -> None:
    """Mesh, clamp, loads and, enlarged, the joint's pairs; collective."""
    cells, edge = gather_cells(chain), gather_edges(chain)
    if cells is None:
        return
    scene, interface = chain.scene, chain.interface
    figure, whole, joint = _lay_panels(cells, interface)
    for axes in (whole, joint):
        _fill_bodies(axes, cells, linewidth=0.25 if axes is whole else 0.5)
        axes.add_collection(LineCollection(1e3 * cells.outline(), colors=INK, linewidths=0.9))
        axes.set_aspect("equal")
        axes.set_xlabel("x [mm]")
        axes.set_ylabel("y [mm]")
    mark_held(whole, scene, edge, size=3)
    arrows = place_arrows(scene, edge, cells)
    for arrow in arrows.values():
        whole.plot(*1e3 * arrow.reach.T, alpha=0)  # makes room for it
    draw_loads(whole, scene, arrows)
    mark_pairs(whole, interface, size=2)
    mark_pairs(joint, interface, size=6, labelled=True)
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
    whole.indicate_inset(joint.viewLim.bounds, edgecolor=INK, alpha=0.6)  # no lines to it: they would cross the labels
    caption_mesh(figure, whole, joint, chain)
    place_legend(whole, columns=1 if whole.get_gridspec().ncols > 1 else 3)
    place_legend(joint, columns=3)
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


@in_own_style
def draw_motion(path: Path, cells: Cells | None, title: str) -> None:
    """A displaced shape, as ``gather_mode`` has it, over the undeformed outline; ranks without cells draw nothing."""
    if cells is None:
        return
    size = np.linalg.norm(cells.values, axis=2)
    width, height = np.ptp(cells.corners.reshape(-1, 2), axis=0)
    figure = Figure(figsize=(2.3 + 6.6 * min(1.5, width / height), 7.5), layout="constrained")
    axes = figure.subplots()
    axes.add_collection(LineCollection(1e3 * cells.outline(), colors=AT_REST, linewidths=0.8, linestyles="--"))
    moved = 1e3 * (cells.corners + cells.values).reshape(-1, 2)
    n = cells.corners.shape[1]
    first = n * np.arange(len(cells.body))[:, None]
    triangles = np.concatenate([first + np.array([0, k, k + 1]) for k in range(1, n - 1)])
    colours = axes.tripcolor(
        Triangulation(*moved.T, triangles), size.ravel() / size.max(), shading="gouraud", cmap=SIZES
    )
    axes.add_collection(LineCollection(1e3 * cells.outline(1.0), colors=INK, linewidths=0.9))
    axes.autoscale_view()
    axes.set_aspect("equal")
    axes.set(xlabel="x [mm]", ylabel="y [mm]")
    caption_motion(figure, colours, title, ax=axes, shrink=0.7)
    save_picture(figure, path, dpi=DPI)


def _fill_bodies(axes, cells: Cells, linewidth: float) -> None:
    for body, colour in choose_body_colours(cells).items():
        polygons = 1e3 * cells.corners[cells.body == body]
        axes.add_collection(PolyCollection(polygons, facecolors=colour, edgecolors=MESH_LINES, linewidths=linewidth))


def choose_body_colours(cells: Cells) -> dict[int, str]:
    """A colour for the tag of each body."""
    return dict(zip(np.unique(cells.body).tolist(), cycle(BODY_COLOURS), strict=False))


def gather_edges(chain: Chain) -> dict[str, RealArray | None]:
    """Nodes of the boundaries that are held, cut or loaded by a force, on rank 0; collective."""
    scene = chain.scene
    loaded = (load.boundary for load in scene.loads.values() if load.kind == "force")
    cuts = scene.cyclic.cuts if scene.cyclic else ()
    return {name: gather_boundary(chain, name) for name in sorted({*scene.supports.boundaries, *cuts, *loaded})}


def gather_mode(chain: Chain) -> Cells | None:
    """What is drawn of the mesh, with the first full-stick mode, as large as it is drawn, on rank 0; collective."""
    shape = dolfinx.fem.Function(chain.structure.space)
    owned = chain.reduction.full_stick.vectors[0].array
    shape.x.array[: owned.size] = owned
    shape.x.scatter_forward()
    cells = gather_cells(chain, shape)
    return cells if cells is None else replace(cells, values=stretch(cells))


def stretch(cells: Cells) -> RealArray:
    """Displacements at the corners, as large as they are drawn."""
    return LARGEST_MOTION * cells.scale / np.linalg.norm(cells.values, axis=2).max() * cells.values


def tell_mode(chain: Chain) -> str:
    """What the picture of the first full-stick mode shows."""
    return f"full-stick mode 1{chain.reduction.model.tell_wave()}: {chain.reduction.full_stick.frequency[0]:.1f} Hz"


def caption_mesh(figure: Figure, whole: Axes, joint: Axes, chain: Chain) -> None:
    """Titles of the figure and of its panels, and the legend's entry for the normals."""
    scene, interface = chain.scene, chain.interface
    whole.set_title(f"{chain.structure.space.dofmap.index_map.size_global} nodes, {chain.mesh.cells} cells")
    gaps = [scene.laws_on(flank).initial_gap for flank in interface.flanks]
    left_out = [name for name, some in (("initial gaps", max(gaps) > 0), ("interference", min(gaps) < 0)) if some]
    without = f", drawn without {' and '.join(left_out)}" if left_out else ""
    joint.set_title(f"joint: {len(interface.area)} pairs{without}")
    of_sector = ", or of the sector" if np.any(interface.is_next) else ""
    joint.plot([], [], color=INK, linewidth=1.2, label=f"outward normal of the {scene.contact.body_a}{of_sector}")
    figure.suptitle(scene.title or scene.geometry.source.stem)


def caption_motion(figure: Figure, colours: ScalarMappable, title: str, **place: object) -> None:
    """Title and colour bar of a displaced shape, the bar placed as ``Figure.colorbar`` lets one."""
    put_title(figure, title)
    figure.colorbar(colours, label="displacement / its largest value", **place)


def place_legend(axes: Axes, columns: int, bottom: float = 0.0) -> None:
    """The legend below numbers and label, however low the panel is; ``bottom`` of what it shows, over its height."""
    axes.legend(
        loc="upper center",
        bbox_to_anchor=(0.5, bottom),
        bbox_transform=axes.transAxes + ScaledTranslation(0, -0.55, axes.figure.dpi_scale_trans),
        fontsize=8,
        facecolor="white",
        edgecolor="none",
        ncols=columns,
    )


def mark_held(axes: Axes, scene: Scene, edge: Mapping[str, RealArray], size: float) -> None:
    """A triangle for each node that is held, a cross where it is along some axes only, a dot on the cuts of a ring."""
    supports = scene.supports
    for cut, neighbour in zip(
        scene.cyclic.cuts if scene.cyclic else (), ("sector before", "next sector"), strict=False
    ):
        axes.plot(*(1e3 * edge[cut].T), ".", color=AT_REST, markersize=size, label=f"cut to the {neighbour}: {cut}")
    for name in supports.boundaries:
        mark, along = ("^", "") if name in supports.clamp else ("x", f" along {' and '.join(supports.hold[name])}")
        axes.plot(*(1e3 * edge[name].T), mark, color=INK, markersize=size, label=f"held{along}: {name}")


def mark_pairs(axes: Axes, interface: Interface, size: float, labelled: bool = False) -> None:
    """A dot for each pair, in the colour of its flank; unless labelled, rings where the sector before touches."""
    for k, flank in enumerate(interface.flanks):
        mine = interface.flank_of_pair == k
        colour = FLANK_COLOURS[k % len(FLANK_COLOURS)]
        label = f"{flank}, {mine.sum()} pairs" if labelled else None
        axes.plot(*(1e3 * interface.position[mine].T), "o", color=colour, markersize=size, label=label, zorder=4)
        if not labelled and len(touched := interface.position_b[mine & interface.is_next]):
            style = {"color": colour, "fillstyle": "none", "markersize": 2 * size, "markeredgewidth": 0.8}
            axes.plot(*(1e3 * touched.T), "o", label=f"side of {flank} to the sector before", zorder=4, **style)


@dataclass(frozen=True)
class Arrow:
    """A force in a picture.

    Attributes:
        tail: Where it begins, ``(d,)`` [m].
        head: Where it ends.
        colour: Its own.
        share: Of the largest force that oscillates, or does not, as this one.
        pulsating: Whether it oscillates, and goes both ways.
    """

    tail: RealArray
    head: RealArray
    colour: str
    share: float
    pulsating: bool

    @property
    def reach(self) -> RealArray:
        """Ends of the place that it takes, ``(2, d)`` [m]."""
        return np.array([self.tail, self.head + 0.1 * (self.head - self.tail)])


def place_arrows(scene: Scene, edge: Mapping[str, RealArray], cells: Cells) -> dict[str, Arrow]:
    """An arrow a force: from its boundary, or up to it where the force presses on the body.

    Of the static forces the largest has the longest arrow, and so has the largest of those that oscillate.
    """
    forces = {name: load for name, load in scene.loads.items() if load.kind == "force"}
    sizes = {name: float(np.linalg.norm(load.force)) for name, load in forces.items()}
    colours = _choose_colours({name: load.harmonic > 0 for name, load in forces.items()})
    arrows = {}
    for name, load in forces.items():
        start, pulsating = edge[load.boundary].mean(axis=0), load.harmonic > 0
        share = sizes[name] / max(sizes[other] for other in forces if (forces[other].harmonic > 0) == pulsating)
        length = LONGEST_ARROW * cells.scale * (SHORTEST + (1 - SHORTEST) * share)
        step = length * np.array(load.force) / sizes[name]
        presses = not pulsating and np.dot(step, _point_inwards(edge[load.boundary], cells)) > 0.5 * length
        tail, head = (start - step, start) if presses else (start - step if pulsating else start, start + step)
        arrows[name] = Arrow(tail, head, colours[name], share, pulsating)
    return arrows


def draw_loads(
    axes: Axes,
    scene: Scene,
    arrows: Mapping[str, Arrow],
    project: Callable[[RealArray], RealArray] = lambda places: places,
) -> None:
    """Draws the arrows, and tells what all loads are.

    Args:
        axes: Where to.
        scene: With the loads.
        arrows: Of its forces.
        project: From places ``(n, d)`` [mm] to the picture's plane, ``(n, 2)``.
    """
    for name, load in scene.loads.items():
        if load.kind != "force":
            axes.plot([], [], " ", label=f"{name}: {load.speed:g} rpm")
            continue
        arrow = arrows[name]
        tail, head = project(1e3 * np.array([arrow.tail, arrow.head]))
        axes.annotate(
            "",
            head,
            tail,
            annotation_clip=False,
            # on one line: static ones over those that go both ways, then short ones over long ones
            zorder=(3.0 if arrow.pulsating else 3.5) - 0.4 * arrow.share,
            arrowprops={
                "arrowstyle": "<|-|>" if arrow.pulsating else "-|>",
                "color": arrow.colour,
                "linewidth": 1.8,
                "shrinkA": 0,
                "shrinkB": 0,
            },
        )
        time = f" at {_say_frequency(scene, load.harmonic)} Hz" if arrow.pulsating else ", static"
        size = np.linalg.norm(load.force)
        axes.plot([], [], color=arrow.colour, linewidth=1.8, label=f"{name}: {size:.4g} N{time}")


def _choose_colours(pulsating: Mapping[str, bool]) -> dict[str, str]:
    """A colour for each force: red for the first that oscillates, blue for the first that is static."""
    first = [next((name for name, does in pulsating.items() if does == kind), None) for kind in (True, False)]
    others = [name for name in pulsating if name not in first]
    return dict(zip(first, FLANK_COLOURS, strict=False)) | dict(zip(others, cycle(FLANK_COLOURS[2:]), strict=False))


def _point_inwards(edge: RealArray, cells: Cells) -> RealArray:
    """Unit vector ``(d,)`` away from a boundary, into the cells or along the faces beside it."""
    corners = cells.corners.reshape(-1, edge.shape[1])
    near = cKDTree(edge).query(corners)[0].reshape(cells.corners.shape[:2]) < 1e-6 * cells.scale
    along = near.sum(axis=1) >= 2
    corners, near = cells.corners[along], near[along]
    steps = corners.mean(axis=1) - np.einsum("nkd,nk->nd", corners, near / near.sum(axis=1, keepdims=True))
    inwards = steps.sum(axis=0)
    return inwards / max(np.linalg.norm(inwards), 1e-300)


def _say_frequency(scene: Scene, harmonic: int) -> str:
    ends = sorted({min(scene.frequencies), max(scene.frequencies)})
    return " to ".join(f"{harmonic * end:g}" for end in ends)
