"""The weighted residual against loops written out here, and its Jacobian in stick, slip, open and mixed states."""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import numpy as np
import pytest
from balance_points import FREQUENCY, LAWS, SPRINGS, STATES, Point, combine_with, prepare
from small_models import dovetail, lift_off_oscillator, random_structure, repeat_first_pair

from ewr_fenicsx import ContactLaws, ContactProblem, ReducedModel, solve
from ewr_fenicsx.balance.balance import HarmonicBalance
from ewr_fenicsx.balance.newton_step import Factorisation
from ewr_fenicsx.laws.coulomb import Coulomb
from ewr_fenicsx.laws.mean_friction import HELD, MEAN_FRICTION_REGULARISATION


def evaluate_series(wave: np.ndarray, amplitudes: list) -> float:
    return sum((w * a).real for w, a in zip(wave, amplitudes, strict=True))


def march(drive: list[float], limit: np.ndarray) -> list[float]:
    """Friction force of the second period that follows a drive from no offset, sample by sample."""
    force, period = drive[-1], []
    for _ in range(2):
        period = []
        for i, cone in enumerate(limit):
            force = min(max(force + drive[i] - drive[i - 1], -cone), cone)
            period.append(force)
    return period


def residual_by_loops(problem: ContactProblem, forces: np.ndarray, samples: int) -> np.ndarray:
    """One-sided amplitudes ``(n_h, m)`` of the laws' residuals [N], from the equations of formulation and nothing else.

    Bonded pairs are held by Lagrange multipliers here, not by projection.
    """
    model, orders, omega = problem.model, problem.basis.orders, problem.omega
    active = {"normal": [], "tangential": []}
    bonds, laws_at = [], {}
    for pairs, laws in problem.groups:
        for k in pairs:
            laws_at[int(k)] = laws
    for k in range(model.pairs):
        laws = laws_at[k]
        if laws.normal == "unilateral" or (laws.normal == "bonded" and laws.tangential == "coulomb"):
            active["normal"].append(k)
        elif laws.normal == "bonded":
            bonds.append(model.normal[k])
        if laws.tangential == "coulomb":
            active["tangential"].append(k)
        elif laws.tangential == "bonded":
            bonds.append(model.tangential[k])
    rows = [("normal", k) for k in active["normal"]] + [("tangential", k) for k in active["tangential"]]
    rows.sort(key=lambda row: problem.system.index[row[0]][row[1]])
    B = np.array([getattr(model, direction)[k] for direction, k in rows])
    A = np.array(bonds).reshape(-1, model.size)
    given = {k: laws_at[k].normal_force for k in range(model.pairs) if laws_at[k].normal == "prescribed"}
    given = {k: force if isinstance(force, dict) else {0: force} for k, force in given.items()}
    given = {k: {h: np.broadcast_to(a, model.pairs)[k] for h, a in force.items()} for k, force in given.items()}
    q = []
    for h, force in zip(orders, forces, strict=True):
        w = h * omega
        impedance = model.stiffness + 1j * w * model.damping - w**2 * model.mass
        right = B.T @ force + model.load.get(h, 0) + sum(model.normal[k] * given[k].get(h, 0) for k in given)
        saddle = np.block([[impedance, A.T], [A, np.zeros((len(A), len(A)))]])
        x = np.linalg.solve(saddle, np.concatenate([right, np.zeros(len(A))]))[: model.size]
        q.append(B @ x)
    rho, spring = {}, {}
    for law in problem.system.laws:
        for i, k in enumerate(law.pairs):
            if hasattr(law, "rho"):
                rho[law.direction, int(k)] = law.rho[i]
            else:
                spring[int(k)] = 1 / law.flexibility[i]
    waves = np.exp(2j * np.pi * np.outer(np.arange(samples), orders) / samples)

    def press(k: int) -> np.ndarray:
        if k not in given:
            return np.array([evaluate_series(wave, forces[:, rows.index(("normal", k))]) for wave in waves])
        turn = 2j * np.pi * np.arange(samples) / samples
        return sum((a * np.exp(h * turn)).real for h, a in given[k].items())

    rubbing = {}
    for k in spring:
        r = rows.index(("tangential", k))
        swing = [m[r] * (h > 0) for h, m in zip(orders, q, strict=True)]
        drive = [evaluate_series(w, forces[:, r]) - spring[k] * evaluate_series(w, swing) for w in waves]
        friction = np.broadcast_to(laws_at[k].friction, model.pairs)[k]
        rubbing[k] = march(drive, friction * np.maximum(0.0, press(k)))
    result = np.zeros((len(orders), len(rows)), dtype=complex)
    for i in range(samples):
        wave = waves[i]
        at = partial(evaluate_series, wave)
        for r, (direction, k) in enumerate(rows):
            lam, motion = at([f[r] for f in forces]), at([m[r] for m in q])
            if direction == "normal" and laws_at[k].normal == "bonded":
                value = rho[direction, k] * motion
            elif direction == "normal":
                gap = motion + np.broadcast_to(laws_at[k].initial_gap, model.pairs)[k]
                value = lam + min(0.0, rho[direction, k] * gap - lam)
            elif k in spring:
                value = lam - rubbing[k][i]
            else:
                velocity = at([1j * h * omega * m[r] for h, m in zip(orders, q, strict=True)])
                cone = np.broadcast_to(laws_at[k].friction, model.pairs)[k] * max(0.0, press(k)[i])
                # psi_T = v + min(0, rho (lam + mu c) - v) + max(0, rho (lam - mu c) - v), divided by rho
                p = rho[direction, k]
                value = velocity + min(0.0, p * (lam + cone) - velocity) + max(0.0, p * (lam - cone) - velocity)
                value /= p
            for j, h in enumerate(orders):
                result[j, r] += value * np.exp(-2j * np.pi * h * i / samples) / samples * (1 if h == 0 else 2)
    for r, (direction, k) in enumerate(rows):  # the mean friction: set to zero, or decided by a whisper of itself
        if direction == "tangential" and orders[0] == 0:
            if laws_at[k].static_friction == "zero":
                result[0, r] = 0.0
            elif laws_at[k].static_friction == "held":
                result[0, r] += HELD / problem.system.flexibility[r] * q[0][r]
            else:
                result[0, r] += MEAN_FRICTION_REGULARISATION * forces[0, r]
    return result


