"""Where a motion in time starts."""

from __future__ import annotations

import numpy as np
import pytest

from ewr_fenicsx import ContactLaws, ContactProblem, ReducedModel, State, integrate
from ewr_fenicsx.errors import ModelError, UnheldBody
from ewr_fenicsx.solver.initial_states import choose_start


def test_rest_is_rest_where_harmonic_0_is_not_kept():
    """The first harmonic kept stood for the mean."""
    model = ReducedModel([[1.0]], [[0.1]], [[4.0]], tangential=[[1.0]], load={1: [1.0]})
    slides = ContactLaws("prescribed", "frictionless", normal_force=1.0)
    assert choose_start(ContactProblem(model, slides, 0.2, (1, 3)), "rest").position == 0


@pytest.mark.parametrize(
    ("friction", "pull", "gained"),
    [(0.3, 5.0, 5.0 - 3.0), (0.0, 5.0, 5.0), (0.0, -1.0, -1.0)],  # [m/s^2] under 10 N, of 1 kg
)
def test_what_contact_cannot_hold_is_stepped_from_a_state(friction, pull, gained):
    """A block that is pulled along with more than friction carries: no motion is periodic, and none is at rest."""
    free = np.zeros((2, 2))
    model = ReducedModel(
        np.eye(2), free, free, normal=[[1.0, 0.0]], tangential=[[0.0, 1.0]],
        load={0: [-10.0, pull], 1: [4.0, 0.0]}, outputs={"way": [0.0, 1.0]},
    )  # fmt: skip
    laws = ContactLaws(friction=friction) if friction else ContactLaws(tangential="frictionless")
    problem = ContactProblem(model, laws, frequency=10.0)
    still = State(np.zeros(2), np.zeros(2))
    way = integrate(problem, still, steps=100, periods=3, tolerance=0).transient("way")
    assert way[-1] == pytest.approx(gained * 0.3**2 / 2, rel=1e-6)
    with pytest.raises((UnheldBody, ModelError), match="from a State"):
        integrate(problem)


@pytest.mark.parametrize(
    ("position", "message"),
    [
        ([0.0, 1j], r"start: position = .* is complex"),
        (np.zeros(3), r"start: position has shape \(3,\); expected 2 finite"),
        ([0.0, np.nan], "expected 2 finite coordinates"),
        (None, "start: position = None; give numbers"),
    ],
)
def test_what_is_no_state_is_refused(position, message):
    model = ReducedModel(np.eye(2), np.zeros((2, 2)), np.eye(2), tangential=[[0.0, 1.0]], load={1: [1.0, 0.0]})
    problem = ContactProblem(model, ContactLaws("prescribed", normal_force=1.0), 0.2)
    with pytest.raises(ModelError, match=message):
        integrate(problem, State(position, np.zeros(2)), steps=20, periods=1)
