"""From what a contact problem states to what it calls for: ``compose`` builds its ``ContactSystem``.

Only the rows, laws and unknowns that the statement calls for. Bonded pairs are projected out of the model, prescribed
forces are loads. Each pair gets its weights, and what closes its truncation.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Protocol

import numpy as np

from ewr_fenicsx.errors import ModelError, name_pairs
from ewr_fenicsx.given import ComplexArray, RealArray
from ewr_fenicsx.laws.contact_laws import ContactLaws
from ewr_fenicsx.laws.law_kinds import (
    DIRECTIONS,
    Law,
    LawKind,
    MeanBound,
    PairGroup,
    choose_friction_weight,
    spread_over_pairs,
)
from ewr_fenicsx.model.compliance import DynamicCompliance, condense
from ewr_fenicsx.model.receptance import GeneralisedInverse, measure_resistance
from ewr_fenicsx.model.reduced_model import ReducedModel
from ewr_fenicsx.model.statics import Statics, find_unpressed, takes_friction
from ewr_fenicsx.problem.closure import compare_waves, find_masses, find_own_springs, find_springs
from ewr_fenicsx.problem.contact_system import ContactSystem
from ewr_fenicsx.problem.harmonics import FourierBasis
from ewr_fenicsx.problem.layout import Layout, demand_rows, lay_out, share_in_plane

# Times the flexibility against stiffness and inertia together, above which a row's static one is that of soft springs,
# far below their resonance, and not the pair's: five times a mode's frequency changes nothing.
SOFT = 30.0
# rho_N = this / flexibility, pair by pair (docs/method.md: what weights do)
DEFAULT_NORMAL_WEIGHT = 10.0


class Statement(Protocol):
    """What must be known of a ``ContactProblem``; attributes as there."""

    model: ReducedModel
    groups: tuple[tuple[np.ndarray, ContactLaws], ...]
    frequency: float
    omega: float
    basis: FourierBasis
    rho_normal: float | RealArray | None
    rho_tangential: float | RealArray | None
    closure: str | RealArray
    has_springs: bool
    has_masses: bool
    clearance: RealArray
    given_force: Mapping[int, ComplexArray]
    excitation: Mapping[int, ComplexArray]
    generalised_inverse: GeneralisedInverse
    layout: Layout
    own_kinds: tuple[str, ...]


def arrange(problem: Statement) -> Layout:
    """Rows of a problem.

    Raises:
        ModelError: A law needs contact rows that the model lacks, a row that nothing can move, a given normal force
            at harmonics that the problem does without, or an interference that nothing relieves; or contact holds a
            floating body, and harmonic 0 is not kept.
    """
    model = problem.model
    layout = lay_out(model, tuple(demand_rows(model, pairs, laws.kinds) for pairs, laws in problem.groups))
    check_given_force(problem)
    check_interference(problem, layout)
    check_mean(problem.basis, layout)
    return layout


def compose(problem: Statement) -> ContactSystem:
    """Build the system of a problem.

    Raises:
        ModelError: As ``arrange``; or a harmonic hits an undamped mode exactly, or contact forces do not see a motion
            of a floating body.
        UnheldBody: Contact cannot hold a floating body under its mean load.
    """
    layout, basis = problem.layout, problem.basis
    load = layout.project(problem.excitation)
    flexibility = layout.static_flexibility + layout.mobility / (problem.omega or 1.0) ** 2
    if problem.omega:  # a soft suspension says nothing of how a body moves far above its mode
        usual = layout.rows_in(wave := layout.usual_wave)
        resistance = measure_resistance(layout.model, usual, problem.omega, wave)
        flexibility = np.minimum(flexibility, SOFT * share_in_plane(layout.index, resistance))
    rows = layout.rows, load, problem.omega, basis.orders, problem.generalised_inverse, layout.next_rows
    compliance = condense(layout.model, *rows)
    rubs_to_hold = find_friction_that_holds(problem, layout, compliance)
    tangents = [direction for direction in layout.index if direction != "normal"]
    masses = {d: find_closing_masses(problem, layout, flexibility, d, rubs_to_hold) for d in tangents}
    return ContactSystem(
        **vars(layout),
        load=load,
        prescribed=problem.given_force,
        laws=tuple(
            law
            for pairs, laws in problem.groups
            for alike in layout.part(pairs)
            for law in build_laws(problem, pairs, alike, laws, layout, flexibility, masses, rubs_to_hold)
        ),
        flexibility=flexibility,
        basis=basis,
        compliance=compliance,
    )


def check_given_force(problem: Statement) -> None:
    """Refuses harmonics of given normal forces that the problem does without.

    A force that does not act on the model is but a limit of friction, which is seen at the samples.

    Raises:
        ModelError: A harmonic is not kept, or too high for the samples.
    """
    basis, model = problem.basis, problem.model
    for h, amplitude in ((h, amplitude) for h, amplitude in problem.given_force.items() if np.any(amplitude)):
        moves = model.normal is not None and np.any(model.rows("normal", model.wave_of(h)).conj().T @ amplitude)
        if h not in basis.orders and (moves or not problem.frequency):
            remedy = "add it to harmonics" if problem.frequency else "give a positive frequency"
            raise ModelError(f"the prescribed normal force has a harmonic {h}; {remedy}")
        if 2 * h >= basis.samples and h:
            raise ModelError(
                f"the prescribed normal force has a harmonic {h}, which samples = {basis.samples} a period cannot tell "
                f"from a lower one; give at least {2 * h + 1}"
            )


def check_interference(problem: Statement, layout: Layout) -> None:
    """Refuses interferences between sectors of a ring that no mean motion relieves: they would stay, at any force.

    Raises:
        ModelError: There is one.
    """
    if layout.next_rows is None:
        return
    for pairs, laws in problem.groups:
        if laws.normal == "unilateral":
            stays = ~np.any(layout.rows[layout.row_of("normal", pairs)], axis=1) & (problem.clearance[pairs] < 0)
            if np.any(stays):
                raise ModelError(
                    f"{name_pairs(pairs[stays])}: an interference between sectors that move alike where all are in "
                    "phase, as under what does not oscillate: nothing relieves it, and any force may press them. "
                    "Prescribe the normal force, or give each pair a coordinate of its own behind a spring"
                )


def check_mean(basis: FourierBasis, layout: Layout) -> None:
    """Refuses contact forces without a mean on bodies that nothing else holds: they may walk, and nobody would see.

    Raises:
        ModelError: Harmonic 0 is not kept, and contact holds a floating body.
    """
    if not basis.has_mean and np.any(layout.rows @ layout.model.rigid_modes):
        raise ModelError(
            f"contact holds a floating body, and the problem keeps only harmonics {basis.orders}: whether it carries "
            "the mean load, or the body walks, would not show; add 0 to harmonics"
        )


def build_laws(
    problem: Statement,
    stated: np.ndarray,
    pairs: np.ndarray,
    laws: ContactLaws,
    layout: Layout,
    flexibility: RealArray,
    masses: Mapping[str, RealArray],
    rubs_to_hold: bool,
) -> list[Law]:
    """Law objects of some pairs among those for which the laws were stated.

    Masses close no truncation where no equation of the mean keeps the mass's own surface from sliding off.
    """
    rows = layout.rows_of(pairs)
    own = {direction: flexibility[at] for direction, at in rows.items()}
    weights = {direction: choose_weight(problem, direction, pairs, own[direction]) for direction in own}
    held = problem.basis.has_mean or halves_repeat(problem, pairs, layout)
    masses = {d: held * masses[d][pairs] for d in rows if d != "normal"}
    closing = {d: choose_closing(problem, pairs, layout, rows[d], own[d], masses[d]) for d in masses}
    clearance, period = problem.clearance[pairs], 1 / problem.frequency if problem.frequency else 0.0
    total = problem.model.pairs
    group = PairGroup(pairs, total, own, weights, closing, masses, clearance, period, rubs_to_hold, stated)
    return laws.build(group)


def choose_weight(problem: Statement, direction: str, pairs: np.ndarray, flexibility: RealArray) -> RealArray:
    """``(K,)`` weight of some pairs' rows in a direction: the user's, or by each row's ``flexibility`` [m/N]."""
    given = problem.rho_normal if direction == "normal" else problem.rho_tangential
    if given is not None:
        return np.full(problem.model.pairs, given, dtype=float)[pairs]
    if direction == "normal":
        return DEFAULT_NORMAL_WEIGHT / flexibility
    return choose_friction_weight(problem.omega or 1.0, flexibility)


