"""Pictures of a solution: pair histories, the contact sets, and curves along a sweep or over cycles.

Plain matplotlib on ``Figure`` objects: no display, no global state. Pictures of the mesh are in ``mesh_plots.py``.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from itertools import groupby
from pathlib import Path
from textwrap import fill

import numpy as np
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from matplotlib.style import context
from matplotlib.text import Text

from ewr_fenicsx.balance.periodic_motion import SECOND
from ewr_fenicsx.given import RealArray
from ewr_fenicsx.solution.contact_state import (
    find_pairs_with,
    list_histories,
    sample_along_tangents,
    sample_friction_limit,
)
from ewr_fenicsx.solution.solution import PeriodicSolution
from ewr_fenicsx.structure.interface import Interface

SAMPLES = 1024
ALIKE = 1e-3  # of the largest value, that curves drawn as one lie apart at most
DPI = 150
LETTERS = 10  # of a title, an inch: wide ones take as much
HEADROOM = 1.05  # times the largest value, up to which an axis from zero goes
LEAST = {
    "normal_force": 1e-6,
    "friction_force": 1e-6,
    "gap": 1e-3,
    "slip": 1e-3,
    "slip_velocity": 1e-3,
}  # N, N, µm, µm, mm/s
FLANK_COLOURS = (  # enough for fir trees of six lobes
    *("#c1121f", "#1d6fb8", "#e08e0b", "#2a9d57", "#7b3fa0", "#666666"),
    *("#8c564b", "#00b3b3", "#e377c2", "#a3a300", "#1b1b6b", "#ff9d8a"),
)
INK = "#222222"
EXACT = "exact set"
PRESSING, RUBBING = "normal force [N]", "friction force / (µ normal force)"
MISSING = {PRESSING: "another law here", RUBBING: "no Coulomb limit here"}

# Around what draws: a user's matplotlibrc must not change pictures, or end a run at its last stage for want of LaTeX.
in_own_style = context("default")


def save_picture(figure: Figure, path: Path, **settings: object) -> None:
    """Writes a figure that has not been drawn before; a dollar in a title or a name is one, and begins no formula.

    Numbers along axes, which matplotlib itself may write as formulas, get their text only as they are drawn.

    Args:
        figure: The figure.
        path: Of the picture.
        settings: Of ``Figure.savefig``.
    """
    for text in figure.findobj(lambda artist: isinstance(artist, Text) and "$" in artist.get_text()):
        text.set_parse_math(False)
    figure.savefig(path, **settings)


def put_title(figure: Figure, title: str) -> None:
    """The title of a figure that has its width, in as many lines as that takes."""
    figure.suptitle(fill(title, int(LETTERS * figure.get_figwidth())))


@in_own_style
def draw_histories(path: Path, interface: Interface, solution: PeriodicSolution) -> None:
    """Forces and motions over the period, a column for each flank, of the pairs whose laws know of them.

    Slip is drawn about its mean: that of the mean load may be far larger, and nothing rubs by it.
    """
    rows = [
        (name, label, factor)
        for name, label, factor in (
            ("normal_force", "normal force [N]", 1.0),
            ("friction_force", "friction force [N]", 1.0),
            ("gap", "gap [µm]", 1e6),
            ("slip", "slip about its mean [µm]", 1e6),
            (SECOND + "friction_force", "second\nfriction force [N]", 1.0),
            (SECOND + "slip", "second slip\nabout its mean [µm]", 1e6),
        )
        if name in list_histories(solution)
    ]
    if not rows:
        return
    columns = len(interface.flanks)
    figure = Figure(figsize=(2.2 + 2.7 * columns, 0.9 + 2.0 * len(rows)), layout="constrained")
    grid = figure.subplots(len(rows), columns, sharex=True, sharey="row", squeeze=False)
    phase = np.arange(SAMPLES) / SAMPLES
    for line, (name, label, factor) in zip(grid, rows, strict=True):
        along = name.removeprefix(SECOND)
        knows = find_pairs_with(solution, along)
        history = factor * solution.history(name, SAMPLES) * knows
        if along == "slip":
            history = history - history.mean(axis=0)
        for k, axes in enumerate(line):
            for place, pair in _along(interface, k, knows):
                axes.plot(phase, history[:, pair], color=_COLOURS.to_rgba(place), linewidth=1.0)
            axes.axhline(0.0, color=INK, linewidth=0.5)
        line[0].set_ylabel(label)
        if np.abs(history).max() < LEAST[along]:  # rounding, not motion
            line[0].set_ylim(-LEAST[along], LEAST[along])
    for axes, flank in zip(grid[0], interface.flanks, strict=True):
        axes.set_title(flank.replace("_", " "))
    for axes in grid[-1]:
        axes.set(xlabel="time / period", xlim=(0, 1))
    _place_key(figure, grid, interface)
    put_title(figure, _caption(solution))
    save_picture(figure, path, dpi=DPI)


@in_own_style
def draw_contact_sets(path: Path, interface: Interface, solution: PeriodicSolution) -> None:
    """Where pairs stand with respect to the exact sets of Signorini (above) and Coulomb (below), flank by flank.

    Friction is in units of its momentary limit ``mu lam_N``, drawn where the limit exceeds a twentieth of its largest
    value (at lift-off the quotient means nothing), and as far as twice the limit. With two tangents it is the size of
    the force over the speed. Flanks without the law stay empty, and so do those where it never has a limit above zero.
    """
    rows = {}  # title of the two axes -> what to draw, where it is shown, which pairs have the law, and its exact set
    normal = solution.history("normal_force", SAMPLES)
    parts, rubs = (find_pairs_with(solution, name) for name in ("gap", "admissible_friction_force"))
    if np.any(parts):
        gap = 1e6 * solution.history("gap", SAMPLES)
        most = 1.1 * max(normal[:, parts].max(), LEAST["normal_force"])  # less is rounding of pairs that are all open
        corner = [(0, most), (0, 0), (1.1 * max(gap[:, parts].max(), LEAST["gap"]), 0)]
        rows["gap [µm]", PRESSING] = gap, normal, np.full(normal.shape, True), parts, corner
    limit = sample_friction_limit(solution, SAMPLES)
    rubs &= np.any(limit > 0, axis=0)  # laws of one's own may rub, and not by a multiple of the normal force
    if np.any(rubs):
        shown = limit > 0.05 * limit.max()
        sized = solution.problem.model.tangents == 2
        read = lambda name: sample_along_tangents(solution, name, SAMPLES)  # noqa: E731
        friction, velocity = (
            np.linalg.norm(along, axis=0) if sized else along[0]
            for along in map(read, ("friction_force", "slip_velocity"))
        )
        share, velocity = friction / np.where(shown, limit, 1.0), 1e3 * velocity
        fastest = np.abs(velocity[:, rubs]).max(initial=0.0, where=shown[:, rubs])  # open pairs are, and not drawn
        far = 1.1 * max(fastest, LEAST["slip_velocity"])
        exact = [(0, 0), (0, 1), (far, 1)] if sized else [(-far, 1), (0, 1), (0, -1), (far, -1)]
        rows[f"slip {'speed' if sized else 'velocity'} [mm/s]", RUBBING] = velocity, share, shown, rubs, exact
    if not rows:
        return
    columns = len(interface.flanks)
    figure = Figure(figsize=(2.2 + 2.9 * columns, 0.9 + 3.0 * len(rows)), layout="constrained")
    grid = figure.subplots(len(rows), columns, sharey="row", sharex="row", squeeze=False)
    for line, ((across, along), (x, y, shown, knows, exact)) in zip(grid, rows.items(), strict=True):
        line[0].set_ylabel(along)
        for k, axes in enumerate(line):
            axes.set_xlabel(across)
            if not np.any(knows[interface.flank_of_pair == k]):
                axes.text(0.5, 0.5, MISSING[along], transform=axes.transAxes, ha="center", fontsize=8, color=INK)
                continue
            axes.plot(*np.transpose(exact), color=FLANK_COLOURS[0], linewidth=4.0, alpha=0.3, zorder=0.5, label=EXACT)
            for place, pair in _along(interface, k, knows):
                here = shown[:, pair]
                axes.plot(
                    x[here, pair], y[here, pair], ".", color=_COLOURS.to_rgba(place), markersize=2.5, rasterized=True
                )
        line[0].locator_params(axis="x", nbins=4)  # for all of the row; more would overlap where extents are tiny
        if along == RUBBING:
            line[0].set_ylim(2 * min(0, *np.transpose(exact)[1]), 2)
    for axes, flank in zip(grid[0], interface.flanks, strict=True):
        axes.set_title(flank.replace("_", " "))
    next(axes for axes in grid.flat if axes.lines).legend(loc="upper right", fontsize=8)
    put_title(figure, _caption(solution))
    _place_key(figure, grid, interface)
    save_picture(figure, path, dpi=DPI)


@in_own_style
def draw_curves(
    path: Path,
    across: str,
    x: RealArray,
    series: Mapping[str, RealArray],
    breaks: Sequence[int] = (),
    unstable: np.ndarray | None = None,
) -> None:
    """Some figures along a sweep or over cycles, one line each; those that coincide, as by symmetry, share one.

    Args:
        path: Of the picture.
        across: What ``x`` is.
        x: ``(n,)``.
        series: Name -> ``(n,)``.
        breaks: Points after which lines begin anew.
        unstable: ``(n,)`` points that no motion in time stays at: hollow, and lines to them dashed.
    """
    hollow = np.zeros(len(x), dtype=bool) if unstable is None else np.asarray(unstable, dtype=bool)
    empty = {"marker": "o", "markersize": 3.5, "markerfacecolor": "white"}
    figure = Figure(figsize=(7.5, 4.5), layout="constrained")
    axes = figure.subplots()
    for k, (name, values) in enumerate(_join_alike(series)):
        colour = FLANK_COLOURS[k % len(FLANK_COLOURS)]
        axes.plot([], [], ".-", color=colour, linewidth=1.2, label=name)
        for style, run in _cut_into_lines(breaks, hollow):
            axes.plot(x[run], values[run], style, color=colour, linewidth=1.2)
        axes.plot(x[~hollow], values[~hollow], ".", color=colour)
        axes.plot(x[hollow], values[hollow], linestyle="", color=colour, **empty)
    if np.any(hollow):
        axes.plot([], [], "--", color="0.3", linewidth=1.2, label="unstable", **empty)
    axes.set_xlabel(across)
    units = {name[name.rfind("[") :] for name in series}
    axes.set_ylabel(next(iter(series)) if len(series) == 1 else "".join(units) if len(units) == 1 else "")
    highest = max((float(np.nanmax(values, initial=0.0)) for values in series.values()), default=0.0)
    axes.set_ylim(0.0, HEADROOM * highest or None)
    if len(series) > 1 or np.any(hollow):
        axes.legend()
    save_picture(figure, path, dpi=DPI)


def _join_alike(series: Mapping[str, RealArray]) -> list[tuple[str, RealArray]]:
    """Names and values of curves; of those that nobody could tell apart one, under the names of all."""
    joined: list[tuple[str, RealArray]] = []
    for name, values in series.items():
        for i, (names, known) in enumerate(joined):
            if np.abs(known - values).max() <= ALIKE * np.abs(known).max():
                joined[i] = f"{names}\n= {name}", known
                break
        else:
            joined.append((name, np.asarray(values)))
    return joined


def _cut_into_lines(breaks: Sequence[int], unstable: np.ndarray) -> list[tuple[str, slice]]:
    """Line styles and the points that each runs through; a line to an unstable point is dashed."""
    dashed = unstable[:-1] | unstable[1:]
    styles = [None if i in breaks else "--" if away else "-" for i, away in enumerate(dashed)]
    runs, begin = [], 0
    for style, steps in groupby(styles):
        end = begin + len(list(steps))
        if style:
            runs.append((style, slice(begin, end + 1)))
        begin = end
    return runs


_COLOURS = ScalarMappable(Normalize(0.0, 1.0), "viridis")


def _along(interface: Interface, flank: int, shown: np.ndarray) -> Iterator[tuple[float, int]]:
    """Pairs of a flank that are shown, each after its place from one end (0) to the other (1)."""
    mine = np.flatnonzero(interface.flank_of_pair == flank)
    places = np.linspace(0.0, 1.0, len(mine)) if len(mine) > 1 else [0.5]
    return ((place, pair) for place, pair in zip(places, mine, strict=True) if shown[pair])


def _caption(solution: PeriodicSolution) -> str:
    orders = solution.orders
    gapless = orders == tuple(range(orders[0], orders[-1] + 1))
    kept = f"{orders[0]} to {orders[-1]}" if gapless else ", ".join(map(str, orders))
    wear = 0.0 if solution.problem.wear is None else solution.problem.wear.max()
    worn = f", worn by up to {1e6 * wear:.3g} µm" if wear > 0 else ""
    return (f"{solution.problem.frequency:g} Hz, harmonics {kept}" if any(orders) else "at rest") + worn


def _place_key(figure: Figure, grid: np.ndarray, interface: Interface) -> None:
    label = "place along the flank's tangent" if interface.dimension == 2 else "place on the flank, row by row"
    bar = figure.colorbar(_COLOURS, ax=grid, label=label, shrink=0.5, aspect=30, pad=0.01)
    bar.set_ticks([0, 1], labels=["first pair", "last pair"])
