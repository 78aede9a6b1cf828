# %% [markdown]
# # The gallery
# Solves every scene of this folder and draws one picture of each for `docs/gallery.md`, which this script writes as
# well: on the left the joint at the instant of its largest motion, on the right what its contact does over the period,
# over frequencies or over cycles. With `blade_root` it draws the mesh at the top of the README as well.

# %%
import argparse
from dataclasses import replace
from pathlib import Path

import numpy as np
from matplotlib.collections import LineCollection, PolyCollection
from matplotlib.colors import ListedColormap
from matplotlib.figure import Figure
from matplotlib.patches import Patch
from matplotlib.transforms import ScaledTranslation

from ewr_fenicsx import load_scene
from ewr_fenicsx.output.gathering import gather_cells
from ewr_fenicsx.output.mesh_plots import AT_REST, BODY_COLOURS, choose_body_colours, draw_mesh
from ewr_fenicsx.output.plots import FLANK_COLOURS, INK
from ewr_fenicsx.output.ring_plots import gather_ring
from ewr_fenicsx.output.solid_plots import draw_lines, fill_bodies, stand
from ewr_fenicsx.runs.study import run_study
from ewr_fenicsx.scene.effects import list_effects
from ewr_fenicsx.solution.contact_state import classify_contact
from ewr_fenicsx.structure.chain import build_chain, pose_problem

HERE = Path(__file__).parent
DOCS = HERE.parent / "docs"
SCENES = (
    "friction_damped_beam",
    "two_blocks",
    "dovetail",
    "blade_root",
    "platform_damper",
    "bolted_lap",
    "tapping_rod",
    "broached_dovetail",
    "twisted_blade",
    "bladed_disk",
    "damped_ring",
    "shrouded_ring",
)
IN_README = "blade_root"  # its mesh.png, as `ewr run` draws it
STATES = {"open": "#ffffff", "stick": "#1d6fb8", "slip": "#e08e0b"}
SAMPLES = 256


# %%
def find_largest_motion(chain, solution, with_mean=False):
    """Displacements of the nodes at the instant when they are largest, cells with them, and what to magnify them by."""
    phase = np.exp(2j * np.pi * np.outer(np.arange(SAMPLES), solution.orders) / SAMPLES)
    shown = np.array(solution.orders)[:, None] > (-1 if with_mean else 0)
    frames = (phase @ np.where(shown, solution.coordinates, 0)).real
    field = chain.reduction.expand(frames[int(np.linalg.norm(frames, axis=1).argmax())])
    cells = gather_cells(chain, field)
    stretch = 0.06 * cells.scale / max(np.linalg.norm(cells.values, axis=2).max(), 1e-300)
    return field.x.array.reshape(-1, chain.mesh.dimension), cells, stretch


def draw_solid_motion(axes, chain, solution):
    """As ``draw_motion``, of solids that touch at rest: outer faces from above and aside, pairs seen through them."""
    moved, cells, stretch = find_largest_motion(chain, solution)
    corners, interface = cells.corners + stretch * cells.values, chain.interface
    draw_lines(axes, cells.outline(), colors=AT_REST, linewidths=0.6, linestyles="--", zorder=2)
    fill_bodies(axes, replace(cells, corners=corners), choose_body_colours(cells), opacity=0.7)
    places = 1e3 * stand(interface.position + stretch * moved[interface.nodes_a]).T
    axes.plot(*places, ".", color=FLANK_COLOURS[0], markersize=2.5, zorder=3, label="nodes of the contact pairs")
    low, high = (1e3 * stand(limit(corners.reshape(-1, 3), axis=0)) for limit in (np.min, np.max))
    axes.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), zlim=(low[2], high[2]))
    axes.set_box_aspect(high - low, zoom=1.05)
    axes.view_init(30, 28)
    axes.set_axis_off()
    axes.legend(loc="upper center", bbox_to_anchor=(0.5, 0.0), fontsize=7, markerscale=3)
    axes.set_title(f"motion, magnified {stretch:.0f} times")