def choose_closing(
    problem: Statement, pairs: np.ndarray, layout: Layout, rows: np.ndarray, flexibility: RealArray, masses: RealArray
) -> RealArray:
    """``(K,)`` flexibility of the springs that close the truncation at a group of pairs, zero where none do [m/N]."""
    if not isinstance(problem.closure, str):
        return np.full(problem.model.pairs, problem.closure, dtype=float)[pairs]
    highest, others = problem.basis.orders[-1], masses == 0
    if not (problem.has_springs and highest and np.any(others)):
        return np.zeros(pairs.size)
    wave = layout.usual_wave
    springs = find_springs(layout.model, layout.rows_in(wave)[rows], flexibility, problem.omega, highest, wave)
    return others * springs * soften(problem, layout, rows, springs)


def find_closing_masses(
    problem: Statement, layout: Layout, flexibility: RealArray, direction: str, rubs_to_hold: bool
) -> RealArray:
    """``(K_c,)`` masses that may close the truncation along a tangent, zero where none do [kg].

    None behind a spring of the pair's own, where springs may close it. None where bodies hang on friction: dashpots
    tell whether these walk.
    """
    highest, at = problem.basis.orders[-1], layout.index[direction]
    found, pairs = np.zeros(at.size), np.flatnonzero(at >= 0)
    if problem.has_masses and highest and not rubs_to_hold:
        odd = (highest - 1) | 1  # the same whether symmetry leaves out even ones or not
        wave = layout.usual_wave
        rows = layout.rows_in(wave)[at[pairs]]
        masses = find_masses(layout.model, rows, problem.omega, odd, wave)
        if problem.has_springs and np.any(masses):
            own = find_own_springs(layout.model, rows, flexibility[at[pairs]], problem.omega, highest, wave)
            masses *= own == 0
        found[pairs] = masses / soften(problem, layout, at[pairs], masses)
    return found


