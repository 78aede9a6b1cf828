"""A contact problem as a user states it: a reduced model, laws at its pairs, a frequency and the harmonics kept."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from numbers import Real
from reprlib import repr as shorten
from typing import get_args

import numpy as np

from ewr_fenicsx.errors import ModelError, name_pairs, nearest
from ewr_fenicsx.given import ComplexArray, RealArray, keep, point_at, read_numbers, refreeze
from ewr_fenicsx.laws.contact_laws import ContactLaws, JointLaws
from ewr_fenicsx.laws.law_kinds import is_own, spread_over_pairs
from ewr_fenicsx.model.receptance import GeneralisedInverse
from ewr_fenicsx.model.reduced_model import ReducedModel, check_loads
from ewr_fenicsx.problem.closure import Closure
from ewr_fenicsx.problem.composition import arrange, compose
from ewr_fenicsx.problem.contact_system import ContactSystem
from ewr_fenicsx.problem.harmonics import FourierBasis, select_basis
from ewr_fenicsx.problem.layout import Layout

LOWEST_FREQUENCY, HIGHEST_FREQUENCY = 1e-100, 1e100  # [Hz] powers of them must stay numbers


@dataclass(frozen=True, eq=False)
class ContactProblem:
    """One periodic contact problem.

    Args:
        model: The structure.
        laws: One ``ContactLaws`` for all pairs, or a sequence of ``(pairs, ContactLaws)`` that covers each pair once.
        frequency: Excitation frequency [Hz]; zero where nothing oscillates.
        harmonics: Highest harmonic N (0..N are kept) or a list of harmonics.
        samples: Samples a period for the laws; None: 32 a highest harmonic or more (a power of two), at least 128.
        rho_normal: Weight of the normal law [N/m], scalar or ``(K_c,)``; None: 10 / static flexibility of each pair.
        rho_tangential: Weight of the friction law [(m/s)/N]; None: omega * static flexibility of each pair.
        closure: What stands for the harmonics left out in Coulomb's law: ``"mass"``, the inertia of pairs that move by
            themselves as a mass, and at other pairs, or with a ``rho_tangential``, as with the next one; ``"dashpot"``,
            ``v = rho_tangential lam``; ``"spring"``, masses, and ``q = d lam`` with each pair's own flexibility beyond
            the highest harmonic where it is elastic; or ``(K_c,)`` such flexibilities ``d`` [m/N], zero for dashpots.
            Springs are mostly more accurate at the same harmonics than dashpots, but not at small bodies that rub at
            several pairs; masses are by far. Friction in a plane (two tangents a pair) keeps its dashpots.
        load: Harmonic -> ``(n,)`` amplitudes in place of the model's own loads [N]; None: the model's.
        wear: ``(K_c,)`` worn depth, which adds to the initial gaps [m]; None: none.
        generalised_inverse: How the static stiffness of floating bodies is inverted; no result depends on it.

    Raises:
        ModelError: A frequency, weight, load or wear that makes no sense, loads at harmonics that are not kept, or
            pairs that may part without harmonic 0.
    """

    model: ReducedModel
    laws: JointLaws
    frequency: float
    harmonics: int | Sequence[int] = 5
    samples: int | None = None
    rho_normal: float | RealArray | None = None
    rho_tangential: float | RealArray | None = None
    closure: Closure | RealArray = "mass"
    load: Mapping[int, ComplexArray] | None = field(default=None, repr=False)
    wear: RealArray | None = field(default=None, repr=False)
    generalised_inverse: GeneralisedInverse = field(default="inertia relief", repr=False)

    def __post_init__(self) -> None:
        if not isinstance(self.model, ReducedModel):
            raise ModelError(f"model = {shorten(self.model)}; give a ReducedModel, then laws, then the frequency")
        self.groups  # noqa: B018  laws that do not fit the model come to light here
        if not isinstance(self.frequency, Real):
            raise ModelError(f"frequency = {self.frequency!r}; give a number of Hz, zero where nothing oscillates")
        object.__setattr__(self, "frequency", float(self.frequency))  # of few digits it would spoil all that follows
        if not (self.frequency == 0 or LOWEST_FREQUENCY < self.frequency < HIGHEST_FREQUENCY):
            raise ModelError(
                f"frequency = {self.frequency} Hz; give a positive one from {LOWEST_FREQUENCY:g} to "
                f"{HIGHEST_FREQUENCY:g} Hz, zero where nothing oscillates"
            )
        if self.generalised_inverse not in (known := get_args(GeneralisedInverse)):
            raise ModelError(f"generalised_inverse = {self.generalised_inverse!r}; choose one of {', '.join(known)}")
        if isinstance(self.closure, str) and self.closure not in (known := get_args(Closure)):
            hint = nearest(self.closure, known)
            raise ModelError(f'closure = "{self.closure}"; choose one of {", ".join(known)}, or flexibilities{hint}')
        if not isinstance(self.closure, str):
            given = self._read_by_pair("closure")
            if wrong := point_at("closure", given, (given >= 0) & (given < np.inf)):
                raise ModelError(f"{wrong}; flexibilities must be finite and not negative")
        for name in ("rho_normal", "rho_tangential"):
            if getattr(self, name) is None:
                continue
            given = self._read_by_pair(name)
            if wrong := point_at(name, given, (given > 0) & (given < np.inf)):
                raise ModelError(f"{wrong}; it must be positive and finite, or None for the default")
        if self.wear is not None:
            depth = read_numbers("wear", self.wear)
            wrong = point_at("wear", depth, (depth >= 0) & (depth < np.inf))
            if depth.shape != (self.model.pairs,) or wrong:
                told = wrong or f"wear has the shape {depth.shape}"
                raise ModelError(f"{told}; give one finite depth >= 0 [m] for each of the {self.model.pairs} pairs")
        for name in ("laws", "harmonics", "rho_normal", "rho_tangential", "closure", "wear"):
            object.__setattr__(self, name, keep(getattr(self, name)))
        self.friction, self.clearance, self.given_force  # noqa: B018  as many values as pairs
        if self.load is not None:
            object.__setattr__(self, "load", check_loads(self.load, self.model.size))
        missing = [h for h, f in self.loads.items() if h not in self.basis.orders and np.any(f)]
        if missing:
            raise ModelError(
                f"the model is loaded at harmonics {missing}, the problem keeps only {self.basis.orders}; "
                f"{'add them to harmonics' if self.frequency else 'give a positive frequency'} or remove the load"
            )
        if 0 not in self.basis.orders and np.any(self.opens):
            raise ModelError(
                f"pair {int(np.argmax(self.opens))} may part, and the problem keeps only harmonics "
                f"{self.basis.orders}: a normal force without a mean pulls as much as it pushes; add 0 to harmonics"
            )

    __setstate__ = refreeze

    @cached_property
    def basis(self) -> FourierBasis:
        """Fourier basis of the unknowns: harmonic 0 alone at 0 Hz."""
        asked = select_basis(self.harmonics, self.samples if self.frequency else None)
        return asked if self.frequency else select_basis(0)

    @property
    def has_springs(self) -> bool:
        """Whether springs may stand for the harmonics left out."""
        return not isinstance(self.closure, str) or self.closure == "spring"

    @property
    def has_masses(self) -> bool:
        """Whether masses may: not in place of a weight that is given."""
        named = self.closure if isinstance(self.closure, str) else ""
        return named == "spring" or (named == "mass" and self.rho_tangential is None)

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
        """Pairs and their laws; of none, such as a mask leaves, there is no group.

        Raises:
            ModelError: Something else than laws, or the groups do not cover each pair once.
        """
        everything = np.arange(self.model.pairs)
        if isinstance(self.laws, ContactLaws):
            return ((everything, self.laws),)
        for group in self.laws if isinstance(self.laws, Sequence) else [self.laws]:
            if not (isinstance(group, Sequence) and len(group) == 2 and isinstance(group[1], ContactLaws)):
                raise ModelError(
                    f"laws has {shorten(group)}; give one ContactLaws for all pairs, or a list of (pairs, ContactLaws)"
                )
        groups = tuple((read_numbers("pairs of laws", pairs).reshape(-1), laws) for pairs, laws in self.laws)
        named, count = np.unique(np.concatenate([np.zeros(0), *(pairs for pairs, _ in groups)]), return_counts=True)
        wrong = {
            "leave out": np.setdiff1d(everything, named),
            "repeat": named[count > 1],
            "name, though it is none,": np.setdiff1d(named, everything),
        }
        if told := [f"{how} {name_pairs(pairs)}" for how, pairs in wrong.items() if pairs.size]:
            raise ModelError(f"laws must cover each of the {self.model.pairs} pairs once; they {' and '.join(told)}")
        return tuple((pairs.astype(int), laws) for pairs, laws in groups if pairs.size)

    def _read_by_pair(self, name: str) -> RealArray:
        """Numbers that are given for all pairs, or for each of them, as they were given."""
        spread_over_pairs(getattr(self, name), np.arange(self.model.pairs), self.model.pairs, name)
        return read_numbers(name, getattr(self, name))

    @property
    def own_kinds(self) -> tuple[str, ...]:
        """Names of the kinds among its laws that are not the package's, each once."""
        kinds = [kind for _, laws in self.groups for kind in laws.kinds]
        return tuple(dict.fromkeys(type(kind).__name__ for kind in kinds if is_own(type(kind))))

    @cached_property
    def clearance(self) -> RealArray:
        """``(K_c,)`` initial gap plus wear of each pair, zero where the law knows no gap [m]."""
        gap = np.zeros(self.model.pairs)
        for pairs, laws in self.groups:
            if laws.kinds[0].opens:
                gap[pairs] = spread_over_pairs(laws.kinds[0].initial_gap, pairs, gap.size, "initial_gap")
                if self.wear is not None:
                    gap[pairs] += np.asarray(self.wear)[pairs]
        return gap

    @cached_property
    def opens(self) -> np.ndarray:
        """``(K_c,)`` which pairs may part."""
        opens = np.zeros(self.model.pairs, dtype=bool)
        for pairs, laws in self.groups:
            opens[pairs] = laws.kinds[0].opens
        return opens

    @cached_property
    def friction(self) -> RealArray:
        """``(K_c,)`` coefficient of friction of each pair, zero where it has none."""
        friction = np.zeros(self.model.pairs)
        for pairs, laws in self.groups:
            friction[pairs] = spread_over_pairs(laws.kinds[1].friction, pairs, friction.size, "friction")
        return friction

    @cached_property
    def given_force(self) -> Mapping[int, ComplexArray]:
        """Harmonic -> ``(K_c,)`` amplitudes of the normal forces that are given, zero at other pairs [N]."""
        given: dict[int, ComplexArray] = {}
        for pairs, laws in self.groups:
            spread = lambda value, p=pairs: spread_over_pairs(  # noqa: E731
                value, p, self.model.pairs, "normal_force", complex
            )
            for h, amplitude in laws.kinds[0].give_force(spread).items():
                given.setdefault(h, np.zeros(self.model.pairs, dtype=complex))[pairs] = amplitude
        return given

    @cached_property
    def driven(self) -> tuple[int, ...]:
        """Harmonics of all that is given: loads, and normal forces, also those that do not act on the model."""
        given = (*self.loads.items(), *self.given_force.items())
        return tuple(sorted({h for h, amplitude in given if np.any(amplitude)}))

    @cached_property
    def excitation(self) -> Mapping[int, ComplexArray]:
        """Harmonic -> ``(n,)`` amplitudes of all that is given on the model: loads, and normal forces [N]."""
        total = dict(self.loads)
        for h, amplitude in self.given_force.items() if self.model.normal is not None else ():
            if np.any(amplitude):  # symmetry may have left the harmonic of others out
                total[h] = total.get(h, 0) + self.model.rows("normal", self.model.wave_of(h)).conj().T @ amplitude
        return total

    @cached_property
    def layout(self) -> Layout:
        """The rows of its joint, which say nothing of whether contact holds all bodies."""
        return arrange(self)

    @cached_property
    def bonds(self) -> tuple[tuple[str, np.ndarray], ...]:
        """Directions in which bonds hold pairs whose forces are not sought, with these pairs."""
        directions = ("normal", *self.model.tangent_directions)
        return tuple(
            (direction, pairs)
            for pairs, laws in self.groups
            for direction in directions
            if any(direction in kind.holds(self.model.tangents) for kind in laws.kinds)
            and np.all(self.layout.row_of(direction, pairs) < 0)
        )

    @cached_property
    def system(self) -> ContactSystem:
        """The composed system, built on first use."""
        return compose(self)


def check_problem(problem: ContactProblem) -> None:
    """Refuses what is no problem, such as its model.

    Raises:
        ModelError: Something else than a ``ContactProblem``.
    """
    if not isinstance(problem, ContactProblem):
        raise ModelError(f"problem = {shorten(problem)}; give ContactProblem(model, laws, frequency)")