@pytest.mark.parametrize("state", STATES)
@pytest.mark.parametrize("kind", LAWS)
def test_residual_is_the_projected_law(kind, state):
    point = prepare(kind, state, samples=32)
    balance = point.balance
    forces, _ = balance.unpack(point.unknowns)
    expected = balance.basis.to_coefficients(residual_by_loops(point.problem, forces, 32))[balance.unknown]
    found = balance.residual(point.unknowns) * balance.force_unit
    np.testing.assert_allclose(found, expected, atol=1e-9 * max(np.abs(expected).max(), np.abs(forces).max()))
    np.testing.assert_array_equal(balance.linearise(point.unknowns).residual, balance.residual(point.unknowns))


@pytest.mark.parametrize("harmonics", [(1, 3, 5), (0, 1, 3, 5), (0, 2, 1), 0, 1])
def test_residual_for_sparse_harmonics(harmonics):
    kind = "bonded coulomb" if harmonics == (1, 3, 5) else "unilateral coulomb"
    if harmonics == 0:
        problem = ContactProblem(random_structure(size=10), LAWS[kind], FREQUENCY, 0)
        balance = HarmonicBalance(problem.system)
        unknowns = np.random.default_rng(0).normal(size=balance.size)
        point = Point(problem, balance, unknowns)
    else:
        point = prepare(kind, "mixed", harmonics, samples=24)
    forces, _ = point.balance.unpack(point.unknowns)
    expected = residual_by_loops(point.problem, forces, point.balance.basis.samples)
    expected = point.balance.basis.to_coefficients(expected)[point.balance.unknown]
    found = point.balance.residual(point.unknowns) * point.balance.force_unit
    np.testing.assert_allclose(found, expected, atol=1e-9 * np.abs(expected).max())