def draw_motion(axes, chain, solution):
    """The bodies at the instant of their largest motion, magnified as their initial gap is; nodes of pairs in red.

    Meshes are drawn closed. Where there is an initial gap, the second body is moved back by it, and the motion is drawn
    with its mean: bodies would else be in each other. Otherwise the mean, of static loads, is left out.
    """
    interface = chain.interface
    gap = np.array([chain.scene.laws_on(flank).initial_gap for flank in interface.flanks])[interface.flank_of_pair]
    moved, cells, stretch = find_largest_motion(chain, solution, with_mean=gap.any())
    apart = np.linalg.lstsq(interface.normal, gap, rcond=None)[0]
    second = cells.body == chain.mesh.bodies[chain.scene.contact.body_b]
    cells = replace(cells, corners=cells.corners + stretch * np.where(second[:, None, None], apart, 0))
    corners = 1e3 * (cells.corners + stretch * cells.values)
    for k, body in enumerate(np.unique(cells.body)):
        axes.add_collection(PolyCollection(corners[cells.body == body], facecolors=BODY_COLOURS[k % len(BODY_COLOURS)]))
    axes.add_collection(LineCollection(1e3 * cells.outline(), colors="#999999", linewidths=0.6, linestyles="--"))
    axes.add_collection(LineCollection(1e3 * cells.outline(stretch), colors=INK, linewidths=0.8))
    from_rest = np.concatenate([moved[interface.nodes_a], moved[interface.nodes_b] + apart])
    places = 1e3 * (np.tile(interface.position, (2, 1)) + stretch * from_rest)
    axes.plot(*places.T, ".", color=FLANK_COLOURS[0], markersize=2.5, label="nodes of the contact pairs")
    below = axes.transAxes + ScaledTranslation(0, -0.42, axes.figure.dpi_scale_trans)  # the label, however low they are
    axes.legend(loc="upper center", bbox_to_anchor=(0.5, 0.0), bbox_transform=below, fontsize=7, markerscale=3)
    axes.autoscale_view()
    what = "motion and gap" if gap.any() else "motion"
    (left, right), (below, above) = axes.get_xlim(), axes.get_ylim()
    room = max(0.0, 0.3 * (right - left) - (above - below)) / 2  # a slender body would leave no room for numbers
    axes.set_ylim(below - room, above + room)
    axes.set(aspect="equal", xlabel="x [mm]", ylabel="y [mm]", title=f"{what}, magnified {stretch:.0f} times")


def draw_ring(axes, chain, solution):
    """All sectors at one instant, their motion magnified, over where they are at rest."""
    cells = gather_ring(chain, solution)
    corners, colours = 1e3 * (cells.corners + cells.values), choose_body_colours(cells)
    for body, colour in colours.items():
        axes.add_collection(PolyCollection(corners[cells.body == body], facecolors=colour))
    axes.add_collection(LineCollection(1e3 * cells.outline(), colors=AT_REST, linewidths=0.4))
    axes.add_collection(LineCollection(1e3 * cells.outline(1.0), colors=INK, linewidths=0.5))
    axes.autoscale_view()
    axes.set(aspect="equal", xlabel="x [mm]", ylabel="y [mm]", title="all sectors, motion magnified")


def draw_states(axes, chain, solution):
    """Open, stick and slip of every pair over the period."""
    state = classify_contact(solution, SAMPLES).T
    axes.imshow(
        state,
        cmap=ListedColormap(list(STATES.values())),
        vmin=0,
        vmax=2,
        aspect="auto",
        interpolation="nearest",
        extent=(0, 1, len(state) - 0.5, -0.5),
    )
    for k, flank in enumerate(chain.interface.flanks):
        pairs = np.flatnonzero(chain.interface.flank_of_pair == k)
        axes.axhline(pairs[-1] + 0.5, color=INK, linewidth=0.8)
        if len(chain.interface.flanks) > 1:
            axes.text(0.99, pairs.mean(), flank.replace("_", " "), ha="right", va="center", fontsize=7)
    axes.set(xlabel="time / period", ylabel="pair", title="what each pair does")
    axes.legend(
        handles=[Patch(facecolor=colour, edgecolor=INK, label=name) for name, colour in STATES.items()],
        loc="upper center",
        bbox_to_anchor=(0.5, -0.2),
        ncols=len(STATES),
        fontsize=7,
    )


def draw_curve(axes, x, y, across, along, title):
    """One curve."""
    axes.plot(x, y, ".-", color=FLANK_COLOURS[1], linewidth=1.2)
    axes.set(xlabel=across, ylabel=along, title=title)
    axes.set_ylim(bottom=0.0)


