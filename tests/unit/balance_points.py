"""Balances of every combination of laws at points where the pairs are in a chosen state."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from small_models import random_structure

from ewr_fenicsx import ContactLaws, ContactProblem
from ewr_fenicsx.balance.balance import HarmonicBalance

FREQUENCY = 0.21
STATES = ("stick", "slip", "open", "mixed")
_VARYING = {0: np.array([9.0, 8.0, 10.0]), 1: np.array([3.0j, 2.0, -4.0])}
LAWS: dict[str, ContactLaws | list] = {  # every combination that has unknowns
    "unilateral coulomb": ContactLaws(friction=[0.3, 0.5, 0.8]),
    "unilateral coulomb, mean zero": ContactLaws(friction=0.4, static_friction="zero"),
    "unilateral coulomb, held in place": ContactLaws(friction=[0.3, 0.5, 0.8], static_friction="held"),
    "unilateral frictionless": ContactLaws(tangential="frictionless", initial_gap=[0.0, 0.1, 0.3]),
    "unilateral bonded": ContactLaws(tangential="bonded"),
    "bonded coulomb": ContactLaws("bonded", friction=0.4),
    "bonded coulomb, mean zero": ContactLaws("bonded", friction=0.4, static_friction="zero"),
    "prescribed coulomb": ContactLaws("prescribed", friction=0.4, normal_force=8.0),
    "varying coulomb": ContactLaws("prescribed", friction=0.4, normal_force=_VARYING),
    "varying coulomb, mean zero": ContactLaws(
        "prescribed", friction=0.4, normal_force=_VARYING, static_friction="zero"
    ),
    "groups": [
        ([2], ContactLaws(friction=0.3)),
        ([1, 0], ContactLaws("bonded", friction=0.6, static_friction="zero")),
    ],
    "bond in a group": [([1], ContactLaws("bonded", "bonded")), ([0, 2], ContactLaws(friction=0.5))],
    "prescribed in a group": [
        ([1], ContactLaws("prescribed", normal_force=8.0)),
        ([2, 0], ContactLaws(friction=0.5)),
    ],
    "free in a group": [([0, 2], ContactLaws(tangential="frictionless")), ([1], ContactLaws(friction=0.5))],
}
SPRINGS = ", springs"  # close the truncation of the same laws
FLEXIBILITY = [0.2, 0.3, 0.25]  # of these springs [m/N]; given, for pairs here move too little to be sprung
SPRUNG = ("unilateral coulomb", "bonded coulomb, mean zero", "varying coulomb", "varying coulomb, mean zero", "groups")
LAWS |= {name + SPRINGS: LAWS[name] for name in SPRUNG}


def combine_with(harmonics: int, *others: object) -> list[tuple]:
    """Law combinations with ``harmonics`` in every state, and with other sets of harmonics in the mixed one.

    A prescribed mean force and contact that opens need the mean.
    """
    without_mean = ("bonded coulomb", "bonded coulomb, mean zero", "bonded coulomb, mean zero, springs")
    mixed = [(kind, h, "mixed") for kind in LAWS for h in others if h != (1, 3, 5) or kind in without_mean]
    return [(kind, harmonics, state) for kind in LAWS for state in STATES] + mixed


@dataclass(frozen=True)
class Point:
    """A problem, and unknowns at which its pairs are in a chosen state."""

    problem: ContactProblem
    balance: HarmonicBalance
    unknowns: np.ndarray


def prepare(kind: str, state: str, harmonics=3, samples: int | None = None, seed: int = 0) -> Point:
    """Loads chosen so that chosen forces go with chosen motions: every row is then in the state asked for."""
    model = random_structure(size=10)
    closure = FLEXIBILITY if kind.endswith(SPRINGS) else "dashpot"
    problem = ContactProblem(model, LAWS[kind], FREQUENCY, harmonics, samples, closure=closure)
    system = problem.system
    assert (system.closures == ("springs",)) == kind.endswith(SPRINGS)
    rng = np.random.default_rng(seed)
    orders, m = system.basis.orders, system.rows.shape[0]
    ripple = lambda size: (rng.normal(size=(len(orders), m)) + 1j * rng.normal(size=(len(orders), m))) * size  # noqa: E731
    decay = 1.0 / (1.0 + np.array(orders)[:, None])
    forces, motion = ripple(0.3) * decay, ripple(1e-3) * decay
    normal = system.index["normal"][system.index["normal"] >= 0] if "normal" in system.index else np.zeros(0, dtype=int)
    rub = (
        system.index["tangential"][system.index["tangential"] >= 0]
        if "tangential" in system.index
        else np.zeros(0, int)
    )
    first = orders.index(1)
    if state == "mixed":
        forces, motion = ripple(4.0) * decay, ripple(4.0) * decay
        if orders[0] == 0:
            forces[0, normal] += 4.0
    elif state == "open":
        motion[0 if orders[0] == 0 else first, normal] = 30.0
        forces[0, normal] -= 2.0 * (orders[0] == 0)  # no cone either
    elif orders[0] == 0:
        forces[0, normal] = 20.0
    if state == "slip":
        motion[first, rub] = 300.0 * np.exp(1j * rng.uniform(0, 6, rub.size))
    if orders[0] == 0:
        forces[0], motion[0] = forces[0].real, motion[0].real
        for law, rows in zip(system.laws, HarmonicBalance(system).law_rows, strict=True):
            if law.static_row == 0:
                forces[0, rows] = 0.0
    load = {}
    for j, h in enumerate(orders):
        w = h * problem.omega
        impedance = model.stiffness - w**2 * model.mass + 1j * w * model.damping
        wanted = motion[j] - system.compliance.flexibility[j] @ forces[j] - system.compliance.free_motion[j]
        load[h] = impedance @ system.expansion @ np.linalg.lstsq(system.rows, wanted, rcond=None)[0]
        if system.expansion.shape[1] < model.size:  # bonds: the load must move the bonded structure there
            T = system.expansion
            load[h] = np.linalg.pinv(T.T) @ (T.T @ impedance @ T) @ np.linalg.lstsq(system.rows, wanted, rcond=None)[0]
        load[h] = load[h].real if h == 0 else load[h]
    problem = replace(problem, model=replace(model, load=load))
    balance = HarmonicBalance(problem.system)
    np.testing.assert_allclose(balance.compliance.motion(forces, np.zeros(0)), motion, atol=1e-9 * np.abs(motion).max())
    return Point(problem, balance, balance.pack(forces, np.zeros(0)))
