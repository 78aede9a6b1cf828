"""Newton steps to a few per cent against the exact ones."""

from __future__ import annotations

import gc
from dataclasses import replace

import numpy as np
import pytest
from small_models import block_on_feet, dovetail, foot_on_the_ground, random_structure

from ewr_fenicsx import ContactLaws, ContactProblem, solve
from ewr_fenicsx.balance import inexact_step
from ewr_fenicsx.balance.balance import HarmonicBalance
from ewr_fenicsx.balance.inexact_step import COUPLED, TOLERANCE, solve_inexactly
from ewr_fenicsx.balance.newton_step import NewtonStep

ORDERS = 24
PROBLEMS = {
    "held by contact": ContactProblem(dovetail(), ContactLaws(friction=0.3), 600.0, ORDERS),
    "friction in a plane": ContactProblem(foot_on_the_ground(), ContactLaws(friction=0.4), 0.15, ORDERS),
    "hangs on friction": ContactProblem(
        block_on_feet({0: [0.0, 0.0, -10.0, 0.0, 0.0, 0.0], 1: [0.0, 0.0, 0.0, 0.0, 0.0, 5.0]}),
        ContactLaws(friction=0.5, static_friction="resolved"),
        0.2,
        ORDERS,
    ),
    "mean friction set to zero": ContactProblem(
        dovetail(), ContactLaws(friction=0.3, static_friction="zero"), 600.0, ORDERS
    ),
    "odd harmonics only": ContactProblem(
        replace(random_structure(pairs=4), normal=None, load={1: np.ones(9)}),
        ContactLaws(normal="prescribed", normal_force=0.05, friction=1.0),
        0.1,
        tuple(range(1, 2 * ORDERS, 2)),
    ),
    "closed by springs": ContactProblem(dovetail(), ContactLaws(friction=0.3), 600.0, ORDERS, closure="spring"),
}


@pytest.fixture(params=PROBLEMS)
def step(request, monkeypatch) -> NewtonStep:
    """Linearised at the solution of a few harmonics, with all; as if even such small ones were worth the trouble."""
    monkeypatch.setattr(inexact_step, "FEW", 0)
    problem = PROBLEMS[request.param]
    balance, low = HarmonicBalance(problem.system), solve(problem)
    forces = low.forces * (np.array(low.orders) < 6)[:, None]
    step = balance.linearise(balance.pack(forces, low.rigid))
    assert step.unknowns_left > 2 * ORDERS, "else there is nothing that changes status"
    return step


def test_what_is_left_is_within_the_tolerance(step):
    exact, found = step.solve(step.residual), solve_inexactly(step)
    left = np.linalg.norm(step.residual - step.multiply(found))
    assert 1e-9 * np.linalg.norm(step.residual) < left <= 1.001 * TOLERANCE * np.linalg.norm(step.residual)
    assert np.linalg.norm(found - exact) < 0.2 * np.linalg.norm(exact)


@pytest.mark.parametrize("error", [KeyboardInterrupt, MemoryError])
def test_what_ends_it_comes_out_as_it_was_raised(step, monkeypatch, error):
    """PETSc 3.22 makes an error of its own of it, Ctrl-C or not."""

    def stop(*_):
        raise error

    monkeypatch.setattr(inexact_step._Uncoupled, "mult", stop)
    with pytest.raises(error) as told:
        solve_inexactly(step)
    assert told.value.__context__ is None


def test_where_iterations_do_not_suffice_the_step_is_exact(step, monkeypatch):
    monkeypatch.setattr(inexact_step, "ITERATIONS", 1)
    np.testing.assert_array_equal(solve_inexactly(step), step.solve(step.residual))


def test_nothing_stays_in_memory(step):
    """PETSc's objects know the preconditioner, with all its factors, and Python does not see that."""

    def count() -> int:
        gc.collect()
        return sum(isinstance(thing, inexact_step._Uncoupled) for thing in gc.get_objects())

    before = count()
    solve_inexactly(step)
    assert count() == before


def test_small_steps_are_exact(step, monkeypatch):
    monkeypatch.setattr(inexact_step, "FEW", step.unknowns_left)
    np.testing.assert_array_equal(solve_inexactly(step), step.solve(step.residual))


def test_uncoupled_harmonics_are_inverted_exactly(step):
    """The preconditioner is the inverse where no row changes status."""
    balance = step.balance
    first = [replace(d, values=np.tile(d.values[0], (len(d.values), 1))) for d in step.derivatives]
    step = NewtonStep(balance, tuple(first), step.residual)
    preconditioner = inexact_step._Uncoupled(step)
    x = np.random.default_rng(4).normal(size=balance.size)

    class Vector:
        def __init__(self, array):
            self.array = self.array_r = array

    image, back = Vector(step.multiply(x)), Vector(np.zeros(balance.size))
    preconditioner.apply(None, image, back)
    assert len(balance.basis.orders) > 2 * COUPLED
    np.testing.assert_allclose(back.array, x, rtol=1e-6, atol=1e-8)


@pytest.mark.parametrize(("gap", "most"), [(0.0, 75), (1e-3, 90)])
def test_what_springs_remember_spoils_no_preconditioner(gap, most, monkeypatch):
    """Taken as if it were of the sample itself, it cost up to twelve times the iterations on the blade root."""
    monkeypatch.setattr(inexact_step, "FEW", 0)
    monkeypatch.setattr(inexact_step, "ITERATIONS", most)
    laws = ContactLaws(friction=0.3, initial_gap=[gap, 0, 0, 0, 0, 0])
    problem = ContactProblem(dovetail(excitation=120.0), laws, 360.0, ORDERS, closure="spring")
    balance, low = HarmonicBalance(problem.system), solve(replace(problem, harmonics=9))
    assert balance.system.closures == ("springs",)
    forces = np.zeros((ORDERS + 1, balance.rows), dtype=complex)
    forces[: len(low.orders)] = low.forces
    step = balance.linearise(balance.pack(forces, low.rigid))
    monkeypatch.setattr(NewtonStep, "solve", lambda *_: pytest.fail("GMRES took too many iterations"))
    solve_inexactly(step)
