"""The time integrator's parts: starts, steps, contact solves, histories, reports and errors."""

from __future__ import annotations

from dataclasses import replace

import hypothesis
import hypothesis.strategies as some
import numpy as np
import pytest
from small_models import bar_against_wall, dovetail, lift_off_oscillator

from ewr_fenicsx import ContactLaws, ContactProblem, ReducedModel, solve
from ewr_fenicsx.errors import ModelError
from ewr_fenicsx.in_time import compiled_loop, time_stepping
from ewr_fenicsx.in_time.time_stepping import State, TimeScheme
from ewr_fenicsx.solver.time_integration import integrate, resample


def chain_of(pairs: int, seed: int = 0, damping: str = "proportional", press: float = 12.0) -> ReducedModel:
    """Random masses and springs to the ground, 2 coordinates a pair (along, across) and two more of the body."""
    rng = np.random.default_rng(seed)
    n = 2 * pairs + 2
    spread = rng.normal(size=(n, n))
    mass = np.diag(rng.uniform(0.5, 1.5, n))
    stiffness = spread @ spread.T + n * np.eye(n)
    rough = rng.normal(size=(n, n))
    rows = np.eye(n)
    proportional, coupled = 0.05 * mass + 0.01 * stiffness, 0.02 * rough @ rough.T
    damp = {"none": 0 * mass, "proportional": proportional, "coupled": coupled}[damping]
    return ReducedModel(
        mass=mass, damping=damp, stiffness=stiffness,
        normal=rows[1 : 2 * pairs : 2], tangential=rows[0 : 2 * pairs : 2],
        load={0: -press * rows[1 : 2 * pairs : 2].sum(axis=0), 1: 3 * (rng.normal(size=n) + 1j * rng.normal(size=n))},
        outputs={"body": rows[-1], "other": rows[-2]},
    )  # fmt: skip


def pose(model: ReducedModel, laws=None, frequency: float = 0.5, harmonics: int = 3) -> ContactProblem:
    return ContactProblem(model, laws or ContactLaws(friction=0.3), frequency, harmonics)


@pytest.mark.parametrize("damping", ["proportional", "coupled"])
def test_linear_joint_converges_to_the_harmonic_solution_at_second_order(damping):
    """Bonded pairs leave no contact rows: forces in the bonds, outputs and slips must be those of the linear solve."""
    problem = pose(chain_of(2, damping=damping), ContactLaws(normal="bonded", tangential="bonded"))
    problem = replace(problem, load={h: 1.5 * f for h, f in problem.model.load.items()})  # not the model's own
    exact = solve(problem)
    errors = []
    for steps in (100, 200):
        result = integrate(problem, "rest", steps=steps, periods=400, tolerance=1e-10)
        assert result.converged
        assert result.scheme.is_diagonal == (damping == "proportional" and result.scheme.rows.size == 0)
        error = [np.abs(result.output("body") - exact.output("body")).max() / np.abs(exact.output("body")).max()]
        for name in ("normal_force", "friction_force"):
            theirs = exact.history(name, 50)
            error.append(np.abs(result.history(name, 50) - theirs).max() / np.abs(theirs).max())
        errors.append(error)
        assert np.abs(result.history("slip")).max() < 1e-12 and np.abs(result.history("gap")).max() < 1e-12
    assert np.array(errors[1]) == pytest.approx(np.array(errors[0]) / 4, rel=0.15)
    assert max(errors[1]) < 5e-3


def test_dense_path_takes_the_same_steps_as_the_diagonal_one(monkeypatch):
    problem = pose(chain_of(3))
    diagonal = integrate(problem, steps=60, periods=3, tolerance=0)
    monkeypatch.setattr(time_stepping, "_DIAGONAL", -1.0)
    dense = integrate(problem, steps=60, periods=3, tolerance=0)
    assert diagonal.scheme.is_diagonal and not dense.scheme.is_diagonal
    assert dense.transient("body") == pytest.approx(diagonal.transient("body"), rel=1e-6, abs=1e-8)