def states_seen(point: Point) -> dict[str, set[str]]:
    """What the pairs do over the period, told from the derivatives of their laws."""
    seen = {"normal": set(), "tangential": set()}
    step = point.balance.linearise(point.unknowns)
    directions = {int(r): d for d, rows in point.balance.system.index.items() for r in rows if r >= 0}
    for d in step.derivatives:
        if np.array_equal(d.rows, d.columns) and d.variable == "force":
            for column, row in enumerate(d.rows):
                seen[directions[int(row)]] |= {float(v) for v in np.unique(d.values[:, column])}
    return seen


@pytest.mark.parametrize("state", STATES)
def test_states_are_what_they_are_called(state):
    """Guards the tests below: 1 = force rows (open, slip), 0 = motion rows (closed, stick)."""
    seen = states_seen(prepare("unilateral coulomb", state))
    expected = {
        "stick": {"normal": {0.0}, "tangential": {0.0}},
        "slip": {"normal": {0.0}, "tangential": {0.0, 1.0}},
        "open": {"normal": {1.0}, "tangential": {1.0}},
        "mixed": {"normal": {0.0, 1.0}, "tangential": {0.0, 1.0}},
    }[state]
    assert seen["normal"] == expected["normal"]
    assert seen["tangential"] == expected["tangential"]


def selections_agree(balance: HarmonicBalance, first: np.ndarray, second: np.ndarray) -> bool:
    one, other = balance.linearise(first).derivatives, balance.linearise(second).derivatives
    same = lambda a, b: np.array_equal(a.values, b.values) and np.array_equal(a.since, b.since)  # noqa: E731
    return all(same(a, b) for a, b in zip(one, other, strict=True))


@pytest.mark.parametrize("kind, harmonics, state", combine_with(3, (1, 3, 5), (0, 2, 1)), ids=str)
def test_jacobian_equals_finite_differences_away_from_kinks(kind, harmonics, state):
    """The residual is piecewise linear: where no sample changes its branch, central differences are exact."""
    point = prepare(kind, state, harmonics, samples=64)
    balance, x = point.balance, point.unknowns
    matrix = balance.linearise(x).matrix()
    assert matrix.shape == (balance.size, balance.size)
    scale, worst = np.abs(matrix).max(), 0.0
    for i in range(balance.size):
        step = np.zeros(balance.size)
        step[i] = 1e-5 * max(1.0, np.abs(x).max())
        while not (selections_agree(balance, x, x + step) and selections_agree(balance, x, x - step)):
            step /= 4
            assert step[i] > 1e-12, "a sample sits on a kink"
        slope = (balance.residual(x + step) - balance.residual(x - step)) / (2 * step[i])
        rounding = 1e-15 * (np.abs(x).max() + scale * np.abs(x).max()) / step[i]
        worst = max(worst, np.abs(slope - matrix[:, i]).max() - 20 * rounding)
    assert worst < 1e-9 * scale


def find_taylor_slope(point: Point, largest: float) -> float:
    """Power of the step with which the remainder falls over four halvings from the largest one."""
    balance, x = point.balance, point.unknowns
    step = balance.linearise(x)
    direction = np.random.default_rng(3).normal(size=balance.size) * np.abs(x).max()
    sizes = largest * 2.0 ** -np.arange(5)
    assert not selections_agree(balance, x, x + sizes[-1] * direction), "nothing bends"
    remainders = [
        np.linalg.norm(balance.residual(x + size * direction) - step.residual - size * step.multiply(direction))
        for size in sizes
    ]
    return np.polyfit(np.log(sizes), np.log(remainders), 1)[0]


