"""Problems beside one on a reduced model, by which the error of the modes that it leaves out is estimated.

One has fewer modes. Where the frequencies of the whole structure are known that it has while its joint sticks, another
has the inertia that these take: what the modes left out add to the motions that those kept have in common.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace
from functools import lru_cache

import numpy as np

from ewr_fenicsx.given import RealArray
from ewr_fenicsx.model.reduced_model import ReducedModel
from ewr_fenicsx.model.restriction import restrict, solve_stuck
from ewr_fenicsx.problem.contact_problem import ContactProblem

MODES_DROPPED = 1 / 3
_NOTHING = 1e-10  # of responses to loads, and of squared frequencies, over the largest, below which one is rounding


class ModesBesideResponses(tuple[int, ...]):
    """Modal coordinates of a model that has static responses to its loads besides, as the package's own have.

    Attributes:
        responses: Coordinates of these. They lack what the modes do: with fewer modes they would respond for more.
        stuck: Lowest frequencies of the whole structure while its joint sticks, rising, as far as they are known [Hz].
    """

    responses: tuple[int, ...]
    stuck: tuple[float, ...]

    def __new__(
        cls, modes: Iterable[int], responses: Iterable[int], stuck: Iterable[float] = ()
    ) -> ModesBesideResponses:
        made = super().__new__(cls, modes)
        made.responses, made.stuck = tuple(responses), tuple(stuck)
        return made


def keep_fewer(problem: ContactProblem, modes: Sequence[int]) -> ContactProblem:
    """The problem without a third of its modes, the highest; static responses besides respond for these as well.

    Args:
        problem: On all of them.
        modes: Which coordinates of its model are modal, by rising frequency.
    """
    model, fewer = problem.model, list(modes)[-max(1, round(MODES_DROPPED * len(modes))) :]
    responses = np.zeros((model.size, 0))
    if isinstance(modes, ModesBesideResponses):
        fewer += modes.responses
        responses = respond(problem, fewer)
    basis = np.hstack([np.delete(np.eye(model.size), fewer, axis=1), responses])
    load = None if problem.load is None else {h: basis.T @ f for h, f in problem.load.items()}
    return replace(problem, model=restrict(model, basis, basis.T @ model.rigid_modes), load=load)


@lru_cache(maxsize=2)
def correct_inertia(model: ReducedModel, stuck: tuple[float, ...]) -> ReducedModel:
    """The model with the inertia that gives it the frequencies ``stuck`` while its joint sticks [Hz].

    The shapes ``psi`` of its own modes of full stick, of unit stiffness, stay its modes:
    ``M + K psi (1 / w^2 - 1 / w_r^2) psi^T K``, with ``w_r`` the model's own frequencies, which are never below ``w``.
    Whatever rests is as before; so are motions that not even a stuck joint holds.
    """
    squares, shapes = solve_stuck(model, count=len(stuck))
    exact = (2 * np.pi * np.array(stuck[: squares.size])) ** 2
    held = np.minimum(exact, squares) > _NOTHING * squares[-1]
    lack = np.divide(squares - exact, exact * squares**2, out=np.zeros_like(exact), where=held)
    pushed = model.stiffness @ shapes * np.sqrt(np.maximum(lack, 0.0))
    return replace(model, mass=model.mass + pushed @ pushed.T)


def respond(problem: ContactProblem, coordinates: Sequence[int]) -> RealArray:
    """Static responses of some coordinates to the loads where all others rest, orthonormal, ``(n, l)``."""
    forces = [part for load in problem.loads.values() for part in (load[coordinates].real, load[coordinates].imag)]
    stiffness = problem.model.stiffness[np.ix_(coordinates, coordinates)]
    responses = np.linalg.solve(stiffness, np.reshape(forces, (-1, len(coordinates))).T)
    shapes, sizes, _ = np.linalg.svd(responses, full_matrices=False)
    found = np.zeros((problem.model.size, np.count_nonzero(sizes > _NOTHING * sizes.max(initial=0.0))))
    found[coordinates] = shapes[:, : found.shape[1]]
    return found
