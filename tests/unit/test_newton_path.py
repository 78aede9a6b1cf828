"""Newton's path: corners crossed one by one, folds among them, to a solution of the balance."""

from __future__ import annotations

import re
from dataclasses import replace

import hard_cases
import numpy as np
import pytest
from small_models import dovetail

from ewr_fenicsx import ContactLaws, ContactProblem, solve
from ewr_fenicsx.balance.balance import HarmonicBalance
from ewr_fenicsx.balance.newton_step import Factorisation
from ewr_fenicsx.errors import ModelError
from ewr_fenicsx.laws.coulomb import Coulomb
from ewr_fenicsx.laws.law_kinds import Motion
from ewr_fenicsx.laws.smoothing import round_corners
from ewr_fenicsx.laws.unilateral import Signorini
from ewr_fenicsx.solver import newton_path
from ewr_fenicsx.solver.growing_load import load_by_share
from ewr_fenicsx.solver.newton_path import (
    SHORT,
    RankOneUpdates,
    can_follow,
    follow_from_afar,
    follow_path,
    limit_corners,
    run_and_follow,
)
from ewr_fenicsx.solver.snes import run_newton
from ewr_fenicsx.solver.weights import use_default_weights

LAWS = {
    "contact": ContactLaws(tangential="frictionless"),
    "both": ContactLaws(friction=0.3),
    "friction": ContactLaws(normal="bonded", friction=0.3),
}


def pose(laws: ContactLaws, **options) -> ContactProblem:
    return ContactProblem(dovetail(excitation=150.0), laws, 480.0, **({"harmonics": 5} | options))


@pytest.fixture
def balance() -> HarmonicBalance:
    return HarmonicBalance(pose(LAWS["both"]).system)


@pytest.mark.parametrize("name", LAWS)
def test_corners_tell_the_derivatives(name):
    """Those by the sides of the corners are those of ``evaluate``, bit by bit."""
    rng = np.random.default_rng(3)
    system = pose(LAWS[name]).system
    balance = HarmonicBalance(system)
    forces, motion = rng.normal(size=(2, len(balance.basis.orders), balance.rows)) + 0j
    for law, at in zip(system.laws, balance.sample(1e3 * forces, 1e-5 * motion), strict=True):
        if law.linear:
            continue
        sides = [corner > 0 for corner in law.find_corners(at)]
        assert any(0 < side.mean() < 1 for side in sides), "both sides are to be seen"
        for told, expected in zip(law.differentiate(sides), law.evaluate(at).partials, strict=True):
            assert (told.variable, told.direction) == (expected.variable, expected.direction)
            np.testing.assert_array_equal(told.values, expected.values)


@pytest.mark.parametrize("name", LAWS)
def test_corner_functions_are_linear(name):
    system = pose(LAWS[name]).system
    balance = HarmonicBalance(system)
    rng = np.random.default_rng(4)
    here, there = rng.normal(size=(2, 2, len(balance.basis.orders), balance.rows)) + 0j
    looks = [balance.sample(*at) for at in (here, there, 0.5 * (here + there))]
    for law, *seen in zip(system.laws, *looks, strict=True):
        if not law.linear:
            a, b, middle = (np.array(law.find_corners(at)) for at in seen)
            np.testing.assert_allclose(middle, 0.5 * (a + b), atol=1e-12 * np.abs(a).max())


@pytest.mark.parametrize(("name", "far"), [("contact", 1e-3), ("both", 0.01), ("friction", 3.0)])
def test_it_ends_at_the_solution(name, far):
    """Over many corners and without a line search; under forces that only friction has to find, from anywhere."""
    problem = pose(LAWS[name])
    balance, solution = HarmonicBalance(problem.system), solve(problem)
    expected = balance.pack(solution.forces, solution.rigid)
    start = expected + far * np.random.default_rng(5).normal(size=balance.size) / np.sqrt(balance.size)
    found = follow_path(balance, start, 1e-9, 20_000, tried=20_000)
    assert found.converged and found.iterations >= 1
    assert np.linalg.norm(balance.residual(found.unknowns)) <= 1e-9
    np.testing.assert_allclose(found.unknowns, expected, atol=1e-5 * np.linalg.norm(expected))


