"""Work-precision pictures: error against time, a curve a knob, and which settings nothing beats."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from ewr_fenicsx.accuracy.cost import find_front, fit_slope
from ewr_fenicsx.output.plots import in_own_style, save_picture

ROOM = np.array([0.03, 0.025])  # of a label, in parts of the axes
MARKS = "osD^vP*Xh<>p"
COLOURS = ("#1d6fb8", "#c1121f", "#2a9d57", "#e08e0b", "#7b3fa0", "#444444", "#00838f", "#b5539c", "#8d6e2f", "#5577aa")


@in_own_style
def draw_work_precision(
    path: Path,
    rows: Sequence[Mapping],
    errors: Mapping[str, str],
    title: str = "",
    shown: Sequence[str] | None = None,
) -> None:
    """Error against processor time on double logarithmic axes, a panel an error; it says so where there is none.

    Args:
        path: Picture to write.
        rows: As ``survey`` returns them.
        errors: Name of an error in the rows -> title of its panel.
        title: Of the whole.
        shown: Knobs whose curves are drawn, by default all; the Pareto front is of all rows in any case.
    """
    columns = min(2, len(errors))
    lines = -(-len(errors) // columns)
    figure = Figure(figsize=(7.4 * columns, 4.3 * lines + 1.6), layout="constrained")
    grid = figure.subplots(lines, columns, squeeze=False)
    knobs = [knob for knob in dict.fromkeys(row["knob"] for row in rows) if shown is None or knob in shown]
    for axes, (error, label) in zip(grid.flat, errors.items(), strict=False):
        axes.set(xlabel="processor time [s]", ylabel="relative error", title=label)
        if not any(row["converged"] and row["errors"][error] > 0 for row in rows):
            why = "exact with every setting" if any(row["converged"] for row in rows) else "no setting has a solution"
            axes.text(0.5, 0.5, why, transform=axes.transAxes, ha="center", va="center")
            axes.set(xticks=[], yticks=[])
            continue
        labelled = []
        for k, knob in enumerate(knobs):
            mine = [row for row in rows if row["knob"] == knob and row["converged"] and row["errors"][error] > 0]
            if not mine:
                continue
            seconds, sizes = [r["seconds"] for r in mine], [r["errors"][error] for r in mine]
            name = knob
            if not np.isnan(slope := fit_slope(seconds, sizes)) and max(seconds) > 3 * min(seconds):
                name += f"  ({slope:.1f})"
            axes.plot(
                seconds,
                sizes,
                MARKS[k % len(MARKS)] + "-",
                color=COLOURS[k % len(COLOURS)],
                markersize=4,
                linewidth=1,
                alpha=0.85,
                label=name,
            )
            if knob in ("N", "time steps"):
                points = [(f"{row['value']:g}", row["seconds"], row["errors"][error]) for row in mine]
                labelled += [(*point, COLOURS[k % len(COLOURS)]) for point in points]
        front = [rows[i] for i in find_front(rows, error) if rows[i]["errors"][error] > 0]
        axes.plot(
            [r["seconds"] for r in front],
            [r["errors"][error] for r in front],
            "-",
            color="#000000",
            linewidth=6,
            alpha=0.12,
            zorder=0,
            label="Pareto front of all settings",
        )
        axes.set(xscale="log", yscale="log")
        _label_points(axes, labelled)
        axes.grid(visible=True, which="major", alpha=0.3)
        beside = {"loc": "upper left", "bbox_to_anchor": (1.0, 1.0), "frameon": False}  # no point lies under it
        axes.legend(fontsize=6.5, title="knob (p): error ~ time^p", title_fontsize=6.5, **beside)
    for axes in list(grid.flat)[len(errors) :]:
        axes.set_visible(False)
    figure.suptitle(title)
    save_picture(figure, path, dpi=90)


def _label_points(axes: Axes, points: Sequence[tuple[str, float, float, str]]) -> None:
    """Writes text beside points (text, x, y, colour), but not where it would lie on text already there."""
    taken: list[np.ndarray] = []
    for text, x, y, colour in points:
        place = axes.transAxes.inverted().transform(axes.transData.transform((x, y)))
        if any(np.all(np.abs(place - other) < ROOM) for other in taken):
            continue
        taken.append(place)
        axes.annotate(text, (x, y), xytext=(3, 4), textcoords="offset points", fontsize=7, color=colour)