def test_compiled_loop_is_the_loop_that_is_read(monkeypatch):
    problem = pose(chain_of(2))
    compiled = integrate(problem, steps=20, periods=2, tolerance=0)
    monkeypatch.setattr("ewr_fenicsx.in_time.time_stepping.compile_loop", lambda: compiled_loop.step_through_period)
    plain = integrate(problem, steps=20, periods=2, tolerance=0)
    assert plain.last.sweeps == compiled.last.sweeps
    assert plain.last.impulses == pytest.approx(compiled.last.impulses, rel=1e-9, abs=1e-12)


@hypothesis.settings(max_examples=40)
@hypothesis.given(
    seed=some.integers(0, 10**6),
    friction=some.sampled_from([0.0, 0.1, 0.5, 1.0]),
    speed=some.floats(0.0, 10.0),
    damping=some.sampled_from(["none", "proportional", "coupled"]),
)
def test_every_step_obeys_the_laws_and_the_equation_of_motion(seed, friction, speed, damping):
    """Signorini on g + dt v_N, Coulomb on v_T, and M dv = dt (f - D v - K x) + B^T p at the middle of each step."""
    model = chain_of(3, seed, damping, press=4.0)
    problem = pose(model, ContactLaws(friction=friction, initial_gap=0.01))
    rng = np.random.default_rng(seed)
    start = State(rng.normal(size=8) * 0.1, speed * rng.normal(size=8))
    result = integrate(problem, start, steps=40, periods=1, tolerance=0, contact_tolerance=1e-13)
    assert result.unsolved == 0
    scheme, last = result.scheme, result.last
    x, v = last.positions @ scheme.expansion.T, last.velocities @ scheme.expansion.T
    p_N, p_T = last.impulses[:, :3], last.impulses[:, 3:]
    ahead = x[:-1] @ model.normal.T + 0.01 + scheme.dt * v[1:] @ model.normal.T
    slip = v[1:] @ model.tangential.T
    small = 1e-9 * (1 + np.abs(v).max())
    assert np.all(p_N >= 0) and np.all(ahead >= -small) and np.all(np.minimum(p_N, ahead) <= small)
    assert np.all(np.abs(p_T) <= friction * p_N + small)
    assert np.all(p_T * slip <= small) and np.all(np.minimum(friction * p_N - np.abs(p_T), np.abs(slip)) <= small)
    middle = lambda values: 0.5 * (values[1:] + values[:-1])  # noqa: E731
    tau = 2 * np.pi * np.arange(41)[:, None] / 40
    force = model.load[0].real + (np.exp(1j * tau) * model.load[1]).real
    change = scheme.dt * (middle(force) - middle(v) @ model.damping.T - middle(x) @ model.stiffness.T)
    change += p_N @ model.normal + p_T @ model.tangential
    assert np.diff(v, axis=0) @ model.mass == pytest.approx(change, abs=1e-9 * (1 + np.abs(v).max()))


def test_bonded_normal_pulls_and_still_limits_friction():
    """A bond holds in tension; friction then has no limit force to live on."""
    model = chain_of(2)
    problem = pose(model, ContactLaws(normal="bonded", tangential="coulomb", friction=0.4))
    result = integrate(problem, "rest", steps=200, periods=300, tolerance=1e-8)
    normal, friction = result.last.impulses[:, :2], result.last.impulses[:, 2:]
    assert normal.min() < 0 < normal.max()
    assert np.abs(result.history("gap")).max() < 1e-9
    assert np.all(np.abs(friction) <= 0.4 * np.maximum(0, normal) * (1 + 1e-7) + 1e-12)
    assert np.abs(friction[normal < 0]).max() == 0