# Springs remember: longer steps make other slips the last ones
SHORTER = {"bonded coulomb, mean zero, springs": 5e-5, "groups, springs": 2e-4}


@pytest.mark.parametrize("kind", LAWS)
def test_taylor_remainder_falls_with_the_square_of_the_step(kind):
    """Across kinks too: the share of a densely sampled period that changes its branch shrinks with the step."""
    point = prepare(kind, "mixed", harmonics=2, samples=2**16)
    assert 1.9 < find_taylor_slope(point, SHORTER.get(kind, 1e-3)) < 2.1


# Of the laws under which pairs turn and stick for a while; the limit of a given normal force leaves them short turns
SLIPPING = {kind: 5e-3 for kind in LAWS if not kind.endswith(SPRINGS) and ("coulomb" in kind or "group" in kind)}
SLIPPING |= {kind: 0.08 for kind in SLIPPING if kind.startswith(("prescribed coulomb", "varying"))}


@pytest.mark.parametrize("kind", SLIPPING)
def test_taylor_remainder_of_pairs_that_slip_falls_with_the_square_of_the_step(kind):
    """The samples that change their branch are those next to a turn of the slip. (With springs far fewer are.)"""
    point = prepare(kind, "slip", harmonics=2, samples=2**16)
    assert 1.9 < find_taylor_slope(point, SLIPPING[kind]) < 2.1


@pytest.mark.parametrize("state", ["stick", "open"])
@pytest.mark.parametrize("kind", LAWS)
def test_taylor_remainder_vanishes_where_no_sample_changes_its_branch(kind, state):
    """Pairs that are well closed and stuck throughout, or wide open: the laws are linear there."""
    point = prepare(kind, state)
    balance, x = point.balance, point.unknowns
    direction = 1e-3 * np.random.default_rng(3).normal(size=balance.size) * np.abs(x).max()
    assert selections_agree(balance, x, x + direction)
    step = balance.linearise(x)
    remainder = balance.residual(x + direction) - step.residual - step.multiply(direction)
    assert np.abs(remainder).max() < 1e-13 * np.abs(x).max() * balance.size


@pytest.mark.parametrize("kind, harmonics, state", combine_with(3, (1, 3, 5), 9), ids=str)
def test_products_and_eliminated_solves_are_those_of_the_dense_matrix(kind, harmonics, state):
    """Row elimination takes exactly the dense Newton step."""
    point = prepare(kind, state, harmonics)
    step = point.balance.linearise(point.unknowns)
    check_against_dense(step, point.balance)


def check_against_dense(step, balance: HarmonicBalance) -> None:
    matrix = step.matrix()
    rng = np.random.default_rng(9)
    for _ in range(2):
        vector = rng.normal(size=balance.size)
        product = matrix @ vector
        # the matrix holds 1e-13 of each row's flexibility on its diagonal, so that redundant pairs stay solvable
        np.testing.assert_allclose(
            step.multiply(vector), product, atol=1e-11 * np.abs(matrix).max() * np.abs(vector).max()
        )
        dense = np.linalg.solve(matrix, vector)
        tolerance = 1e-10 if np.linalg.cond(matrix) < 1e6 else 1e-16 * np.linalg.cond(matrix)
        np.testing.assert_allclose(step.solve(vector), dense, atol=tolerance * np.abs(dense).max())
        assert np.linalg.norm(matrix @ step.solve(vector) - vector) < 1e-10 * np.linalg.norm(vector) * max(
            1.0, np.abs(matrix).max() * np.abs(dense).max() / np.abs(vector).max() * 1e-3
        )
    check_second_right_side(step, rng.normal(size=balance.size), vector)


