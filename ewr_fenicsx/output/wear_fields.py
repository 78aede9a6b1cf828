"""Wear for ParaView: how deep the flanks have worn, and under what pressure and sliding, as fields over the cycles.

XDMF time series on the whole mesh, one field a file; their time is the number of cycles. Values belong to the pairs'
nodes on both sides and are zero elsewhere.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import dolfinx
import numpy as np

from ewr_fenicsx.given import RealArray
from ewr_fenicsx.output.gathering import node_interpolation
from ewr_fenicsx.output.output import write_series
from ewr_fenicsx.output.pair_fields import find_pairs, spread_over_interface
from ewr_fenicsx.solution.indicators import measure_sliding
from ewr_fenicsx.structure.chain import Chain
from ewr_fenicsx.wear.archard import SAMPLES
from ewr_fenicsx.wear.wear import WearHistory

WEAR_FIELDS = ("worn_gap", "mean_pressure", "sliding_distance", "J_T")


def tabulate_wear_fields(history: WearHistory) -> dict[str, RealArray]:
    """Name -> ``(steps, K_c)`` values at the pairs.

    ``worn_gap``: initial gap and worn depth [m]; ``mean_pressure``: over the cycle [Pa]; ``sliding_distance``: a cycle
    [m]; ``J_T``: the joint's mean sliding distance a cycle, the same at every pair [m].
    """
    pressure, sliding = np.empty(history.depth.shape), np.empty(history.depth.shape)
    for i, solution in enumerate(history.solutions):
        pressure[i] = solution.pressing_force(SAMPLES).mean(axis=0) / solution.problem.model.areas
        sliding[i] = measure_sliding(solution.sliding_speed(SAMPLES), 1 / solution.problem.frequency)
    indicator = np.broadcast_to(sliding.mean(axis=1)[:, None], sliding.shape)
    values = (history.gap, pressure, sliding, indicator)
    return dict(zip(WEAR_FIELDS, values, strict=True))


def write_wear_fields(folder: Path, chain: Chain, history: WearHistory) -> None:
    """Writes a file a field, and ``worn_surface.xdmf``; collective.

    ``worn_surface`` is a displacement of body A's flanks into the body by the worn depth, for *Warp By Vector*: how the
    depth is shared between the bodies makes no difference to contact, so that the picture gives all of it to one.

    Args:
        folder: Where to; it is made if need be.
        chain: The mesh and interface that the history's model came from.
        history: What to write.
    """
    domain, cycles = chain.mesh.domain, history.cycles.astype(float)
    if domain.comm.rank == 0:
        folder.mkdir(parents=True, exist_ok=True)
    domain.comm.barrier()
    spread = spread_over_interface(chain)
    for name, values in tabulate_wear_fields(history).items():
        write_series(folder / f"{name}.xdmf", domain, cycles, (spread(row) for row in values))
    recede = recede_flanks(chain)
    write_series(folder / "worn_surface.xdmf", domain, cycles, (recede(row) for row in history.depth))


def recede_flanks(chain: Chain) -> Callable[[RealArray], dolfinx.fem.Function]:
    """Returns a function from depths ``(K_c,)`` to the displacement of body A's contact nodes by them, inwards."""
    space, interface = chain.structure.space, chain.interface
    pairs = find_pairs(chain, interface.nodes_a)
    field = dolfinx.fem.Function(space)
    to_nodes = node_interpolation(space)

    def recede(depth: RealArray) -> dolfinx.fem.Function:
        inward = -interface.normal * depth[:, None]
        field.x.array.reshape(len(pairs), -1)[:] = np.where(pairs[:, None] >= 0, inward[pairs], 0.0)
        return to_nodes(field)

    return recede