def test_prescribed_normal_force_may_vary_and_lift_off():
    """The limit follows mu max(0, N(t)) at the middle of the steps, and the force acts on the structure."""
    model = chain_of(1)
    laws = ContactLaws(normal="prescribed", friction=0.5, normal_force={0: 1.0, 2: 2.0j})
    result = integrate(pose(model, laws), "rest", steps=400, periods=100, tolerance=1e-8)
    tau = 2 * np.pi * np.arange(400) / 400
    given = 1 - 2 * np.sin(2 * tau)
    assert result.history("normal_force")[:, 0] == pytest.approx(given, abs=1e-3)
    limit = 0.5 * np.maximum(0, 0.5 * (given + np.roll(given, -1)))
    friction = result.last.impulses[:, 0] / result.scheme.dt
    assert np.all(np.abs(friction) <= limit * (1 + 1e-12))
    assert np.any(np.abs(friction) == pytest.approx(limit, rel=1e-12))
    ours, theirs = result.output("body"), solve(ContactProblem(model, laws, 0.5, 21)).output("body")
    assert np.abs(ours - theirs[:4]).max() < 2e-3 * abs(ours[1])


def test_groups_of_laws_each_govern_their_own_pairs():
    model = chain_of(4, press=20.0)
    groups = [
        ([2], ContactLaws(friction=0.2, initial_gap=0.05)),
        ([0], ContactLaws(tangential="frictionless")),
        ([3], ContactLaws(normal="bonded", tangential="bonded")),
        ([1], ContactLaws(normal="prescribed", normal_force=2.0, tangential="bonded")),
    ]
    result = integrate(pose(model, groups), "rest", steps=400, periods=300, tolerance=1e-7)
    assert result.converged, result.reason
    histories = {name: result.history(name) for name in ("gap", "slip", "normal_force", "friction_force")}
    assert np.abs(histories["gap"][:, 3]).max() < 1e-12 and np.abs(histories["slip"][:, [1, 3]]).max() < 1e-12
    assert np.abs(histories["friction_force"][:, 0]).max() == 0 and np.ptp(histories["slip"][:, 0]) > 1e-3
    assert histories["normal_force"][:, 1] == pytest.approx(2.0, rel=1e-12)
    harmonic = solve(pose(model, groups, harmonics=15))
    for name, ours in histories.items():
        theirs = harmonic.history(name, 400)
        assert np.sqrt(np.mean((ours - theirs) ** 2)) < 0.012 * np.abs(theirs).max(), name


def test_floating_block_needs_nothing_special():
    """A free body between two springs-to-ground walls of the model: only contact holds it."""
    stiffness = np.diag([40.0, 0.0])
    model = ReducedModel(
        mass=np.diag([1.0, 1.0]), damping=np.diag([0.5, 0.0]), stiffness=stiffness, normal=[[-1.0, 1.0]],
        load={0: [0.0, -3.0], 1: [1.0, 0.0]}, outputs={"block": [0.0, 1.0]},
    )  # fmt: skip
    problem = pose(model, ContactLaws(tangential="frictionless"), frequency=0.3)
    result = integrate(problem, steps=400, periods=300, tolerance=1e-8)
    assert result.converged
    assert np.abs(result.history("gap")).max() < 1e-9  # never leaves: one mass of 2 on the spring
    w = 2 * np.pi * 0.3
    assert result.output("block")[0] == pytest.approx(-3 / 40, rel=1e-6)
    assert abs(result.output("block")[1]) == pytest.approx(abs(1 / (40 - 2 * w**2 + 0.5j * w)), rel=1e-4)


def test_starts():
    problem = pose(chain_of(2, press=60.0), ContactLaws(friction=5.0))  # sticks
    stuck = integrate(problem, None, steps=800, periods=1, tolerance=0)
    harmonic = solve(problem)
    from_harmonic = integrate(problem, harmonic, steps=800, periods=1, tolerance=0)
    position = harmonic.coordinates.sum(axis=0).real
    first = from_harmonic.scheme.expansion @ from_harmonic.last.positions[0]
    assert first == pytest.approx(position, rel=1e-9, abs=1e-12)
    rest = integrate(problem, "rest", steps=800, periods=1, tolerance=0)
    assert np.abs(rest.last.velocities[0]).max() == 0
    assert np.abs(stuck.last.velocities[0]).max() > 1e-3
    again = integrate(problem, rest.end, steps=800, periods=1, tolerance=0)
    both = integrate(problem, "rest", steps=800, periods=2, tolerance=0)
    assert again.transient("body") == pytest.approx(both.transient("body")[800:], rel=1e-5, abs=1e-8)


