"""The rows of a joint: which directions of which pairs carry an unknown force, and which are held.

They follow from the kinds of law alone, so that problems that differ in parameters share them.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import NamedTuple

import numpy as np
import scipy.linalg

from ewr_fenicsx.errors import ModelError, name_pairs
from ewr_fenicsx.given import ComplexArray, RealArray
from ewr_fenicsx.laws.law_kinds import DIRECTIONS, TANGENTS, LawKind
from ewr_fenicsx.model.receptance import measure_at_rest
from ewr_fenicsx.model.reduced_model import ReducedModel
from ewr_fenicsx.model.restriction import bound_motion, restrict
from ewr_fenicsx.model.rigid_modes import find_own_units

_REDUNDANT = 1e-10  # share of a bonded row that others leave of it, below which it is one of them
_OBEYED = 1e-8  # motion of bonded rows by rigid modes, over what they could see, below which it is rounding
_ROUNDED = 1e-12  # share of a row that bonds leave of it, or beside the pair's others, below which it is rounding


class Demand(NamedTuple):
    """What the laws of a group of pairs ask of the model's rows."""

    pairs: tuple[int, ...]
    active: tuple[str, ...]  # directions with an unknown force
    held: tuple[str, ...]  # directions projected out
    resting: tuple[str, ...]  # active ones in which pairs with a zero row have no force


def demand_rows(model: ReducedModel, pairs: np.ndarray, kinds: tuple[LawKind, ...]) -> Demand:
    """Which rows of some pairs carry an unknown force, and which are held.

    A direction that is held has an unknown force all the same where another kind must know it.

    Raises:
        ModelError: A kind does not fit the model's number of tangents, or acts in or holds what is no direction.
    """
    needed = {d for kind in kinds for d in kind.needs}
    held = [d for kind in kinds for d in _ask(kind, "holds", model.tangents)]
    acting = [d for kind in kinds for d in _ask(kind, "acts_in", model.tangents)] + [d for d in held if d in needed]
    return Demand(
        tuple(pairs.tolist()),
        tuple(d for d in DIRECTIONS if d in acting),
        tuple(d for d in DIRECTIONS if d in held and d not in acting),
        tuple(d for kind in kinds if kind.rests for d in kind.acts_in(model.tangents) if d in TANGENTS),
    )


def _ask(kind: LawKind, name: str, tangents: int) -> Sequence[str]:
    """The directions that a kind names by one of its methods."""
    given = getattr(kind, name)(tangents)
    if isinstance(given, str) or not set(given) <= set(DIRECTIONS):
        known = ", ".join(f'"{direction}"' for direction in DIRECTIONS)
        raise ModelError(f"{type(kind).__name__}.{name} returns {given!r}; give a tuple of some of {known}")
    return given


