"""A contact problem: a reduced model, the laws at its pairs, a frequency and the harmonics kept.

``ContactProblem`` is what the user states; ``compose`` turns it into a ``ContactSystem``: only the rows, laws and
unknowns that the statement calls for. Bonded pairs are projected out of the model, prescribed forces are loads.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property, lru_cache

import numpy as np

from ewr_fenicsx.compliance import DynamicCompliance, GeneralisedInverse, condense, receptance
from ewr_fenicsx.contact_laws import (
    Bond,
    ContactLaws,
    Coulomb,
    Law,
    Signorini,
    prescribed_amplitudes,
    spread_over_pairs,
)
from ewr_fenicsx.errors import ModelError
from ewr_fenicsx.harmonics import FourierBasis, select_basis
from ewr_fenicsx.reduced_model import ComplexArray, RealArray, ReducedModel, hold
from ewr_fenicsx.statics import find_holding

# rho_N = NORMAL / flexibility, rho_T = TANGENTIAL * omega * flexibility, pair by pair (docs/method.md: what they do)
DEFAULT_NORMAL_WEIGHT = 10.0
DEFAULT_TANGENTIAL_WEIGHT = 1.0
# Share of the mean friction force added to its own equation: it decides the mean where a pair sticks throughout.
MEAN_FRICTION_REGULARISATION = 1e-4


@dataclass(frozen=True, eq=False)
class ContactProblem:
    """One periodic contact problem.

    Args:
        model: The structure.
        laws: One ``ContactLaws`` for all pairs, or a sequence of ``(pairs, ContactLaws)`` that covers each pair once.
        frequency: Excitation frequency [Hz].
        harmonics: Highest harmonic N (0..N are kept) or a list of harmonics.
        samples: Samples a period for the laws; None chooses.
        rho_normal: Weight of the normal law [N/m], scalar or ``(K_c,)``; None: 10 / static flexibility of each pair.
        rho_tangential: Weight of the friction law [(m/s)/N]; None: omega * static flexibility of each pair.
        load: Harmonic -> ``(n,)`` amplitudes in place of the model's own loads [N]; None: the model's.
        wear: ``(K_c,)`` worn depth, which adds to the initial gaps [m]; None: none.
        generalised_inverse: How the static stiffness of floating bodies is inverted; no result depends on it.

    Raises:
        ModelError: A frequency, weight, load or wear that makes no sense, or loads at harmonics that are not kept.
    """

    model: ReducedModel
    laws: ContactLaws | Sequence[tuple[Sequence[int], ContactLaws]]
    frequency: float
    harmonics: int | Sequence[int] = 5
    samples: int | None = None
    rho_normal: float | RealArray | None = None
    rho_tangential: float | RealArray | None = None
    load: Mapping[int, ComplexArray] | None = field(default=None, repr=False)
    wear: RealArray | None = field(default=None, repr=False)
    generalised_inverse: GeneralisedInverse = field(default="inertia relief", repr=False)

    def __post_init__(self) -> None:
        if not np.isfinite(self.frequency) or self.frequency < 0:
            raise ModelError(f"frequency = {self.frequency} Hz; give a positive one")
        for name in ("rho_normal", "rho_tangential"):
            value = getattr(self, name)
            if value is not None and not np.all(np.asarray(value, dtype=float) > 0):
                raise ModelError(f"{name} = {value}; it must be positive")
        if self.wear is not None and (
            np.shape(self.wear) != (self.model.pairs,) or not np.all(np.asarray(self.wear) >= 0)
        ):
            raise ModelError(f"wear must be one depth >= 0 for each of the {self.model.pairs} pairs")
        missing = [h for h, f in self.loads.items() if h not in self.basis.orders and np.any(f)]
        if missing:
            raise ModelError(
                f"the model is loaded at harmonics {missing}, the problem keeps only {self.basis.orders}; "
                "add them to harmonics or remove the load"
            )

    @cached_property
    def basis(self) -> FourierBasis:
        """Fourier basis of the unknowns."""
        return select_basis(self.harmonics, self.samples)

    @property
    def omega(self) -> float:
        """Angular frequency [rad/s]."""
        return 2 * np.pi * self.frequency

    @property
    def loads(self) -> Mapping[int, ComplexArray]:
        """Harmonic -> ``(n,)`` complex load amplitudes [N]."""
        return self.model.load if self.load is None else self.load

    @cached_property
    def groups(self) -> tuple[tuple[np.ndarray, ContactLaws], ...]:
        """Pairs and their laws.

        Raises:
            ModelError: The groups do not cover each pair once.
        """
        everything = np.arange(self.model.pairs)
        if isinstance(self.laws, ContactLaws):
            return ((everything, self.laws),)
        groups = tuple((np.asarray(pairs, dtype=int).reshape(-1), laws) for pairs, laws in self.laws)
        covered = np.sort(np.concatenate([pairs for pairs, _ in groups]))
        if not np.array_equal(covered, everything):
            raise ModelError(
                f"laws must cover each of the {self.model.pairs} pairs once; they cover {covered.tolist()}"
            )
        return groups

    @cached_property
    def clearance(self) -> RealArray:
        """``(K_c,)`` initial gap plus wear of each pair, zero where the law knows no gap [m]."""
        gap = np.zeros(self.model.pairs)
        for pairs, laws in self.groups:
            if laws.normal == "unilateral":
                gap[pairs] = spread_over_pairs(laws.initial_gap, pairs, gap.size)
                if self.wear is not None:
                    gap[pairs] += np.asarray(self.wear)[pairs]
        return gap

    @cached_property
    def friction(self) -> RealArray:
        """``(K_c,)`` coefficient of friction of each pair, zero where it has none."""
        friction = np.zeros(self.model.pairs)
        for pairs, laws in self.groups:
            if laws.tangential == "coulomb":
                friction[pairs] = spread_over_pairs(laws.friction, pairs, friction.size)
        return friction

    @cached_property
    def system(self) -> ContactSystem:
        """The composed system, built on first use."""
        return compose(self)


@dataclass(frozen=True, eq=False)
class Layout:
    """The rows of a joint, which follow from the kinds of law alone.

    Attributes:
        model: The model with bonded rows projected out, ``n'`` coordinates.
        expansion: ``(n, n')`` from its coordinates to those of the problem's model.
        rows: ``(m, n')`` contact rows that carry an unknown force.
        index: Direction -> ``(K_c,)`` row of each pair, -1 where it has none.
        flexibility: ``(m,)`` static flexibility of each row by itself, rigid motions left out [m/N].
        mobility: ``(m,)`` inverse inertia of each row where it is all that resists, else zero [1/kg].
    """

    model: ReducedModel
    expansion: RealArray
    rows: RealArray
    index: Mapping[str, np.ndarray]
    flexibility: RealArray
    mobility: RealArray


@dataclass(frozen=True, eq=False)
class ContactSystem:
    """What a problem calls for, and no more.

    Attributes:
        layout: Rows and the model that they belong to.
        load: Harmonic -> ``(n',)`` amplitudes with the prescribed normal forces included [N].
        prescribed: Harmonic -> ``(K_c,)`` amplitudes of the normal forces that are given, zero at other pairs [N].
        laws: The laws; each row belongs to exactly one.
        flexibility: ``(m,)`` flexibility of each row, the unit of its weights [m/N].
        basis: Fourier basis.
        compliance: Dynamic compliance of the rows.
    """

    layout: Layout
    load: Mapping[int, ComplexArray]
    prescribed: Mapping[int, ComplexArray]
    laws: tuple[Law, ...]
    flexibility: RealArray
    basis: FourierBasis
    compliance: DynamicCompliance

    @property
    def model(self) -> ReducedModel:
        """The model with bonded rows projected out."""
        return self.layout.model

    @property
    def expansion(self) -> RealArray:
        """``(n, n')`` from its coordinates to those of the problem's model."""
        return self.layout.expansion

    @property
    def rows(self) -> RealArray:
        """``(m, n')`` contact rows that carry an unknown force."""
        return self.layout.rows

    @property
    def index(self) -> Mapping[str, np.ndarray]:
        """Direction -> ``(K_c,)`` row of each pair, -1 where it has none."""
        return self.layout.index

    def row_of(self, direction: str, pairs: np.ndarray) -> np.ndarray:
        """Row of each of ``pairs`` in a direction, -1 where no unknown force acts in it."""
        return row_of(self.layout.index, direction, pairs)

    def restrict(self, orders: tuple[int, ...]) -> ContactSystem:
        """The same system with fewer harmonics; nothing is computed anew."""
        keep = [self.basis.orders.index(h) for h in orders]
        compliance = replace(
            self.compliance,
            orders=orders,
            flexibility=self.compliance.flexibility[keep],
            free_motion=self.compliance.free_motion[keep],
            outputs={name: rows[keep] for name, rows in self.compliance.outputs.items()},
        )
        samples = min(self.basis.samples, select_basis(orders).samples)
        return replace(self, basis=FourierBasis(orders, samples), compliance=compliance)


def row_of(index: Mapping[str, np.ndarray], direction: str, pairs: np.ndarray) -> np.ndarray:
    """Row of each of ``pairs`` in a direction, -1 where it has none."""
    return index[direction][pairs] if direction in index else np.full(pairs.size, -1)


def compose(problem: ContactProblem) -> ContactSystem:
    """Build the system of a problem.

    Raises:
        ModelError: A law needs contact rows that the model lacks, or a row that nothing can move.
        UnheldBody: Contact cannot hold a floating body under its mean load.
    """
    model, basis = problem.model, problem.basis
    kinds = tuple((tuple(pairs.tolist()), laws.normal, laws.tangential) for pairs, laws in problem.groups)
    layout = lay_out(model, kinds)
    load, prescribed = dict(problem.loads), {}
    for pairs, laws in problem.groups:
        if laws.normal != "prescribed":
            continue
        for h, amplitude in prescribed_amplitudes(laws, pairs.size).items():
            prescribed.setdefault(h, np.zeros(model.pairs, dtype=complex))[pairs] = amplitude
            if model.normal is not None:
                if h not in basis.orders:
                    raise ModelError(f"the prescribed normal force has a harmonic {h}; add it to harmonics")
                load[h] = load.get(h, 0) + model.normal[pairs].T @ amplitude
    load = {h: layout.expansion.T @ f for h, f in load.items()}
    flexibility = layout.flexibility + layout.mobility / (problem.omega or 1.0) ** 2
    compliance = condense(layout.model, layout.rows, load, problem.omega, basis.orders, problem.generalised_inverse)
    rubs_to_hold = find_friction_that_holds(problem, layout, compliance)
    return ContactSystem(
        layout=layout,
        load=load,
        prescribed=prescribed,
        laws=tuple(
            law
            for pairs, laws in problem.groups
            for law in build_laws(problem, pairs, laws, layout.index, flexibility, rubs_to_hold)
        ),
        flexibility=flexibility,
        basis=basis,
        compliance=compliance,
    )


@lru_cache(maxsize=16)
def lay_out(model: ReducedModel, kinds: tuple[tuple[tuple[int, ...], str, str], ...]) -> Layout:
    """Rows of a joint from ``(pairs, normal law, tangential law)`` of each group.

    Raises:
        ModelError: A law needs contact rows that the model lacks, or a row that nothing can move.
    """
    held, active = [np.zeros((0, model.size))], {}
    for pairs, normal, tangential in kinds:
        pairs = np.array(pairs, dtype=int)
        slides = tangential == "coulomb"
        if slides and model.tangents == 2:
            raise ModelError('tangential = "coulomb" is friction along one line; this model has two tangents a pair')
        if normal == "unilateral" or (normal == "bonded" and slides):
            active.setdefault("normal", []).append(pairs)
        elif normal == "bonded":
            held.append(model.rows("normal")[pairs])
        if slides:
            active.setdefault("tangential", []).append(pairs)
        elif tangential == "bonded":
            held += [model.rows(direction)[pairs] for direction in model.tangent_directions]
    directions = {name: np.sort(np.concatenate(pairs)) for name, pairs in active.items()}
    rows = np.vstack([np.zeros((0, model.size)), *(model.rows(name)[pairs] for name, pairs in directions.items())])
    index, start = {}, 0
    for name, pairs in directions.items():
        index[name] = np.full(model.pairs, -1)
        index[name][pairs] = np.arange(start, start + pairs.size)
        start += pairs.size
    kept, expansion = hold(model, np.vstack(held))
    rows = rows @ expansion
    flexibility, mobility = measure_flexibility(kept, rows)
    return Layout(kept, expansion, rows, index, flexibility, mobility)


def build_laws(
    problem: ContactProblem,
    pairs: np.ndarray,
    laws: ContactLaws,
    index: Mapping[str, np.ndarray],
    flexibility: RealArray,
    rubs_to_hold: bool,
) -> list[Law]:
    """Law objects of one group of pairs."""
    built: list[Law] = []
    pick = lambda value: spread_over_pairs(value, pairs, problem.model.pairs)  # noqa: E731
    normal, tangential = row_of(index, "normal", pairs), row_of(index, "tangential", pairs)
    if np.all(normal >= 0):
        stiffness = 1 / flexibility[normal]
        rho = DEFAULT_NORMAL_WEIGHT * stiffness if problem.rho_normal is None else pick(problem.rho_normal)
        bonded = laws.normal == "bonded"
        built.append(Bond(pairs, stiffness) if bonded else Signorini(pairs, problem.clearance[pairs], rho))
    if laws.tangential == "coulomb":
        unit = (problem.omega or 1.0) * flexibility[tangential]
        rho = DEFAULT_TANGENTIAL_WEIGHT * unit if problem.rho_tangential is None else pick(problem.rho_tangential)
        if laws.static_friction == "zero":
            built.append(Coulomb(pairs, pick(laws.friction), rho, static_row=0.0, static_force_row=1.0))
        else:
            eps = MEAN_FRICTION_REGULARISATION
            springs = eps / flexibility[tangential] if rubs_to_hold else 0.0
            built.append(Coulomb(pairs, pick(laws.friction), rho, 1.0, eps, springs))
    return built


def find_friction_that_holds(problem: ContactProblem, layout: Layout, compliance: DynamicCompliance) -> bool:
    """Whether floating bodies hang on friction.

    Raises:
        UnheldBody: Nothing holds a body, or only the mean friction that ``static_friction = "zero"`` leaves out.
    """
    if compliance.rigid_load.size == 0:
        return False
    K, r = problem.model.pairs, compliance.rigid_load.size
    motion = {d: np.zeros((K, r)) for d in ("normal", "tangential")}
    for direction, seen in motion.items():
        rows = row_of(layout.index, direction, np.arange(K))
        seen[rows >= 0] = compliance.rigid_motion[rows[rows >= 0]]
    smallest, largest, friction = np.zeros(K), np.full(K, np.inf), problem.friction.copy()
    for pairs, laws in problem.groups:
        if laws.normal == "bonded":
            smallest[pairs] = -np.inf
        elif laws.normal == "prescribed":
            smallest[pairs] = largest[pairs] = prescribed_amplitudes(laws, pairs.size).get(0, np.zeros(pairs.size)).real
        if laws.static_friction == "zero":
            friction[pairs] = 0.0
    keys = (motion["normal"], motion["tangential"], smallest, largest, friction, compliance.rigid_load)
    return _find_holding(*(_Frozen(key) for key in keys)) == "friction"


class _Frozen:
    """An array as a key of a cache."""

    def __init__(self, array: np.ndarray):
        self.array = array
        self.bytes = array.tobytes()

    def __hash__(self) -> int:
        return hash(self.bytes)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, _Frozen) and self.bytes == other.bytes


@lru_cache(maxsize=64)
def _find_holding(*keys: _Frozen) -> str:
    return find_holding(*(key.array for key in keys))


def measure_flexibility(model: ReducedModel, rows: RealArray) -> tuple[RealArray, RealArray]:
    """Static flexibility of each row by itself ``(m,)`` [m/N]; where nothing bends, zero and the row's mobility [1/kg].

    Raises:
        ModelError: A row moves with no coordinate of the model.
    """
    mobility = np.zeros(rows.shape[0])
    if rows.shape[0] == 0:
        return mobility, mobility
    elastic = np.diag(receptance(model, 0.0, rows, rows.T)).real.copy()
    norms = np.linalg.norm(rows, axis=1)
    if not np.all(norms > 0):
        raise ModelError(
            f"contact row {int(np.argmin(norms))} moves with no coordinate: its pair is clamped or bonded already"
        )
    rigid = elastic <= 1e-12 * norms**2 / (np.abs(np.diag(model.stiffness)).max() or np.inf)
    if np.any(rigid):
        mobility[rigid] = np.einsum("mn,nm->m", rows[rigid], np.linalg.solve(model.mass, rows[rigid].T))
        elastic[rigid] = 0.0
    return elastic, mobility
