"""All sectors of a ring at one instant, for a picture: each has the motion that the first one had a while ago."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np

from ewr_fenicsx.output.gathering import Cells, gather_cells
from ewr_fenicsx.output.mesh_plots import stretch
from ewr_fenicsx.solution.solution import PeriodicSolution
from ewr_fenicsx.structure.chain import Chain
from ewr_fenicsx.structure.mesh import rotate_by_sector


def gather_ring(chain: Chain, solution: PeriodicSolution) -> Cells | None:
    """What is drawn of all sectors, with their motion about the mean, as large as it is drawn, on rank 0; collective.

    Args:
        chain: Of one sector.
        solution: On its model.
    """
    ring, cuts, orders = chain.reduction.model.cyclic, chain.reduction.cuts, np.array(solution.orders)
    waves = [ring.wave_of(h) for h in solution.orders]
    lags = np.array([[ring.lag(j * wave) for wave in waves] for j in range(ring.sectors + 1)])
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


def tell_ring(solution: PeriodicSolution) -> str:
    """What its picture shows."""
    ring = solution.problem.model.cyclic
    return (
        f"all {ring.sectors} sectors at {solution.problem.frequency:g} Hz, engine order {ring.engine_order}: "
        "motion about the mean"
    )