@dataclass(frozen=True, eq=False)
class Layout:
    """The rows of a joint, which follow from the kinds of law alone.

    Attributes:
        model: The model with bonded rows projected out, ``n'`` coordinates.
        expansion: ``(n, n')`` from its coordinates to those of the problem's model.
        rows: ``(m, n')`` contact rows that carry an unknown force; of a ring those in wave 0.
        next_rows: ``(m, n')`` what the next sector's coordinates add to them; None: nothing.
        index: Direction -> ``(K_c,)`` row of each pair, -1 where it has none.
        static_flexibility: ``(m,)`` of each row by itself, rigid motions left out; with two tangents a pair the mean of
            both [m/N].
        mobility: ``(m,)`` inverse inertia of each row where it is all that resists, else zero [1/kg].
    """

    model: ReducedModel
    expansion: RealArray
    rows: RealArray
    next_rows: RealArray | None
    index: Mapping[str, np.ndarray]
    static_flexibility: RealArray
    mobility: RealArray

    def rows_in(self, wave: int) -> RealArray | ComplexArray:
        """The rows in a wave of a ring, ``(m, n')``."""
        return self.model.see_wave(self.rows, self.next_rows, wave)

    def project(self, load: Mapping[int, ComplexArray]) -> dict[int, ComplexArray]:
        """Loads, harmonic -> ``(n,)``, on the model's coordinates, ``(n',)`` [N]."""
        return {h: self.expansion.T @ amplitude for h, amplitude in load.items()}

    @property
    def usual_wave(self) -> int:
        """The wave of harmonic 1, in which flexibilities are measured; 0 where there is no ring."""
        return self.model.wave_of(1)

    def row_of(self, direction: str, pairs: np.ndarray) -> np.ndarray:
        """Row of each of ``pairs`` in a direction, -1 where no unknown force acts in it."""
        return self.index[direction][pairs] if direction in self.index else np.full(pairs.size, -1)

    def spread(self, of_rows: np.ndarray, direction: str) -> np.ndarray:
        """Values of rows, ``(..., m)``, at all pairs in a direction, ``(..., K_c)``; zero where a pair has no row."""
        rows = self.row_of(direction, np.arange(self.model.pairs))
        at_pairs = np.zeros((*of_rows.shape[:-1], rows.size), of_rows.dtype)
        at_pairs[..., rows >= 0] = of_rows[..., rows[rows >= 0]]
        return at_pairs

    def rows_of(self, pairs: np.ndarray) -> dict[str, np.ndarray]:
        """Direction -> row of each of ``pairs``, for directions in which an unknown force acts at all of them."""
        return {d: at[pairs] for d, at in self.index.items() if np.all(at[pairs] >= 0)}

    def part(self, pairs: np.ndarray) -> list[np.ndarray]:
        """Pairs parted by the directions in which unknown forces act at them, each part in the same order."""
        acts = sum(2**k * (self.row_of(direction, pairs) >= 0) for k, direction in enumerate(reversed(DIRECTIONS)))
        return [pairs[acts == kind] for kind in np.unique(acts)]


@lru_cache(maxsize=16)
def lay_out(model: ReducedModel, demands: tuple[Demand, ...]) -> Layout:
    """Rows of a joint from what each group of pairs asks for.

    Raises:
        ModelError: A law needs contact rows that the model lacks, or a row that nothing can move.
    """
    held, directions = _gather_demands(model, demands)
    gather = lambda read: np.vstack(  # noqa: E731
        [np.zeros((0, model.size)), *(read(name)[pairs] for name, pairs in directions.items())]
    )
    rows, next_rows = gather(model.rows), gather(model.next_rows) if model.joins_sectors else None
    wave = model.wave_of(1)
    whole = gather(lambda name: model.rows(name, wave)) if wave else rows
    index, start = {}, 0
    for name, pairs in directions.items():
        index[name] = np.full(model.pairs, -1)
        index[name][pairs] = np.arange(start, start + pairs.size)
        start += pairs.size
    kept, expansion = hold(model, held)
    usual = whole @ expansion
    _refuse_alike(model, whole, next_rows, index)
    reached = np.linalg.norm(np.abs(whole) @ np.abs(expansion), axis=1)
    _refuse_immobile(np.linalg.norm(usual, axis=1) <= _ROUNDED * reached, index)
    flexibility, mobility = measure_flexibility(kept, usual, wave)
    flexibility, mobility = share_in_plane(index, flexibility), share_in_plane(index, mobility)
    mobility[flexibility > 0] = 0.0
    next_rows = None if next_rows is None else next_rows @ expansion
    rows = rows @ expansion if wave else usual
    return Layout(kept, expansion, rows, next_rows, index, flexibility, mobility)


def _gather_demands(model: ReducedModel, demands: tuple[Demand, ...]) -> tuple[RealArray, dict[str, np.ndarray]]:
    """Rows ``(k, n)`` that are held, and direction -> pairs, rising, at which an unknown force acts in it."""
    held, active = [np.zeros((0, model.size))], {}
    for demand in demands:
        pairs = np.array(demand.pairs, dtype=int)
        if model.joins_sectors and demand.held:
            _refuse_bonds_between_sectors(model, pairs, demand.held)
        held += [model.rows(direction)[pairs] for direction in demand.held]
        for direction in demand.active:
            acting = pairs[_moves(model, direction, pairs)] if direction in demand.resting else pairs
            active.setdefault(direction, []).append(acting)
    directions = {d: np.sort(np.concatenate(active[d])) for d in DIRECTIONS if d in active}
    return np.vstack(held), {direction: pairs for direction, pairs in directions.items() if pairs.size}