def test_acceleration_finds_the_same_steady_state_in_fewer_periods():
    model = chain_of(2)
    problem = pose(ReducedModel(**{**model.__dict__, "damping": 0.1 * model.damping}))
    plain = integrate(problem, steps=200, periods=3000, tolerance=1e-8)
    fast = integrate(problem, steps=200, periods=300, tolerance=1e-8, acceleration=True)
    assert plain.converged and fast.converged
    assert fast.periods < plain.periods / 3
    assert np.abs(fast.output("body") - plain.output("body")).max() < 1e-5 * np.abs(plain.output("body")).max()
    with pytest.raises(ModelError, match="accelerated"):
        fast.transient("body")


def test_distance_says_how_far_a_slow_motion_still_has_to_go():
    model = chain_of(2)
    problem = pose(ReducedModel(**{**model.__dict__, "damping": 0.1 * model.damping}))
    steady = integrate(problem, steps=200, periods=3000, tolerance=1e-11)
    early = integrate(problem, steps=200, periods=3000, tolerance=1e-4)
    true = np.abs(early.output("body")[1] - steady.output("body")[1]) / np.abs(steady.output("body")[1])
    assert early.changes[-1] <= 1e-4
    assert true / 5 < early.distance < 50 * true


def test_contact_solve_that_runs_out_of_sweeps_is_reported():
    result = integrate(pose(chain_of(3)), "rest", steps=50, periods=5, tolerance=1.0, sweeps=1)
    assert result.unsolved > 0 and not result.converged
    assert "missed the contact tolerance" in result.reason and "NOT steady" in result.summary()
    assert "it repeats itself" in result.reason and "every second one" not in result.reason


def test_motion_without_bound_is_reported():
    """Negative damping: it grows past all numbers, and the run ends there."""
    model = ReducedModel(
        mass=[[1.0]], damping=[[-200.0]], stiffness=[[1.0]], tangential=[[1.0]], load={1: [1.0]}, outputs={"x": [1.0]}
    )
    problem = pose(model, ContactLaws(normal="prescribed", normal_force=0.1))
    result = integrate(problem, "rest", steps=400, periods=20)
    assert not result.converged and "without bound" in result.reason and result.periods < 20
    assert "theta = 0.52" in result.reason
    assert "theta" not in integrate(problem, "rest", steps=400, periods=20, theta=0.6).reason


@pytest.mark.parametrize(("damping", "periods"), [(-200.0, 1), (-100.0, 2)])
def test_a_transient_goes_on_to_where_it_grows_past_all_numbers(damping, periods):
    """The period in which that happens was missing."""
    model = ReducedModel([[1.0]], [[damping]], [[1.0]], tangential=[[1.0]], load={1: [1.0]}, outputs={"x": [1.0]})
    problem = pose(model, ContactLaws(normal="prescribed", normal_force=0.1))
    result = integrate(problem, "rest", steps=400, periods=20)
    assert result.periods == periods and result.transient("x").shape == (400 * periods + 1,)
    assert not np.abs(result.transient("x")[-1]) < time_stepping.BOUND


def test_histories_and_outputs_are_consistent():
    result = integrate(pose(chain_of(2)), steps=256, periods=200, tolerance=1e-8)
    slip, velocity = result.history("slip"), result.history("slip_velocity")
    assert slip.shape == (256, 2) and result.history("gap", 100).shape == (100, 2)
    # x_(k+1) - x_k is dt times the mean velocity, also across the end of a steady period
    step = result.scheme.dt * 0.5 * (velocity + np.roll(velocity, -1, axis=0))
    assert np.roll(slip, -1, axis=0) - slip == pytest.approx(step, abs=1e-6 * np.ptp(slip))
    body = result.output_history("body")
    tau = 2 * np.pi * np.arange(256) / 256
    amplitudes = [np.mean(body)] + [2 * np.mean(body * np.exp(-1j * h * tau)) for h in (1, 2, 3)]
    assert result.output("body") == pytest.approx(np.array(amplitudes), rel=1e-10)
    assert result.transient("body")[-257:-1] == pytest.approx(body, rel=1e-12)


