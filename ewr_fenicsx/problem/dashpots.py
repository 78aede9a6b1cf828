"""Weights of the friction law as dashpots that close the truncation: each pair's mobility beyond the harmonics kept.

The projected law would be exact if the harmonics left out obeyed ``v_h = rho_T lam_h`` (docs/method.md). Springs in
their place are ``closure.py``'s.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from ewr_fenicsx.given import RealArray
from ewr_fenicsx.problem.closure import average, list_beyond, measure_beyond
from ewr_fenicsx.problem.composition import choose_weight
from ewr_fenicsx.problem.contact_problem import ContactProblem

LIGHTER = (0.1, 0.03)  # over the default dashpots


def use_mobility(problem: ContactProblem) -> ContactProblem:
    """The problem with the weights of ``match_mobility``."""
    return replace(problem, rho_tangential=match_mobility(problem))


def match_mobility(problem: ContactProblem) -> RealArray | None:
    """``(K_c,)`` weights ``rho_T`` that close the truncation: each pair's mobility at the first harmonics left out.

    Geometric mean over some of them, for a single one may hit a resonance; with two tangents, of a size that does not
    depend on where they point. Laws that give way by themselves before they slip keep theirs. None without friction
    [(m/s)/N].
    """
    if read_weight(problem, "tangential") is None:
        return None
    problem = replace_masses(problem)
    weight, system = read_weight(problem, "tangential"), problem.system
    beyond = list_beyond(problem.basis.orders[-1])
    rate = np.array(beyond)[:, None] * problem.omega
    wave = system.usual_wave
    measure = lambda rows: measure_beyond(system.model, rows, problem.omega, beyond, wave)  # noqa: E731
    for law in system.laws:
        if law.direction == "tangential" and hasattr(law, "rho") and not np.any(law.stick_flexibility):
            at = [system.row_of(direction, law.pairs) for direction in problem.model.tangent_directions]
            along = [system.rows_in(wave)[rows] for rows in at if np.all(rows >= 0)]
            own = [measure(rows) for rows in along]
            size = np.linalg.norm(own, axis=0)
            if len(along) == 2:
                between = (measure(along[0] + along[1]) - own[0] - own[1]) / 2
                size = np.hypot(size, np.sqrt(2) * np.abs(between))
            weight[law.pairs] = average(rate * size / np.sqrt(len(along)))
    return weight


def read_friction_weight(problem: ContactProblem) -> RealArray | None:
    """``(K_c,)`` weights ``rho_T`` of a problem, ones where a pair has none; None without any [(m/s)/N].

    Weights for all pairs leave no masses: where some pairs have weights, those of the masses are the default ones.
    """
    weight = read_weight(problem, "tangential")
    return None if weight is None else read_weight(replace_masses(problem), "tangential")


def weigh_lighter(problem: ContactProblem, pairs: np.ndarray) -> Iterator[ContactProblem]:
    """The problem, and then with ever lighter dashpots at some pairs, ``(K,)``: the law itself has none."""
    yield problem
    weight = read_friction_weight(problem)
    for share in LIGHTER:
        lighter = weight.copy()
        lighter[pairs] *= share
        yield replace(problem, rho_tangential=lighter)


def replace_masses(problem: ContactProblem) -> ContactProblem:
    """The problem with dashpots in place of the masses that close its truncation; itself where none do."""
    return replace(problem, closure="dashpot") if "masses" in problem.system.closures else problem


def read_weight(problem: ContactProblem, direction: str, stated: ContactProblem | None = None) -> RealArray | None:
    """``(K_c,)`` weights that laws with a ``rho`` were given in a direction, ones at other pairs; None without any.

    A law may make a weight of its own of the one that it is given, so its ``rho`` is not what a problem would repeat.

    Args:
        problem: The problem, whose laws are read.
        direction: Of a force.
        stated: The same with other weights: what its laws would be given. None: the problem itself.
    """
    system, weight, found = problem.system, np.ones(problem.model.pairs), False
    for law in system.laws:
        if law.direction == direction and hasattr(law, "rho"):
            flexibility = system.flexibility[system.row_of(direction, law.pairs)]
            weight[law.pairs], found = choose_weight(stated or problem, direction, law.pairs, flexibility), True
    return weight if found else None