def _refuse_alike(
    model: ReducedModel, rows: RealArray | ComplexArray, next_rows: RealArray | None, index: Mapping[str, np.ndarray]
) -> None:
    """Refuses rows between sectors of a ring ``(m, n)`` that are zero in the wave of harmonic 1."""
    alike = np.zeros(len(rows), dtype=bool) if next_rows is None else np.any(next_rows, axis=1) & ~np.any(rows, axis=1)
    if np.any(alike):
        name, pair = _find_pair(int(np.argmax(alike)), index)
        raise ModelError(
            f"the {name} row of pair {pair}, between sectors, does not move{model.tell_wave()}, where the next sector "
            "moves as this one does; leave the pair out, or solve the whole ring: unroll_ring(model)"
        )


def _find_pair(row: int, index: Mapping[str, np.ndarray]) -> tuple[str, int]:
    """Direction and pair of a row, for people."""
    name, at = next((name, at) for name, at in index.items() if np.any(at == row))
    return name.replace("_", " "), int(np.argmax(at == row))


def _refuse_immobile(immobile: np.ndarray, index: Mapping[str, np.ndarray]) -> None:
    """Refuses rows that nothing can move, ``immobile`` ``(m,)``."""
    if not np.any(immobile):
        return
    name, pair = _find_pair(int(np.argmax(immobile)), index)
    in_plane = [at[pair] for direction, at in index.items() if direction != "normal" and at[pair] >= 0]
    raise ModelError(
        f"the {name} row of pair {pair} moves with no coordinate: the pair is held by supports, "
        f"or held by bonds of others already; {_advise(name, moves_in_plane=not np.all(immobile[in_plane]))}"
    )


def _refuse_bonds_between_sectors(model: ReducedModel, pairs: np.ndarray, held: Sequence[str]) -> None:
    between = np.any([np.any(model.next_rows(direction)[pairs], axis=1) for direction in held], axis=0)
    if np.any(between):
        raise ModelError(
            f"{name_pairs(pairs[between])}: bonded, between sectors; let sectors share what is bonded, as a part of "
            "their cuts"
        )


def _moves(model: ReducedModel, tangent: str, pairs: np.ndarray) -> np.ndarray:
    """Which pairs have a row other than zero, or rounding, along a tangent, or along the first one in their plane."""
    at = DIRECTIONS.index(tangent)
    along = [tangent, *(d for d in model.tangent_directions if DIRECTIONS.index(d) > at)]
    known = {*along, *(() if model.normal is None else ("normal",)), *model.tangent_directions}
    size = {d: np.linalg.norm(model.rows(d, model.wave_of(1))[pairs], axis=1) for d in known}
    least = _ROUNDED * np.max([*size.values()], axis=0)
    return np.any([size[direction] > least for direction in along], axis=0)