def draw_taps(axes, solution):
    """Gap and normal force of the joint over the period."""
    time = np.arange(SAMPLES) / SAMPLES
    force = 1e-3 * solution.history("normal_force", SAMPLES).sum(axis=1)
    gap = 1e6 * solution.history("gap", SAMPLES).mean(axis=1)
    forces = axes.twinx()
    for side, values, colour, label in (
        (axes, gap, FLANK_COLOURS[1], "mean gap [µm]"),
        (forces, force, FLANK_COLOURS[0], "normal force, all pairs [kN]"),
    ):
        side.plot(time, values, color=colour)
        side.set_ylim(-0.1 * values.max(), 1.05 * values.max())  # zero at the same height on both sides
        side.set_ylabel(label, color=colour)
    axes.set(xlabel="time / period", title="gap and normal force")
    axes.axhline(0.0, color=INK, linewidth=0.6)


def draw_scene(name: str) -> str:
    """Solves a scene, draws its picture and returns its part of the page."""
    path = HERE / f"{name}.toml"
    scene = load_scene(path)
    chain = build_chain(scene)
    study = run_study(chain)
    figure = Figure(figsize=(8.0, 3.6), layout="constrained")
    solid = study.chain.mesh.dimension == 3
    left = figure.add_subplot(1, 2, 1, **({"projection": "3d", "computed_zorder": False} if solid else {}))
    right = figure.add_subplot(1, 2, 2)
    draw_left = draw_solid_motion if solid else draw_ring if scene.cyclic else draw_motion
    draw_left(left, study.chain, study.solution)
    if len(scene.frequencies) > 1:
        frequencies, rms = study.curve
        draw_curve(right, frequencies, 1e3 * rms, "frequency [Hz]", "rms of the tip [mm]", "response")
    elif scene.wear:
        cycles, depth = study.curve
        draw_curve(right, cycles, 1e6 * depth, "cycles", "mean worn depth [µm]", "wear")
    elif scene.contact.tangential == "frictionless":
        draw_taps(right, study.solution)
    else:
        draw_states(right, chain, study.solution)
    figure.suptitle(scene.title, fontsize=10)
    figure.savefig(DOCS / "pictures" / f"gallery_{name}.png", dpi=80)
    if name == IN_README:
        draw_mesh(DOCS / "pictures" / f"{name}.png", chain)
    said = [line.removeprefix("# ") for line in path.read_text(encoding="utf-8").splitlines() if line.startswith("# ")]
    problem = pose_problem(scene, chain.reduction.model, chain.interface)
    effects = [effect for effect in list_effects(scene, problem, flanks=chain.interface.flanks) if effect.on]
    table = "\n".join(f"| {e.name} | {e.unknowns or ''} | {e.why} |" for e in effects)
    return (
        f"## {scene.title}\n\n{' '.join(said)}\n\n![{scene.title}](pictures/gallery_{name}.png)\n\n"
        f"`ewr run demos/{name}.toml`\n\n| effect | unknowns | set by |\n|---|---|---|\n{table}\n"
    )


# %%
PAGE = """# Gallery

Twelve scenes, each solved within seconds, each run by the tests. The tables are what `ewr info` prints: the effects
that a scene has, what they add to the contact solve, and which entries of the scene ask for them. On the left of a
picture the joint at the instant of its largest motion, dashed at rest, with the nodes of its contact pairs in red; of
a ring all sectors. The mean, which static loads cause, is not drawn, so that bodies may overlap a little; where there
is an initial gap, it is magnified like the motion, which is then drawn with its mean.

`demos/draw_gallery.py` draws the pictures and writes this page. `demos/choose_your_effects.py` walks from a bonded
joint to everything at once on one model.

"""

if __name__ == "__main__":
    parser = argparse.ArgumentParser(description="Draw the gallery's pictures and write docs/gallery.md.")
    chosen = "scenes to draw, by default all; the page is written when all are drawn"
    parser.add_argument("scenes", nargs="*", metavar="SCENE", help=f"{chosen}: {', '.join(SCENES)}")
    names = parser.parse_args().scenes or SCENES
    if unknown := sorted(set(names) - set(SCENES)):
        parser.error(f"unknown scene: {', '.join(unknown)}; one of {', '.join(SCENES)}")
    parts = {name: draw_scene(name) for name in names}
    if set(parts) == set(SCENES):
        (DOCS / "gallery.md").write_text(PAGE + "\n".join(parts.values()), encoding="utf-8")
