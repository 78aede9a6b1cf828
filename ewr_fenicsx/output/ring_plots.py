"""Pictures of a ring: all of its sectors at one instant, and the frequencies of its waves."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from ewr_fenicsx.given import RealArray
from ewr_fenicsx.model.reduced_model import ReducedModel
from ewr_fenicsx.model.restriction import solve_stuck
from ewr_fenicsx.output.gathering import Cells, gather_cells
from ewr_fenicsx.output.mesh_plots import stretch
from ewr_fenicsx.output.plots import DPI, FLANK_COLOURS, HEADROOM, INK, in_own_style, save_picture
from ewr_fenicsx.solution.solution import PeriodicSolution
from ewr_fenicsx.structure.chain import Chain
from ewr_fenicsx.structure.mesh import rotate_by_sector
from ewr_fenicsx.whole_files import write_table

MOST_CELLS = 150_000  # in a picture
MODES, SHOWN = 4, 41  # of each wave; and waves that are looked at of a ring that has more


def gather_ring(chain: Chain, solution: PeriodicSolution) -> Cells | None:
    """What is drawn of the sectors, with their motion about the mean, as large as it is drawn, on rank 0; collective.

    Args:
        chain: Of one sector.
        solution: On its model.
    """
    drawn = count_drawn(chain)
    ring, cuts, orders = chain.reduction.model.cyclic, chain.reduction.cuts, np.array(solution.orders)
    waves = [ring.wave_of(h) for h in solution.orders]
    lags = np.array([[ring.lag(j * wave) for wave in waves] for j in range(drawn + 1)])
    moving = lags[:, orders > 0] @ solution.coordinates[orders > 0]
    sectors = [
        gather_cells(chain, chain.reduction.expand(own.real, following.real)) for own, following in pairwise(moving)
    ]
    if sectors[0] is None:
        return None
    rotation, centre = rotate_by_sector(cuts.ring, chain.mesh.dimension), np.array(cuts.ring.centre)
    turned = []
    for j, cells in enumerate(sectors):
        turn = np.linalg.matrix_power(rotation, j).T
        turned.append(Cells(centre + (cells.corners - centre) @ turn, cells.values @ turn, cells.body))
    whole = Cells(*(np.concatenate(part) for part in zip(*(vars(c).values() for c in turned), strict=True)))
    return replace(whole, values=stretch(whole))


def count_drawn(chain: Chain) -> int:
    """How many sectors are drawn: all, or as many as a picture takes within some seconds."""
    return max(1, min(chain.reduction.model.cyclic.sectors, MOST_CELLS // chain.mesh.cells))


def tell_ring(chain: Chain, solution: PeriodicSolution) -> str:
    """What its picture shows."""
    ring, drawn = chain.reduction.model.cyclic, count_drawn(chain)
    which = f"all {drawn}" if drawn == ring.sectors else f"{drawn} of {ring.sectors}"
    at = f"{solution.problem.frequency:g} Hz, engine order {ring.engine_order}"
    return f"{which} sectors at {at}: motion about the mean"


def find_waves(model: ReducedModel) -> Mapping[int, RealArray]:
    """Nodal diameters of a wave, and the lowest frequencies of full stick in it ``(k,)`` [Hz].

    Of rings with many sectors only some waves, that of harmonic 1 among them.
    """
    ring = model.cyclic
    spread = np.linspace(0, ring.sectors // 2, SHOWN).round().astype(int).tolist()
    waves = sorted({*spread, ring.count_diameters(model.wave_of(1))})
    return {wave: np.sqrt(np.maximum(solve_stuck(model, wave, MODES)[0], 0.0)) / (2 * np.pi) for wave in waves}


def write_diameters(path: Path, waves: Mapping[int, RealArray]) -> None:
    """Writes a row for each wave of ``find_waves``."""
    frequencies = np.array([*waves.values()]).T
    columns = {f"mode_{k} [Hz]": mode for k, mode in enumerate(frequencies, start=1)}
    write_table(path, {"nodal_diameters": np.array([*waves])} | columns)


@in_own_style
def draw_diameters(
    path: Path, waves: Mapping[int, RealArray], model: ReducedModel, frequencies: Sequence[float]
) -> None:
    """Frequencies of the waves over their nodal diameters, and where the ring is excited.

    Args:
        path: Of the picture.
        waves: As ``find_waves`` has them.
        model: A sector of the ring.
        frequencies: Of harmonic 1, which crosses mark: those of a sweep, one, or none at rest [Hz].
    """
    figure = Figure(figsize=(7, 5), layout="constrained")
    axes, ring = figure.subplots(), model.cyclic
    for k, mode in enumerate(np.array([*waves.values()]).T):
        axes.plot([*waves], mode, "o-", color=FLANK_COLOURS[k], markersize=4, linewidth=1.0, label=f"mode {k + 1}")
    excited, ends = ring.count_diameters(model.wave_of(1)), [end(frequencies) for end in (min, max) if frequencies]
    axes.axvline(excited, color=INK, linewidth=0.6, linestyle=":", label=f"engine order {ring.engine_order}")
    axes.plot([excited] * len(ends), ends, "x-", color=INK, markersize=9, linewidth=2.5, zorder=4)
    axes.set_ylim(0.0, HEADROOM * max(*ends, *(mode.max() for mode in waves.values())))
    axes.xaxis.set_major_locator(MaxNLocator(integer=True))
    axes.set(xlabel="nodal diameters", ylabel="frequency [Hz]")
    axes.legend(fontsize=8)
    figure.suptitle(f"full-stick modes of the ring of {ring.sectors} sectors")
    save_picture(figure, path, dpi=DPI)