def hold(model: ReducedModel, rows: RealArray) -> tuple[ReducedModel, RealArray]:
    """Bond contact rows: the model on the motions that leave ``rows @ x = 0``.

    As many coordinates as there are independent rows follow the others, which stay as they are: mixed with such as have
    far more inertia, as on weak springs, they would lose their digits. Redundant rows do no harm, and neither do zero
    ones, of clamped pairs. Rigid modes are those that are left. What is redundant, and what follows, is asked in the
    stiffness's own units: where those of coordinates are unlike, as of modes beside responses to unit forces, rows that
    differ in the latter alone would look alike.

    Args:
        model: The model.
        rows: ``(m, n)`` rows held.

    Returns:
        The smaller model and the basis ``T``, ``(n, n - rank)``, with ``x = T y``: ``y`` are those that stay, in these
        units.

    Raises:
        ModelError: Nothing is left to move.
    """
    rows = rows[np.any(rows != 0, axis=1)]
    if rows.shape[0] == 0:
        return model, np.eye(model.size)
    units = find_own_units(model.stiffness, model.mass)
    own = rows / units
    triangle, order = scipy.linalg.qr(own / np.linalg.norm(own, axis=1, keepdims=True), mode="r", pivoting=True)
    sizes = np.abs(np.diag(triangle))
    rank = np.count_nonzero(sizes > _REDUNDANT * sizes[0])
    if rank == model.size:
        raise ModelError(
            f"bonds hold all {model.size} coordinates of the model, and nothing is left to move; bond fewer pairs or "
            "directions, or give a model with more coordinates"
        )
    others = rank + np.argsort(order[rank:])
    follow, stay = order[:rank], order[others]
    free = np.zeros((model.size, stay.size))
    free[stay, range(stay.size)] = 1.0
    free[follow] = -scipy.linalg.solve_triangular(triangle[:rank, :rank], triangle[:rank, others])
    basis = free / units[:, None]
    return restrict(model, basis, units[stay, None] * _rigid_modes_that_obey(model, rows)[stay]), basis


def _rigid_modes_that_obey(model: ReducedModel, rows: RealArray) -> RealArray:
    """Combinations of the rigid modes that leave rows at rest."""
    modes = model.rigid_modes / bound_motion(model, rows)
    _, values, turn = np.linalg.svd(rows @ modes)
    return modes @ turn[np.count_nonzero(values > _OBEYED) :].T


def _advise(direction: str, moves_in_plane: bool) -> str:
    """What a user may do about a row that nothing moves, though the pair's other tangent may."""
    if direction == "normal":
        return "leave the pair out, or prescribe its normal force"
    if moves_in_plane:
        return (
            "turn both tangents of the pair in their plane until neither lies across the line along which it moves, "
            "say by 45 degrees: friction has no preferred direction"
        )
    return "leave the pair out, or make it frictionless"


def share_in_plane(index: Mapping[str, np.ndarray], of_rows: RealArray) -> RealArray:
    """The mean of both tangents of a pair in place of each, ``(m,)``: nothing depends on where in the plane they point.

    Args:
        index: Direction -> ``(K_c,)`` row of each pair, -1 where it has none.
        of_rows: ``(m,)`` flexibilities [m/N] or mobilities [1/kg] of rows; pairs with one tangent keep theirs.
    """
    shared = of_rows.copy()
    if set(TANGENTS) <= index.keys():
        twins = np.array([index[direction] for direction in TANGENTS])
        twins = twins[:, np.all(twins >= 0, axis=0)]
        shared[twins] = of_rows[twins].mean(axis=0)
    return shared


def measure_flexibility(
    model: ReducedModel, rows: RealArray | ComplexArray, wave: int = 0
) -> tuple[RealArray, RealArray]:
    """Static flexibility of each row by itself ``(m,)`` [m/N]; where nothing bends, 0 and the row's mobility [1/kg]."""
    mobility = np.zeros(rows.shape[0])
    if rows.shape[0] == 0:
        return mobility, mobility
    elastic = measure_at_rest(model, rows, wave)
    units = find_own_units(model.stiffness, model.mass)  # whatever those of the coordinates
    free = units**2 > 2 * np.abs(np.diag(model.stiffness))  # nothing bends there: their share is rounding, and squared
    rigid = elastic <= np.abs(rows / units) ** 2 @ np.where(free, _ROUNDED**2, _ROUNDED)
    if np.any(rigid):
        inverse = scipy.linalg.pinvh(model.matrix("mass", wave))  # other coordinates may have no mass
        mobility[rigid] = np.einsum("mn,nm->m", rows[rigid], inverse @ rows[rigid].conj().T).real
        elastic[rigid] = 0.0
    return elastic, mobility
