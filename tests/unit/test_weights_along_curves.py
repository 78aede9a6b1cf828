"""Weights of one's own along a curve: where cold starts end at the default ones, so does what follows."""

from __future__ import annotations

import numpy as np
import pytest
from checked_solutions import measure_residual
from small_models import friction_oscillator, lift_off_oscillator
from test_frequency_response import LAWS, sweep

from ewr_fenicsx import ContactLaws, ContactProblem, frequency_response, solve
from ewr_fenicsx.response import frequency_sweep
from ewr_fenicsx.runs import findings
from ewr_fenicsx.solver import weights


def use_default_weights_below(frequency, monkeypatch):
    """Cold starts at lower frequencies are answered with the default weights, as where no way leads to those given."""

    def solve_cold(problem, **given):
        return solve(weights.use_default_weights(problem) if problem.frequency < frequency else problem, **given)

    monkeypatch.setattr(frequency_sweep, "solve", solve_cold)


@pytest.mark.parametrize("answered", [0.09, 1.0])
def test_a_curve_that_begins_with_the_default_weights_keeps_them(monkeypatch, answered, tmp_path):
    usual = sweep()
    own = {"rho_tangential": 30.0, "rho_normal": 100.0, "closure": "spring"}
    assert np.abs(sweep(**own).output("tip") - usual.output("tip")).max() > 1e-3 * np.abs(usual.output("tip")).max()
    use_default_weights_below(answered, monkeypatch)
    for curve in (sweep(**own, folder=tmp_path), sweep(**own, folder=tmp_path)):
        assert curve.jumps == () and not any(weights.has_own_weights(s.problem) for s in curve.solutions)
        asked = ContactProblem(lift_off_oscillator(), LAWS, 0.1, **own)
        assert any("9 of them hold with default weights" in line for line in findings.tell_sweep(curve, asked))
        assert findings.list_facts_of_sweep(curve, asked)["sweep"]["with_default_weights"] == 9
        assert not any("weights" in line for line in findings.tell_sweep(curve, curve.solutions[0].problem))
        np.testing.assert_allclose(
            curve.output("tip"), usual.output("tip"), atol=1e-6 * np.abs(usual.output("tip")).max()
        )


def test_solutions_without_idle_harmonics_keep_the_weights_that_they_hold_for(monkeypatch):
    use_default_weights_below(1.0, monkeypatch)
    laws = ContactLaws("prescribed", normal_force=0.4)
    curve = frequency_response(friction_oscillator(damping=0.1), laws, [0.1, 0.11], 5, False, rho_tangential=30.0)
    for solution in curve.solutions:
        assert solution.left_out == (0, 2, 4)
        assert measure_residual(solution) < 1e-8
