"""Rings of equal sectors: one sector closed to a ring of them, and a ring unrolled into all its sectors.

``close_ring`` makes a model of one sector that knows its neighbours (``cyclic_symmetry.py``), which costs what one
sector does, however many there are. ``unroll_ring`` makes an ordinary model of all: for motions that are no travelling
wave, as in time or where sectors differ.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from ewr_fenicsx.errors import ModelError
from ewr_fenicsx.given import RealArray, check_symmetry, read_numbers
from ewr_fenicsx.model.cyclic_symmetry import COUPLINGS, ROWS, CyclicSymmetry
from ewr_fenicsx.model.reduced_model import ReducedModel

LARGEST_RING = 8000  # coordinates of an unrolled model, three dense matrices of half a gigabyte each
_APART = 1e-8  # motion of one cut beside the other's, over the largest of a rigid mode, below which it is rounding


def close_ring(
    sector: ReducedModel,
    low: Sequence[int],
    high: Sequence[int],
    *,
    sectors: int,
    engine_order: int,
    turn: RealArray | None = None,
    normal: RealArray | None = None,
    tangential: RealArray | None = None,
) -> ReducedModel:
    """One sector of a ring, from a model of it that is free at both cuts.

    Args:
        sector: With the coordinates of both cuts among its own, as substructures from Abaqus or Ansys have them.
        low: ``(k,)`` numbers of the coordinates at the cut to the sector before; none where only contact joins sectors.
        high: ``(k,)`` those at the cut to the next one, in the same order: ``high[i]`` is where the next one's
            ``low[i]`` is. They are not among the coordinates of the result.
        sectors, engine_order: As in ``CyclicSymmetry``. Loads that the high cut feels enter the result with the
            lag of this engine order: for another one close the ring anew.
        turn: ``(k, k)`` with ``x[high] = turn @ x_next[low]``, each in its own sector's directions: a rotation of the
            next one's vectors by ``2 pi / sectors``; None: equal, as in cylindrical coordinates.
        normal, tangential: What the next sector's coordinates add to the sector's contact rows, shaped as those; None:
            nothing, all pairs are within the sector. Pairs between sectors, as of shrouds, have entries in both.

    Returns:
        A model with ``n - k`` coordinates and ``cyclic`` set. Solve it as any other: its forces, motions and loads are
        those of one sector, and the others' lag.

    Raises:
        ModelError: Coordinates that do not exist, repeat or do not match; a turn that is no rotation; a model that is
            closed already; contact rows at the high cut; rows of the next sector of another shape than the sector's;
            damping not symmetric.
    """
    if not isinstance(sector, ReducedModel) or sector.cyclic is not None:
        raise ModelError("sector: give the ReducedModel of one sector that is free at its cuts, not closed already")
    check_symmetry("damping of a sector in a ring", sector.damping)  # skew parts at the cuts may cancel in phase
    low, high, turn = _read_cuts(low, high, turn, sector.size)
    further = {name: rows for name, rows in (("normal", normal), ("tangential", tangential)) if rows is not None}
    further = {name: _read_next_rows(sector, name, rows) for name, rows in further.items()}
    _refuse_at_high_cut(sector, high, further)
    kept = np.setdiff1d(np.arange(sector.size), high)
    own = np.eye(sector.size)[:, kept]
    following = np.zeros_like(own)
    following[np.ix_(high, np.searchsorted(kept, low))] = turn
    both = own + following
    rigid = sector.rigid_modes / np.abs(sector.rigid_modes).max(axis=0, initial=1e-300)  # a rotation has lengths
    apart = rigid[high] - turn @ rigid[low]
    _, sizes, mix = np.linalg.svd(apart)
    matrices = {name: getattr(sector, name) for name in COUPLINGS}
    in_phase = {name: both.T @ matrix @ both for name, matrix in matrices.items()}
    for name in ("mass", "stiffness"):
        in_phase[name] = 0.5 * (in_phase[name] + in_phase[name].T)
    ring = CyclicSymmetry(
        sectors,
        engine_order,
        **{name: own.T @ matrix @ following for name, matrix in matrices.items()},
        **{name: rows[:, kept] for name, rows in further.items()},
        outputs={name: row @ following for name, row in sector.outputs.items() if np.any(row[high])},
    )
    return replace(
        sector,
        **in_phase,
        **{
            name: (own_rows + further.get(name, 0.0))[:, kept]
            for name in ROWS
            if (own_rows := getattr(sector, name)) is not None
        },
        # the one before loads a sector at its high cut, ahead in time
        load={h: own.T @ f + np.conj(ring.lag(ring.wave_of(h))) * (following.T @ f) for h, f in sector.load.items()},
        outputs={name: row @ both for name, row in sector.outputs.items()},
        rigid_modes=(rigid @ mix[np.count_nonzero(sizes > _APART) :].T)[kept],
        cyclic=ring,
    )


def _read_cuts(low: object, high: object, turn: object, size: int) -> tuple[np.ndarray, np.ndarray, RealArray]:
    cuts = []
    for name, given in (("low", low), ("high", high)):
        numbers = read_numbers(name, given).reshape(-1)
        if not np.all(np.isin(numbers, np.arange(size))):
            raise ModelError(f"{name}: give the numbers of coordinates, 0 to {size - 1}")
        cuts.append(numbers.astype(int))
    if len(cuts[0]) != len(cuts[1]):
        raise ModelError(f"low has {len(cuts[0])} coordinates and high {len(cuts[1])}; give as many, in the same order")
    named, count = np.unique(np.concatenate(cuts), return_counts=True)
    if np.any(count > 1):
        raise ModelError(f"coordinate {named[np.argmax(count)]} is named twice in low and high; give each once")
    if turn is None:
        return *cuts, np.eye(len(cuts[0]))
    matrix = read_numbers("turn", turn)
    expected = (len(cuts[0]),) * 2
    if matrix.shape != expected or not np.allclose(matrix @ matrix.T, np.eye(len(matrix)), atol=1e-9):
        raise ModelError(f"turn has shape {matrix.shape}; give {expected}, a rotation: turn @ turn.T is the identity")
    return *cuts, matrix


def _read_next_rows(sector: ReducedModel, name: str, given: RealArray) -> RealArray:
    rows, own = np.atleast_2d(read_numbers(name, given)), getattr(sector, name)
    if own is None or rows.shape != own.shape:
        expected = "the sector has none" if own is None else f"give {own.shape}, as those of the sector"
        raise ModelError(f"{name}: rows of the next sector have shape {rows.shape}; {expected}")
    return rows


def _refuse_at_high_cut(sector: ReducedModel, high: np.ndarray, further: Mapping[str, RealArray]) -> None:
    """Pairs that would see two sectors, with a lag between their parts."""
    rows = [rows for rows in (sector.normal, sector.tangential, *further.values()) if rows is not None]
    if np.any(np.vstack(rows)[:, high]):
        raise ModelError(
            "contact rows on coordinates of the high cut, which are the next sector's; move them to the low cut or "
            "into the sector"
        )


def unroll_ring(model: ReducedModel) -> ReducedModel:
    """All sectors of a ring as one ordinary model, sector by sector: coordinates, pairs, and loads that travel round.

    Outputs ``name`` become ``name_0``, ``name_1`` and so on. ``integrate`` steps it in time, and a ring whose sectors
    differ (mistuning) starts here. Laws stay as they are given: normal forces that are given and oscillate travel round
    with the loads on ``model`` alone. Here each pair needs its own: those of sector ``j`` are the first one's times
    ``ring.lag(j * ring.wave_of(h))`` at harmonic ``h``, with ``ring = model.cyclic``.

    Args:
        model: As ``close_ring`` returns it, ``n`` coordinates.

    Raises:
        ModelError: No sector of a ring, or more than ``LARGEST_RING`` coordinates in all.
    """
    ring = model.cyclic if isinstance(model, ReducedModel) else None
    if ring is None:
        raise ModelError("model: give a sector of a ring, as close_ring makes it")
    count = ring.sectors
    if count * model.size > LARGEST_RING:
        raise ModelError(
            f"{count} sectors with {model.size} coordinates each are {count * model.size}, more than {LARGEST_RING}; "
            "keep fewer modes or pairs"
        )
    alone, to_next = np.eye(count), np.roll(np.eye(count), 1, axis=1)

    def spread(name: str) -> RealArray:
        coupling = getattr(ring, name)
        own = getattr(model, name) - coupling - coupling.T
        return np.kron(alone, own) + np.kron(to_next, coupling) + np.kron(to_next.T, coupling.T)

    def repeat(name: str) -> RealArray | None:
        rows, following = getattr(model, name), getattr(ring, name)
        if following is None:
            return None if rows is None else np.kron(alone, rows)
        return np.kron(alone, rows - following) + np.kron(to_next, following)

    def follow(name: str) -> RealArray:
        row, following = model.outputs[name], ring.outputs.get(name, np.zeros(model.size))
        return np.kron(alone, row - following) + np.kron(to_next, following)

    independent = model.count_rigid(1) == model.rigid_modes.shape[1]
    return ReducedModel(
        **{name: spread(name) for name in COUPLINGS},
        **{name: repeat(name) for name in ROWS},
        load={
            h: np.concatenate([ring.lag(j * ring.wave_of(h)) * load for j in range(count)])
            for h, load in model.load.items()
        },
        pair_area=None if model.pair_area is None else np.tile(model.pair_area, count),
        rigid_modes=np.kron(alone, model.rigid_modes) if independent else None,
        outputs={f"{name}_{j}": row for name in model.outputs for j, row in enumerate(follow(name))},
    )