def check_second_right_side(step, first, second) -> None:
    """Factors made for one right side solve for another, and products know of the shift."""
    shifted = step.matrix(0.05)
    product = step.multiply(second, 0.05)
    np.testing.assert_allclose(product, shifted @ second, atol=1e-11 * np.abs(shifted).max() * np.abs(second).max())
    expected = step.solve(second, 0.05)
    tolerance = max(1e-10, 1e-16 * np.linalg.cond(shifted))
    np.testing.assert_allclose(
        Factorisation(step, first, 0.05).solve(second), expected, atol=tolerance * np.abs(expected).max()
    )


@pytest.mark.parametrize(
    "kind", [("unilateral", "coulomb"), ("unilateral", "frictionless"), ("bonded", "coulomb")], ids="-".join
)
@pytest.mark.parametrize("noise", [0.0, 0.3, 3.0])
@pytest.mark.parametrize("inverse", ["inertia relief", "pinned"])
def test_floating_bodies_products_solves_and_finite_differences(kind, noise, inverse):
    """From full stick (all rows steady) to rows that change status, with the rigid motions among the unknowns."""
    normal, tangential = kind
    model = dovetail(excitation=60.0 if noise else 0.1)
    problem = ContactProblem(
        model, ContactLaws(normal, tangential, friction=0.5), 300.0, 3, generalised_inverse=inverse
    )
    balance = HarmonicBalance(problem.system)
    rng = np.random.default_rng(1)
    x = balance.pack(*balance.full_stick)
    x = x + noise * rng.normal(size=x.size) * np.abs(x).mean()
    step = balance.linearise(x)
    assert balance.rigid == 3
    if noise == 0.0:
        assert step.steady.all()
    if noise == 3.0:
        assert not step.steady.all()
    check_against_dense(step, balance)
    matrix, scale = step.matrix(), np.abs(step.matrix()).max()
    for i in [*rng.choice(balance.size, 12, replace=False), balance.size - 1, balance.size - 3]:
        h = np.zeros(balance.size)
        h[i] = 1e-5
        while not (selections_agree(balance, x, x + h) and selections_agree(balance, x, x - h)):
            h /= 4
            assert h[i] > 1e-12
        slope = (balance.residual(x + h) - balance.residual(x - h)) / (2 * h[i])
        np.testing.assert_allclose(slope, matrix[:, i], atol=1e-9 * scale + 1e-14 * scale * np.abs(x).max() / h[i])


def test_full_stick_closes_every_gap_and_stops_every_slip():
    model = lift_off_oscillator()
    problem = ContactProblem(model, ContactLaws(initial_gap=0.05), 0.1, 3)
    balance = HarmonicBalance(problem.system)
    forces, rigid = balance.full_stick
    motion = balance.compliance.motion(forces, rigid)
    np.testing.assert_allclose(motion[:, 0], [-0.05, 0, 0, 0], atol=1e-12)
    np.testing.assert_allclose(motion[1:, 1], 0, atol=1e-12)
    assert forces[0, 1] == 0.0, "the mean friction force of a pair that sticks is taken as zero"


def test_full_stick_of_a_floating_body_balances_its_loads():
    problem = ContactProblem(dovetail(), ContactLaws(), 300.0, 3)
    balance = HarmonicBalance(problem.system)
    forces, rigid = balance.full_stick
    c = balance.compliance
    np.testing.assert_allclose(
        c.rigid_motion.T @ forces[0].real, -c.rigid_load, atol=1e-10 * np.abs(c.rigid_load).max()
    )
    motion = c.motion(forces, rigid)
    assert np.abs(motion[:, :6]).max() < 1e-10 * np.abs(c.free_motion).max()
    assert np.abs(motion[1:]).max() < 1e-10 * np.abs(c.free_motion).max()