def test_contact_amplitudes_are_those_of_the_histories():
    """Impulses belong to the middle of their step: their amplitudes have the phase of the force, as motions have."""
    steady = integrate(ContactProblem(dovetail(), ContactLaws(friction=0.2), 481.0, 5), steps=400, theta=0.6)
    forces, motion = steady.contact_amplitudes
    turns = np.exp(2j * np.pi * np.outer(np.arange(400) / 400, steady.orders))
    index = steady.problem.system.index
    for direction, force, moved in (("normal", "normal_force", "gap"), ("tangential", "friction_force", "slip")):
        rows = index[direction]
        for amplitudes, history in ((forces, steady.history(force)), (motion, steady.history(moved))):
            found = (turns @ amplitudes[:, rows]).real
            size, rounding = np.abs(history - history.mean()).max(), 1e-9 * np.abs(amplitudes).max()  # no pair opens
            assert np.sqrt(np.mean((found - history) ** 2)) < 0.1 * size + rounding  # the harmonics above the fifth
            first = 2 * np.mean(history * turns[:, [1]].conj(), axis=0)
            np.testing.assert_allclose(amplitudes[1, rows], first, atol=1e-4 * np.abs(first).max() + rounding)


def test_resampling_keeps_phase_and_wraps_round():
    at = (np.arange(64) + 0.5) / 64
    values = np.cos(2 * np.pi * at)[:, None]
    assert resample(values, 0.5, None)[:, 0] == pytest.approx(np.cos(2 * np.pi * np.arange(64) / 64), abs=2e-3)
    assert resample(values, 0.5, 17)[:, 0] == pytest.approx(np.cos(2 * np.pi * np.arange(17) / 17), abs=2e-3)
    assert resample(values, 0.0, 64) == pytest.approx(values)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"start": "sleep"}, "sleep"),
        ({"start": State(np.zeros(3), np.zeros(3))}, "expected 6"),
        ({"start": State(np.full(6, np.nan), np.zeros(6))}, "finite"),
        ({"steps": 0}, "steps = 0"),
        ({"steps": 1.5}, "steps = 1.5"),
        ({"steps": "8"}, "steps = '8'"),
        ({"steps": 6}, "steps = 6 cannot resolve harmonic 3; give at least 7"),
        ({"periods": 0}, "periods = 0"),
        ({"periods": 2.5}, "periods = 2.5"),
        ({"sweeps": -4}, "sweeps = -4"),
        ({"tolerance": -1.0}, "tolerance = -1.0"),
        ({"tolerance": np.nan}, "tolerance = nan"),
        ({"contact_tolerance": 0.0}, "contact_tolerance = 0.0"),
        ({"theta": 0.4}, "theta = 0.4"),
        ({"start": np.zeros(8)}, 'start is of type ndarray; give "rest"'),
    ],
)
def test_senseless_arguments_are_refused(arguments, message):
    with pytest.raises(ModelError, match=message):
        integrate(pose(chain_of(2)), **arguments)


@pytest.mark.parametrize("theta, least, most", [(0.5, 1 / 3, 0.5), (0.6, 0.25, 0.4), (1.0, 0.0, 0.0)])
@pytest.mark.parametrize("steps", [200, 3200])
def test_a_mass_that_lands_rebounds_as_the_docstring_says(theta, least, most, steps):
    """Wherever in a step it lands, and however long that is."""
    still = ReducedModel([[1.0]], [[0.0]], [[0.0]], normal=[[1.0]])
    problem = ContactProblem(still, ContactLaws(tangential="frictionless"), 1.0, 1)
    for share in np.linspace(0, 1, 9, endpoint=False):
        start = State(np.array([0.3 + share / steps]), np.array([-1.0]))
        speed = integrate(problem, start, steps=steps, periods=1, tolerance=0, theta=theta).end.velocity
        assert least - 1e-9 <= speed <= most + 1e-9


