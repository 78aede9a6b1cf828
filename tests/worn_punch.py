"""A rigid punch that wears, on a Winkler foundation."""

from __future__ import annotations

from small_models import winkler_punch

from ewr_fenicsx import ContactLaws, ContactProblem

LOAD, SWING, STIFFNESS, PAIRS, AREA = 200.0, 5e-6, 1e12, 5, 2e-5  # as winkler_punch has them
SHARP = 1e-5  # of |v| over a cycle by 1024 samples, relative


def punch(gap=0.0) -> ContactProblem:
    """Without friction, at 100 Hz."""
    model = winkler_punch(load=LOAD, swing=SWING, stiffness=STIFFNESS, pairs=PAIRS, area=AREA)
    return ContactProblem(model, ContactLaws(tangential="frictionless", initial_gap=gap), 100.0, harmonics=1)
