"""What a problem states and its laws take no notice of."""

from __future__ import annotations

import numpy as np

from ewr_fenicsx.errors import name_pairs
from ewr_fenicsx.laws.law_kinds import list_parameters
from ewr_fenicsx.problem.contact_problem import ContactProblem
from ewr_fenicsx.problem.harmonics import sample_amplitudes

SAMPLES = 1024  # a period, at which a given force is looked at
ROUNDED_FORCE = 1e-9  # share of a given force's largest value, below which a pull is rounding


def list_ignored(problem: ContactProblem) -> list[str]:
    """A line for each thing that does nothing."""
    lines = []
    if not (problem.loads or problem.driven or np.any(problem.clearance < 0)):
        lines.append(
            "nothing acts on the joint, neither a load, a given force nor an interference: give the model, or the "
            "problem, a load"
        )
    for pairs, laws in problem.groups:
        if np.any(laws.initial_gap) and "initial_gap" not in list_parameters("normal", laws.normal):
            lines.append(f'initial_gap is ignored at {name_pairs(pairs)}: normal = "{laws.normal}" knows no gap')
    if problem.wear is not None and np.any(worn := (np.asarray(problem.wear) > 0) & ~problem.opens):
        lines.append(f"wear is ignored at {name_pairs(np.flatnonzero(worn))}: the normal law there knows no gap")
    if not isinstance(problem.closure, str) and "second_tangential" in problem.system.index:
        lines.append("closure is ignored where pairs have two tangents: dashpots, rho_tangential, close friction there")
    rubs = np.flatnonzero(problem.friction > 0)
    given = sample_amplitudes(problem.given_force, rubs, SAMPLES)
    if np.any(pulls := given < -ROUNDED_FORCE * np.abs(given).max(initial=0.0)):
        instant, pair = np.unravel_index(np.argmin(given), pulls.shape)
        lines.append(
            f"the given normal_force of pair {rubs[pair]} pulls by up to {-given[instant, pair]:.3g} N: it then has "
            'no friction, but nothing parts; normal = "unilateral" does'
        )
    return lines