def test_bonds_without_outputs_are_steady_when_the_motion_is():
    """There is no row and no output to watch, but the forces of the bonds to read."""
    bonded = replace(chain_of(2), outputs={})
    problem = pose(bonded, ContactLaws("bonded", "bonded"))
    result, expected = integrate(problem, "rest", steps=800, periods=400), solve(problem)
    assert result.converged and result.periods > 5
    force = expected.history("normal_force", 64)
    assert result.history("normal_force", 64) == pytest.approx(force, abs=1e-3 * np.abs(force).max())


def test_a_given_force_that_the_steps_do_not_resolve_is_refused():
    sled = ReducedModel([[1.0]], [[0.1]], [[1.0]], tangential=[[1.0]], load={1: [1.0]})
    laws = ContactLaws("prescribed", normal_force={0: 1.0, 12: 0.5})
    problem = ContactProblem(sled, laws, 0.1, 1)
    with pytest.raises(ModelError, match="steps = 24 cannot resolve harmonic 12"):
        integrate(problem, steps=24)
    assert integrate(problem, steps=25, periods=1).periods == 1


def test_a_model_is_no_problem_to_step():
    with pytest.raises(ModelError, match="ContactProblem"):
        integrate(chain_of(2))


def test_names_and_frequencies_that_do_not_exist_are_refused():
    result = integrate(pose(chain_of(1)), steps=20, periods=1, tolerance=0)
    with pytest.raises(ModelError, match='did you mean "slip"'):
        result.history("slips")
    with pytest.raises(ModelError, match='did you mean "body"'):
        result.output("bodi")
    for samples in (0, -3, 2.5, "8"):
        for ask in (lambda n: result.history("slip", n), lambda n: result.output_history("body", n)):
            with pytest.raises(ModelError, match=f"samples = {samples!r}; give a whole number"):
                ask(samples)
        with pytest.raises(ModelError, match="give a whole number"):
            result.sliding_speed(samples)
    still = ReducedModel(mass=[[1.0]], damping=[[0.0]], stiffness=[[1.0]], normal=[[1.0]])
    with pytest.raises(ModelError, match="needs a period"):
        TimeScheme(ContactProblem(still, ContactLaws(tangential="frictionless"), 0.0, (0,)), 10)


def test_a_period_so_long_that_inertia_is_lost_is_refused():
    """Beside stiffness times a step squared: what is left of floating bodies was no mass, and numpy said so."""
    bar = bar_against_wall(elements=4, mean=1.0, amplitude=0.5)
    told = r"frequency = 1e-12 Hz: with 800 steps a period, inertia is lost .* more steps"
    with pytest.raises(ModelError, match=told):
        TimeScheme(ContactProblem(bar, ContactLaws(tangential="frictionless"), 1e-12, 3), 800)


def test_whole_numbers_are_told_without_a_point():
    """As they come from an array of floats."""
    problem = ContactProblem(dovetail(), ContactLaws(friction=0.3), 0.1, 3)
    steady = integrate(problem, steps=64.0, periods=2.0, tolerance=1e-15, contact_tolerance=1e-16, sweeps=1.0)
    assert steady.reason.startswith("not steady after 2 periods") and "of the last 64 steps" in steady.reason
    assert steady.reason.endswith("in 1 sweeps")


def test_importing_the_module_does_not_load_numba():
    """It takes a third of a second, which nobody who only solves in frequency should wait for."""
    import subprocess
    import sys

    code = "import sys, ewr_fenicsx.solver.time_integration; sys.exit('numba' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0


def test_wear_opens_the_joint_as_an_initial_gap_does():
    model, depth = lift_off_oscillator(preload=1.0), 0.05
    worn = TimeScheme(ContactProblem(model, ContactLaws(), 0.1, 3, wear=np.array([depth])), 50)
    apart = TimeScheme(ContactProblem(model, ContactLaws(initial_gap=depth), 0.1, 3), 50)
    np.testing.assert_array_equal(worn.initial_gap, apart.initial_gap)
    np.testing.assert_array_equal(worn.problem.clearance, [depth])
