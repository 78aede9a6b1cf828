"""Where a motion in time starts."""

from __future__ import annotations

from ewr_fenicsx import ContactLaws, ContactProblem, ReducedModel
from ewr_fenicsx.solver.initial_states import choose_start


def test_rest_is_rest_where_harmonic_0_is_not_kept():
    """The first harmonic kept stood for the mean."""
    model = ReducedModel([[1.0]], [[0.1]], [[4.0]], tangential=[[1.0]], load={1: [1.0]})
    slides = ContactLaws("prescribed", "frictionless", normal_force=1.0)
    assert choose_start(ContactProblem(model, slides, 0.2, (1, 3)), "rest").position == 0