def soften(problem: Statement, layout: Layout, rows: np.ndarray, closing: RealArray) -> RealArray | float:
    """``compare_waves`` of rows whose truncation something closes, where sectors rub on one another; else 1."""
    if layout.next_rows is None or not np.any(closing):
        return 1.0
    odd = (problem.basis.orders[-1] - 1) | 1
    return compare_waves(layout.model, lambda wave: layout.rows_in(wave)[rows], problem.omega, odd)


def halves_repeat(problem: Statement, pairs: np.ndarray, layout: Layout) -> bool:
    """Whether friction has no mean at a group of pairs by half-wave symmetry: motions are odd, given limits even."""
    limits = {h for h, force in problem.given_force.items() if np.any(force[pairs])}
    given = np.all(layout.row_of("normal", pairs) < 0)
    return bool(given) and all(h % 2 for h in problem.basis.orders) and not any(h % 2 for h in limits)


def find_friction_that_holds(problem: Statement, layout: Layout, compliance: DynamicCompliance) -> bool:
    """Whether floating bodies hang on friction.

    Raises:
        UnheldBody: Nothing holds a body, or only the mean friction that ``static_friction = "zero"`` leaves out.
    """
    return compliance.rigid_load.size > 0 and takes_friction(pose_statics(problem, layout, compliance))


def list_unpressed(problem: Statement, system: ContactSystem, pressed: np.ndarray | None = None) -> list[int]:
    """Pairs that nothing presses, so that the floating bodies on them may lie anywhere: ``find_unpressed``.

    None where there are laws of one's own, which may do more than their means say. ``pressed``: ``(K,)`` pairs of which
    it is known that something presses them.
    """
    if system.compliance.rigid_load.size == 0 or problem.own_kinds:
        return []
    known = np.zeros(problem.model.pairs, dtype=bool) if pressed is None else pressed
    return find_unpressed(pose_statics(problem, system, system.compliance), known)


def pose_statics(problem: Statement, layout: Layout, compliance: DynamicCompliance) -> Statics:
    """What ``takes_friction`` and ``find_unpressed`` ask of floating bodies and of the mean forces of all pairs."""
    K = problem.model.pairs
    directions = DIRECTIONS[: 1 + max(1, problem.model.tangents)]
    motion = np.array([layout.spread(compliance.rigid_motion.T, direction).T for direction in directions])
    smallest, largest, friction, rubs = np.zeros((4, K))
    for pairs, laws in problem.groups:
        normal, tangential = (bound_mean(kind, pairs, K) for kind in laws.kinds)
        smallest[pairs], largest[pairs] = normal.smallest, normal.largest
        friction[pairs] = tangential.friction
        rubs[pairs] = np.minimum(-np.asarray(tangential.smallest), tangential.largest)
    return Statics(motion[0], motion[1:], smallest, largest, friction, compliance.rigid_load, rubs)


def bound_mean(kind: LawKind, pairs: np.ndarray, total: int) -> MeanBound:
    """Mean force that a kind can carry at some pairs of ``total``.

    Raises:
        ModelError: It says something else.
    """
    given = kind.bound_mean(lambda value: spread_over_pairs(value, pairs, total))
    if not isinstance(given, MeanBound):
        raise ModelError(f"{type(kind).__name__}.bound_mean returns {given!r}; give a MeanBound(smallest, largest)")
    return given