def test_its_residual_is_the_share_that_it_says(balance):
    """Along the whole path the residual is a multiple of the first one."""
    start = balance.pack(*balance.full_stick)
    path = newton_path._Path(balance, start, balance)
    path.follow(1e-9, 20)
    assert path.crossed == 20 and 0 < path.share < 1
    left = (1 - path.share) * balance.residual(start)
    np.testing.assert_allclose(balance.residual(path.unknowns), left, atol=1e-10)


def test_under_growing_loads_too(balance):
    """At every load on the way: by rounding from a solution where it begins at one, else by a share of the first."""
    firm = balance.firm
    for share, start in ((0.02, None), (0.5, firm.pack(*firm.full_stick))):
        first = load_by_share(balance, share)
        if start is None:
            start = run_newton(first, first.pack(*first.full_stick), 1e-11, "elimination").unknowns
        path = newton_path._Path(firm, start, first)
        path.follow(1e-9, 20)
        assert path.crossed == 20 and 0 < path.share < 1
        here = load_by_share(balance, share + (1 - share) * path.share)
        left = (1 - path.share) * first.residual(start)
        np.testing.assert_allclose(here.residual(path.unknowns), left, atol=1e-9)


def test_loads_grow_to_the_solution(balance):
    """Without a start near it, and without a fold here, which would add corners: several statuses change on the way."""
    firm, first = balance.firm, load_by_share(balance, 0.02)
    begin = run_newton(first, first.pack(*first.full_stick), 1e-11, "elimination").unknowns
    found = follow_path(firm, begin, 1e-8, 20_000, first, tried=20_000)
    assert found.converged and found.iterations > 1
    few = follow_path(firm, begin, 1e-8, 50, first)
    assert not few.converged and re.match(r"Newton's path takes \d+% of the load in 50 corners", few.reason)
    solution = solve(pose(LAWS["both"]))
    closer = run_newton(balance, found.unknowns, 1e-10, "elimination", near=True)
    expected = balance.pack(solution.forces, solution.rigid)
    np.testing.assert_allclose(closer.unknowns, expected, atol=1e-6 * np.linalg.norm(expected))