def test_the_firm_balance_takes_the_laws_answers_from_the_balance_and_differs_in_the_mean_alone(monkeypatch):
    problem = ContactProblem(dovetail(), ContactLaws(friction=0.2), 900.0, harmonics=3)
    balance, seen = HarmonicBalance(problem.system), []
    evaluate = Coulomb.evaluate
    monkeypatch.setattr(Coulomb, "evaluate", lambda law, motion: seen.append(law) or evaluate(law, motion))
    point = balance.pack(*balance.full_stick) + 0.1
    soft, firm = balance.residual(point), balance.firm.residual(point)
    balance.firm.linearise(point)
    assert len(seen) == 1
    differs = balance.place(soft - firm) != 0
    assert np.any(differs[0]) and not np.any(differs[1:])
    alone = HarmonicBalance(problem.system, balance.force_unit, balance.firm.least_share)
    np.testing.assert_array_equal(firm, alone.residual(point))
    balance.residual(point + 0.1)
    np.testing.assert_array_equal(balance.firm.residual(point), firm)
    assert len(seen) == 4


def test_packing_round_trip():
    balance = HarmonicBalance(ContactProblem(dovetail(), ContactLaws(static_friction="zero"), 300.0, 3).system)
    x = np.random.default_rng(2).normal(size=balance.size)
    np.testing.assert_allclose(balance.pack(*balance.unpack(x)), x, rtol=1e-14)
    forces, _ = balance.unpack(x)
    assert np.all(forces[0, 6:] == 0.0) and np.all(forces[0, :6] != 0.0)


@pytest.mark.parametrize("factor", [1e-9, 1e-3, 1e6])
def test_scaled_unknowns_know_no_unit_of_force(factor):
    """Loads times c: the same scaled unknowns, residual and Jacobian, so the same steps to the same tolerance."""
    model = dovetail()
    scaled = replace(model, load={h: factor * f for h, f in model.load.items()})
    one, other = (HarmonicBalance(ContactProblem(m, ContactLaws(), 300.0, 3).system) for m in (model, scaled))
    x = one.pack(*one.full_stick) + 0.1 * np.random.default_rng(4).normal(size=one.size)
    np.testing.assert_allclose(other.residual(x), one.residual(x), atol=1e-12)
    np.testing.assert_allclose(other.linearise(x).matrix(), one.linearise(x).matrix(), atol=1e-12)


def test_redundant_pairs_stay_solvable():
    """The same pair twice: forces are not unique, but the Newton step exists and solves the linearised balance."""
    twice = repeat_first_pair(lift_off_oscillator())
    balance = HarmonicBalance(ContactProblem(twice, ContactLaws(), 0.1, 3).system)
    x = balance.pack(*balance.full_stick)
    step = balance.linearise(x)
    direction = step.solve(-step.residual + 1e-3)
    assert np.all(np.isfinite(direction))
    np.testing.assert_allclose(step.multiply(direction), -step.residual + 1e-3, atol=1e-6)


def test_what_a_floating_body_gives_way_to_is_no_unit_of_force():
    """Full stick closes what overlaps; where a rigid motion does that, it takes forces that are rounding, not none."""
    rng, arms = np.random.default_rng(0), np.linspace(-1.0, 1.0, 6)
    root = rng.normal(size=(6, 6))
    stiffness = np.pad(1e6 * (np.eye(6) + root @ root.T), ((2, 0), (2, 0)))
    normal = np.column_stack([np.ones(6), arms, -np.eye(6)])
    block = ReducedModel(np.eye(8), 1e-5 * stiffness, stiffness, normal, None)
    laws = ContactLaws(tangential="frictionless", initial_gap=-1e-5 * (1 + 0.5 * arms))
    problem = ContactProblem(block, laws, 0.0, 0)
    balance = HarmonicBalance(problem.system)
    assert 0 < np.linalg.norm(balance.full_stick[0]) < 1e-9, "rounding, or nothing is looked at"
    assert balance.force_unit == 1.0
    solution = solve(problem)
    assert solution.iterations == 0 and np.abs(solution.forces).max() < 1e-9
