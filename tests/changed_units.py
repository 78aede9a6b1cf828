"""Problems told in other units."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ewr_fenicsx import ContactProblem


def change_units(problem: ContactProblem, length: float, mass: float, time: float) -> ContactProblem:
    """The same problem told in other units."""
    model, laws = problem.model, problem.laws
    force = mass * length / time**2
    scaled = lambda value, factor: None if value is None else factor * np.asarray(value)  # noqa: E731
    loads = lambda load: None if load is None else {h: force * np.asarray(f) for h, f in load.items()}  # noqa: E731
    model = replace(
        model,
        mass=model.mass * mass,
        damping=model.damping * (mass / time),
        stiffness=model.stiffness * (mass / time**2),
        load=loads(model.load),
        pair_area=scaled(model.pair_area, length**2),
    )
    given = loads if isinstance(laws.normal_force, dict) else lambda value: scaled(value, force)
    return replace(
        problem,
        model=model,
        laws=replace(laws, initial_gap=length * np.asarray(laws.initial_gap), normal_force=given(laws.normal_force)),
        frequency=problem.frequency / time,
        rho_normal=scaled(problem.rho_normal, mass / time**2),
        rho_tangential=scaled(problem.rho_tangential, time / mass),
        load=loads(problem.load),
    )