def test_updates_are_those_of_the_matrix(balance):
    """Each corner's change of rank one, against Jacobians assembled on the pieces before and behind it.

    And of what growing loads pull, against what the assembled derivatives make of them.
    """
    path = newton_path._Path(balance, balance.pack(*balance.full_stick), load_by_share(balance, 0.5))
    path.follow(1e-9, 20)  # to where statuses differ
    assemble = lambda: newton_path.NewtonStep(balance, path._differentiate(), path.begin)  # noqa: E731
    before = assemble()
    updates, right, changed = RankOneUpdates(Factorisation(before, path.begin)), path.begin, 0
    ahead, determinant = updates.factors.solution, np.linalg.slogdet(before.matrix())
    for number, sides in enumerate(path.sides):
        for corner in np.argwhere(sides)[:: max(1, sides.size // 12)]:
            if (change := path._cross(number, tuple(corner))) is None:
                continue
            u, w, pull = change
            moved, ratio = updates.add(u, w)
            ahead = ahead - (w @ ahead / ratio) * moved
            matrix = assemble().matrix()
            np.testing.assert_allclose(matrix, before.matrix() + np.outer(u, w), atol=1e-9 * np.abs(matrix).max())
            pulls = [path._find_pull(step) for step in (before, assemble())]
            np.testing.assert_allclose(pulls[1], pulls[0] + pull * u, atol=1e-9 * np.abs(pulls[1]).max())
            sign, logarithm = np.linalg.slogdet(matrix)
            assert np.sign(ratio) == sign * determinant[0]
            np.testing.assert_allclose(np.log(np.abs(ratio)), logarithm - determinant[1], atol=1e-6)
            np.testing.assert_allclose(ahead, np.linalg.solve(matrix, right), rtol=1e-5, atol=1e-7)
            before, determinant, changed = assemble(), (sign, logarithm), changed + 1
    assert changed > 10


def test_updates_past_a_matrix_that_is_all_but_singular_stay_accurate(balance):
    """The inverse of the small matrix is bordered: what rounding made of it there would stay in it for good."""
    step = balance.linearise(balance.pack(*balance.full_stick))
    updates, matrix, rng = RankOneUpdates(Factorisation(step, step.residual)), step.matrix(), np.random.default_rng(8)
    ahead = updates.factors.solution
    for k in range(60):
        u, w = rng.normal(size=(2, balance.size)) / balance.size
        if k % 20 == 10:  # the determinant nearly vanishes, and the next change takes it back
            u *= (1e-9 - 1.0) / (w @ np.linalg.solve(matrix, u))
            back = u, w
        elif k % 20 == 11:
            u, w = -back[0], back[1]
        moved, ratio = updates.add(u, w)
        assert k % 20 != 10 or abs(ratio) < 1e-8
        ahead, matrix = ahead - (w @ ahead / ratio) * moved, matrix + np.outer(u, w)
    right = rng.normal(size=balance.size)
    found = updates.add(right, np.zeros(balance.size))[0]
    expected = np.linalg.solve(matrix, right)
    np.testing.assert_allclose(found, expected, atol=1e-8 * np.abs(expected).max())


def test_what_rounding_adds_up_to_does_not_stay(balance):
    """With every factorisation a path goes back to where it should be."""
    path = newton_path._Path(balance, balance.pack(*balance.full_stick), balance)
    begin, size = path.begin, np.sqrt(balance.size)
    path.unknowns += 1e-7 * np.random.default_rng(9).normal(size=balance.size) / size
    off = np.linalg.norm(balance.residual(path.unknowns) - begin)
    path.follow(1e-9, 3)
    assert path.crossed == 3 and off > 1e-8
    left = balance.residual(path.unknowns) - (1 - path.share) * begin
    assert np.linalg.norm(left) < 1e-3 * off


def find_stalled(case: hard_cases.Case, steps: int):
    """A balance with weights far off, the solution with the default ones, and where Newton's method stalls from it."""
    problem = hard_cases.pose_case(case)
    usual, balance = solve(use_default_weights(problem)), HarmonicBalance(problem.system)
    begin = balance.pack(usual.forces, usual.rigid)
    stalled = run_newton(balance, begin, 1e-8, "elimination", steps, near=True)
    assert not stalled.converged
    return balance, begin, stalled


def test_it_arrives_where_newton_stalls():
    """With a line search: 24 steps to a residual of 2e-5. Over some corners: a factorisation."""
    case = hard_cases.Case("dovetail", 2.0, ("reached", 3.0), 0.01, 15, 1e-3, "closed", (1, 1e-3))
    balance, _, stalled = find_stalled(case, 12)
    found = follow_path(balance, stalled.unknowns, 1e-8, SHORT)
    assert found.converged and found.iterations <= 2
    assert np.linalg.norm(balance.residual(found.unknowns)) <= 1e-8


def test_it_arrives_from_afar():
    """Where what Newton's method has to go through is no descent: a thousand corners in four factorisations."""
    case = hard_cases.Case("lap joint", 1.05, ("applied", 0.3), 1.5, 9, 0.02, "random", (1e-3, 1e-3))
    balance, begin, _ = find_stalled(case, 40)
    assert np.linalg.norm(balance.residual(begin)) > newton_path.CLOSE
    found = follow_from_afar(balance, begin, 1e-8)
    assert found.converged and found.iterations <= 8
    assert np.linalg.norm(balance.residual(found.unknowns)) <= 1e-8


def test_a_path_from_afar_is_left_where_it_is_not_on_its_way():
    case = hard_cases.Case("blade root", 0.7, ("reached", 1.0), 0.6, 3, 0.005, "closed", (1e-3, 1e-3))
    balance, begin, _ = find_stalled(case, 2)
    left = follow_from_afar(balance, begin, 1e-8)
    assert not left.converged and left.reason.endswith(f"of the residual in {newton_path.FAR_TRIED} corners")


def test_no_path_begins_nowhere_or_far_off_in_large_joints(balance, monkeypatch):
    start = balance.pack(*balance.full_stick)
    assert follow_from_afar(balance, np.full(balance.size, np.nan), 1e-9) is None
    assert follow_from_afar(balance, 1e9 * start, 1e-9) is None
    monkeypatch.setattr(newton_path, "LARGEST_FAR", balance.size - 1)
    assert follow_from_afar(balance, start, 1e-9) is None
    monkeypatch.setattr(newton_path, "CLOSE", np.inf)  # next to a solution
    assert follow_from_afar(balance, start, 1e-9).iterations > 0


@pytest.mark.parametrize("why", [newton_path.ARRIVED, newton_path.SINGULAR])
def test_rounding_at_the_end_of_a_path_is_taken_away(balance, monkeypatch, why):
    """A path of many corners ended at a residual of 3e-8, and counted for nothing. Elsewhere no run is begun."""
    exact = run_newton(balance, balance.pack(*balance.full_stick), 1e-12, "elimination")
    assert exact.converged
    off = exact.unknowns + 1e-7 * np.random.default_rng(3).normal(size=balance.size)
    monkeypatch.setattr(newton_path._Path, "follow", lambda path, *_: setattr(path, "unknowns", off) or why)
    found = follow_path(balance, exact.unknowns, 1e-10, SHORT)
    assert found.converged == (why == newton_path.ARRIVED) == (found.iterations > 0)


def test_it_turns_at_folds(balance):
    """Where the determinant changes sign the residual grows for a while, and the path goes on."""
    start = balance.pack(*balance.full_stick)
    start += (
        0.3 * np.random.default_rng(11).normal(size=balance.size) / np.sqrt(balance.size)
    )  # from where it soon does
    path = newton_path._Path(balance, start, balance)
    shares, cross = [], path._cross
    path._cross = lambda *at: shares.append(path.share) or cross(*at)
    path.follow(1e-8, 2000, tried=2000)
    turns = np.flatnonzero(np.diff(np.sign(np.diff(shares))[np.diff(shares) != 0]))
    assert turns.size > 1
    np.testing.assert_allclose(balance.residual(path.unknowns), (1 - path.share) * path.begin, atol=1e-9)


def test_a_step_to_nowhere_ends_the_path_where_it_is(balance, monkeypatch):
    """As of a matrix that is all but singular: its point was no number, and the next evaluation raised."""
    start = balance.pack(*balance.full_stick)
    monkeypatch.setattr(Factorisation, "_solve_mixed", lambda self, b: np.full(self.columns.size, np.nan))
    found = follow_path(balance, start, 1e-9, 50)
    assert not found.converged and found.reason == "the Newton matrix is singular"
    np.testing.assert_array_equal(found.unknowns, start)


def test_a_change_that_makes_the_matrix_singular_ends_the_path(balance, monkeypatch):
    add = RankOneUpdates.add
    monkeypatch.setattr(RankOneUpdates, "add", lambda *given: (add(*given)[0], 0.0))
    found = follow_path(balance, balance.pack(*balance.full_stick), 1e-9, 50)
    assert not found.converged and found.reason == "the Newton matrix is singular"
    assert np.all(np.isfinite(found.unknowns))


def test_a_path_says_how_far_it_went(balance):
    found = follow_path(balance, balance.pack(*balance.full_stick), 1e-9, 5)
    assert not found.converged and found.reason.endswith("of the residual in 5 corners")


def test_a_run_goes_on_along_the_path_only_next_to_a_solution(balance, monkeypatch):
    followed, follow = [], newton_path.follow_path
    monkeypatch.setattr(newton_path, "follow_path", lambda *given: followed.append(given[3]) or follow(*given))
    start = balance.pack(*balance.full_stick)
    far = run_and_follow(balance, start, 1e-9, "elimination", 1)
    assert not far.converged and far.iterations == 1 and not followed
    monkeypatch.setattr(newton_path, "CLOSE", np.inf)
    found = run_and_follow(balance, start, 1e-9, "elimination", 1)
    assert found.converged and found.iterations > 1 and followed == [limit_corners(balance)]


def test_laws_that_remember_tell_no_corners():
    """Their start goes on without."""
    balance = HarmonicBalance(pose(LAWS["both"], closure="spring").system)
    assert not can_follow(balance) and follow_path(balance, np.zeros(balance.size), 1e-8, SHORT) is None
    assert run_and_follow(balance, balance.pack(*balance.full_stick), 1e-8, "elimination", 2).iterations == 2


def test_rounded_laws_have_no_corners():
    system = pose(LAWS["both"]).system
    assert not can_follow(HarmonicBalance(round_corners(system, 1.0))) and can_follow(HarmonicBalance(system))


def test_the_work_of_a_path_is_bounded(balance):
    large = replace(pose(LAWS["both"]), harmonics=40)
    assert limit_corners(balance) == newton_path.CORNERS
    monstrous = HarmonicBalance(large.system)
    monstrous.size = 10_000
    assert limit_corners(monstrous) * monstrous.size <= newton_path.WORK


def test_motions_are_read_as_laws_see_them():
    """A law's derivative by anything that it may see, against the change of that signal."""
    from ewr_fenicsx.balance.law_derivatives import Derivative

    balance = HarmonicBalance(pose(LAWS["both"]).system)
    path, rng = newton_path._Path(balance, balance.pack(*balance.full_stick), balance), np.random.default_rng(6)
    ahead, sample, pair = rng.normal(size=balance.size), 17, 2
    forces, rigid = balance.unpack(ahead)
    motion = balance.compliance.motion(forces, rigid) - balance.compliance.free_motion
    seen = balance.sample(forces, motion)[0]
    for variable in Motion._fields:
        for direction in ("normal", "tangential"):
            column = balance.system.row_of(direction, np.array([pair]))
            read = path._read(sample, Derivative(column, column, variable, np.array([[2.0]])))
            by_forces, by_rigid, pull = read
            assert pull == 0, "no load grows here"
            told = (
                by_forces[balance.unknown] @ ahead[: balance.size - balance.rigid] + by_rigid @ ahead[-balance.rigid :]
            )
            expected = 2.0 * getattr(seen, variable)[direction][sample, pair] / balance.force_unit
            np.testing.assert_allclose(told, expected, rtol=1e-9, atol=1e-12 * abs(expected))


def test_a_law_that_does_not_tell_its_corners_is_refused(monkeypatch):
    monkeypatch.delattr(Coulomb, "differentiate")
    with pytest.raises(
        ModelError, match=r"Coulomb\.has_corners, but it has no differentiate; give that, or leave both"
    ):
        HarmonicBalance(pose(LAWS["both"]).system)


def test_corners_of_another_shape_are_refused(balance, monkeypatch):
    monkeypatch.setattr(Signorini, "find_corners", lambda law, motion: (motion.force["normal"][0],))
    with pytest.raises(
        ModelError, match=r"Signorini\.find_corners returns an array of shape \(6,\); give some of \(256"
    ):
        follow_path(balance, balance.pack(*balance.full_stick), 1e-9, SHORT)
