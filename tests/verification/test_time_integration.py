"""Time stepping against closed forms, and against the harmonic solver: two formulations that share no law."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from small_models import friction_oscillator, stop_oscillator

from ewr_fenicsx import ContactLaws, ContactProblem, ReducedModel, solve
from ewr_fenicsx.in_time.time_stepping import State
from ewr_fenicsx.solver.time_integration import integrate


def den_hartog_amplitude(beta: float, share: float) -> float:
    """Amplitude over a = P/k under dry friction of x_f = share a.

    Source: Den Hartog (1931), Trans. ASME 53, 107-115.
    """
    V, U = 1 / (1 - beta**2), np.tan(np.pi / (2 * beta)) / beta
    return float(np.sqrt(V**2 - share**2 * U**2))


def integrate_den_hartog(beta: float, share: float, steps: int, periods: int):
    model = ReducedModel(
        mass=[[1.0]], damping=[[0.0]], stiffness=[[1.0]], tangential=[[1.0]], load={1: [1.0]}, outputs={"x": [1.0]}
    )
    laws = ContactLaws(normal="prescribed", normal_force=share / 0.5, friction=0.5)
    problem = ContactProblem(model, laws, frequency=beta / (2 * np.pi), harmonics=3)
    return integrate(problem, start="rest", steps=steps, periods=periods, tolerance=1e-11)


@pytest.mark.parametrize(
    ("beta", "share", "table"), [(0.8, 0.4, 2.50179), (0.8, 0.7, 1.80379), (1.25, 0.3, 1.61706), (0.6, 0.2, 1.55060)]
)
def test_dry_friction_oscillator_reaches_den_hartogs_amplitude_at_first_order(beta, share, table):
    """Undamped, friction alone makes it steady. Reversals are resolved to one step: amplitudes jitter or lock at O(dt).

    The amplitude is the mean over the second half of the run. Without friction's sign right there is no steady motion.
    """
    exact = den_hartog_amplitude(beta, share)
    assert exact == pytest.approx(table, abs=6e-6)
    for steps, periods in ((200, 1000), (800, 600), (3200, 200)):
        result = integrate_den_hartog(beta, share, steps, periods)
        assert result.unsolved == 0
        x = result.transient("x")[1:].reshape(-1, steps)[result.periods // 2 :]
        amplitude = np.mean(np.ptp(x, axis=1)) / 2
        assert amplitude == pytest.approx(exact, rel=3 / steps), steps


def test_friction_force_of_the_dry_oscillator_is_a_square_wave():
    """Without stops |lam_m| = 4 F / (m pi) for odd m, none for even, and the friction work a cycle is 4 F x0."""
    result = integrate_den_hartog(0.6, 0.2, 1600, 400)
    force = result.history("friction_force")[:, 0]
    spectrum = 2 * np.abs(np.fft.rfft(force)) / force.size
    for m in (1, 3, 5):
        assert spectrum[m] == pytest.approx(4 * 0.2 / (m * np.pi), rel=2e-3 * m)
        assert spectrum[m + 1] < 2e-3
    work = result.measure_energy()
    assert work["friction"] == pytest.approx(4 * 0.2 * den_hartog_amplitude(0.6, 0.2), rel=2e-3)


BLOCK = {"mass": 2.5, "gravity": 9.81, "friction": 0.3, "speed": 4.0}


def slide_block(steps: int):
    """A block thrown along the ground, over 1.6 times the time v0 / (mu g) that it slides."""
    mass, gravity, friction, speed = BLOCK.values()
    model = ReducedModel(
        mass=np.diag([mass, mass]), damping=np.zeros((2, 2)), stiffness=np.zeros((2, 2)), normal=[[0.0, 1.0]],
        tangential=[[1.0, 0.0]], load={0: [0.0, -mass * gravity]}, outputs={"x": [1.0, 0.0]},
    )  # fmt: skip
    stop = speed / (friction * gravity)
    problem = ContactProblem(model, ContactLaws(friction=friction), frequency=1 / (1.6 * stop), harmonics=1)
    return integrate(problem, State(np.zeros(2), np.array([speed, 0.0])), steps=steps, periods=1, tolerance=0)


def test_block_slides_to_rest_where_coulomb_says():
    """Distance v0^2 / (2 mu g), time v0 / (mu g); friction is -mu m g until then and nothing afterwards."""
    mass, gravity, friction, speed = BLOCK.values()
    stop = speed / (friction * gravity)
    for steps in (97, 970):
        result = slide_block(steps)
        dt = 1.6 * stop / steps
        assert result.transient("x")[-1] == pytest.approx(speed * stop / 2, abs=friction * gravity * dt**2)
        velocity, force = result.history("slip_velocity")[:, 0], result.last.impulses[:, 1] / dt
        assert np.flatnonzero(velocity > 1e-9)[-1] * dt == pytest.approx(stop, abs=dt)
        assert force[: int(stop / dt)] == pytest.approx(-friction * mass * gravity, rel=1e-12)
        assert np.abs(force[int(stop / dt) + 1 :]).max() < 1e-12 * mass * gravity
        assert np.abs(velocity[int(stop / dt) + 2 :]).max() < 1e-12 * speed
        assert result.last.impulses[:, 0] / dt == pytest.approx(mass * gravity, rel=1e-12)
        assert np.abs(result.history("gap")).max() < 1e-14


def throw_bar(elements: int):
    """A bar (c = E = L = A = 1) that meets a wall at speed 1, for a time 4; lumped masses."""
    h = 1 / elements
    mass = h * np.diag(np.r_[0.5, np.ones(elements - 1), 0.5])
    stretch = np.diff(np.eye(elements + 1), axis=0)
    model = ReducedModel(
        mass=mass, damping=np.zeros_like(mass), stiffness=stretch.T @ stretch / h, normal=np.eye(1, elements + 1)
    )
    problem = ContactProblem(model, ContactLaws(tangential="frictionless"), frequency=1 / 4, harmonics=1)
    start = State(np.zeros(elements + 1), -np.ones(elements + 1))
    return integrate(problem, start, steps=16 * elements, periods=1, tolerance=0)


def test_bar_against_a_wall_obeys_the_wave_solution():
    """A bar (c = E = L = A = 1) hits a wall at speed 1: constant force 1 for a time 2, then it leaves as it came.

    The node at the wall carries half an element's mass and loses its kinetic energy at impact: first order in the mesh.
    Source: d'Alembert's solution; e.g. Doyen, Ern & Piperno (2011), doi:10.1137/100791440, section 2.
    """
    errors = []
    for elements in (25, 100):
        h, result = 1 / elements, throw_bar(elements)
        dt, impulse = result.scheme.dt, result.last.impulses[:, 0]
        instant = dt * (np.arange(impulse.size) + 0.5)
        steady = impulse[(instant > 0.2) & (instant < 1.8)] / dt
        assert np.mean(steady) == pytest.approx(1, abs=3e-3 * (25 * h))
        assert np.abs(steady - 1).max() < 0.8 * h
        assert dt * np.sum(impulse > 0.5 * dt) == pytest.approx(2, abs=1.5 * h)
        assert np.all(impulse >= 0) and impulse[instant > 2.1].max() == 0
        assert result.history("gap").min() >= -dt / 2 * (1 + 1e-12)  # the impact sinks in by half a step of travel
        loss = result.measure_energy()["impact"] / 0.5
        assert 0 < loss < h / 2
        errors.append(2 - impulse.sum())
    assert 0 < errors[1] < errors[0] / 2.5


def preloaded_block(pull: float, spring: float = 50.0) -> ReducedModel:
    return ReducedModel(
        mass=np.diag([1.0, 1.0]), damping=np.diag([3.0, 0.0]), stiffness=np.diag([spring, 0.0]), normal=[[0.0, 1.0]],
        tangential=[[1.0, 0.0]], load={0: [pull, -10.0]}, outputs={"x": [1.0, 0.0]},
    )  # fmt: skip


def test_pair_pressed_together_holds_for_ever():
    """Below the friction limit (0.3 x 10 N) nothing drifts or sinks in, and friction alone carries the load."""
    problem = ContactProblem(preloaded_block(2.9), ContactLaws(friction=0.3), frequency=1.0, harmonics=1)
    result = integrate(problem, State(np.zeros(2), np.zeros(2)), steps=200, periods=100, tolerance=0)
    assert np.abs(result.transient("x")).max() < 1e-14
    assert np.abs(result.history("gap")).max() < 1e-14
    assert result.history("friction_force") == pytest.approx(-2.9, rel=1e-7)
    assert result.history("normal_force") == pytest.approx(10.0, rel=1e-7)


def test_pair_pulled_beyond_the_limit_slides_until_the_spring_carries_the_rest():
    """It stops, overdamped or not, with a spring force within one friction limit of the pull; then holds."""
    problem = ContactProblem(preloaded_block(5.0), ContactLaws(friction=0.3), frequency=1.0, harmonics=1)
    result = integrate(problem, State(np.zeros(2), np.zeros(2)), steps=500, periods=20, tolerance=1e-12)
    assert result.converged
    x = result.transient("x")[-1]
    # it starts with 5 - 3 N to spare and swings about (5 - 3) / 50 m with a damping ratio of 3 / (2 sqrt(50))
    ratio = 3 / (2 * np.sqrt(50))
    first_turn = (5 - 3) / 50 * (1 + np.exp(-np.pi * ratio / np.sqrt(1 - ratio**2)))
    assert abs(50 * first_turn - 5) < 3  # there friction holds it
    assert x == pytest.approx(first_turn, rel=2e-5)
    assert result.history("friction_force") == pytest.approx(50 * x - 5, rel=1e-6)


def two_masses(preload: float, shake: tuple[float, float]) -> ReducedModel:
    """A light contact node on springs to a body on springs, shaken along and, a quarter later, across the contact."""
    mass = np.diag([0.02, 0.02, 1.0, 1.0])
    stiffness = np.array([[4, 0, -4, 0], [0, 6, 0, -6], [-4, 0, 5, 0.3], [0, -6, 0.3, 7.5]])
    return ReducedModel(
        mass=mass, damping=0.02 * (mass + stiffness), stiffness=stiffness,
        normal=[[0, 1, 0, 0]], tangential=[[1, 0, 0, 0]], outputs={"x": [0, 0, 1, 0], "y": [0, 0, 0, 1]},
        load={0: [0, 0, 0, -preload], 1: [0, 0, shake[0], 1j * shake[1]]},
    )  # fmt: skip


@pytest.mark.parametrize(
    ("preload", "shake", "beta", "opens"),
    [(2.0, (1.5, 0.5), 1.6, False), (1.0, (0.5, 0.8), 1.6, True)],
    ids=["slip under a varying normal load", "slip and lift-off"],
)
def test_two_mass_oscillator_agrees_with_the_harmonic_solver(preload, shake, beta, opens):
    model = two_masses(preload, shake)
    # the weight of one static stiffness: with the default, ten of them, velocities ring longer after the impact (0.06)
    laws, frequency = ContactLaws(friction=0.4), beta / (2 * np.pi)
    weight = 1 / ContactProblem(model, laws, frequency).system.flexibility[0]
    problem = lambda N: ContactProblem(model, laws, frequency, harmonics=N, rho_normal=weight)  # noqa: E731
    stepped = integrate(problem(5), steps=1600, periods=400, tolerance=1e-7)
    assert stepped.converged, stepped.reason
    assert (stepped.history("gap").max() > 0.01) == opens
    assert np.ptp(stepped.history("slip")) > 0.1
    errors = {}
    for N in (3, 15):
        harmonic = solve(problem(N))
        first = lambda result: np.array([result.output(name)[1] for name in ("x", "y")])  # noqa: E731
        errors[N] = np.linalg.norm(first(harmonic) - first(stepped)) / np.linalg.norm(first(stepped))
    assert errors[15] < 2.5e-3
    assert errors[15] < errors[3] / 20
    for name, limit in (("normal_force", 0.02), ("friction_force", 0.025), ("slip", 0.005), ("slip_velocity", 0.04)):
        ours, theirs = stepped.history(name, 256), harmonic.history(name, 256)
        assert np.sqrt(np.mean((ours - theirs) ** 2) / np.mean(ours**2)) < limit, name


def test_works_balance_over_every_period_and_steady_friction_takes_what_is_put_in():
    """With theta = 1/2 the balance holds to rounding in every period, steady or not."""
    problem = ContactProblem(two_masses(1.0, (0.5, 0.8)), ContactLaws(friction=0.4), 1.6 / (2 * np.pi))
    for periods in (1, 150):
        work = integrate(problem, "rest", steps=400, periods=periods, tolerance=1e-9).measure_energy()
        spent = work["stored"] + work["viscous"] + work["friction"] + work["impact"]
        assert work["excitation"] == pytest.approx(spent, rel=1e-10)
        assert work["friction"] > 0 and work["viscous"] > 0
    assert abs(work["stored"]) < 1e-7 * work["excitation"]
    assert abs(work["impact"]) < 5e-3 * work["excitation"]


def test_motion_of_twice_the_period_is_not_called_steady():
    """This one repeats every second period only: a harmonic balance on the excitation's period cannot find it."""
    problem = ContactProblem(two_masses(1.0, (0.5, 0.8)), ContactLaws(friction=0.4), 1.2 / (2 * np.pi))
    result = integrate(problem, steps=400, periods=600)
    assert not result.converged
    assert "not steady" in result.reason
    x = result.transient("x")[1:].reshape(-1, 400)[-4:]
    assert np.abs(x[-1] - x[-3]).max() < 1e-2 * np.abs(x[-1] - x[-2]).max()


def test_motions_of_a_transient_go_on_to_the_end_of_its_last_step():
    """Not back to where the period began: a body in flight, sampled between the ends of the last step."""
    model = ReducedModel([[1.0]], [[0.0]], [[0.0]], normal=[[1.0]], load={1: [0.0]}, outputs={"x": [1.0]})
    problem = ContactProblem(model, ContactLaws(tangential="frictionless", initial_gap=1.0), 1.0, 3)
    flown = integrate(problem, State(np.zeros(1), np.ones(1)), steps=100, periods=1, tolerance=0)
    assert flown.output_history("x", 128) == pytest.approx(np.arange(128) / 128)
    assert flown.history("gap", 128)[:, 0] == pytest.approx(1.0 + np.arange(128) / 128)


def test_without_a_tolerance_all_periods_are_stepped():
    """Also where nothing moves, and nothing changes at all: that is not called unsteady where nobody asked."""
    at_rest = ContactProblem(replace(stop_oscillator(), load={}), ContactLaws(tangential="frictionless"), 0.16)
    result = integrate(at_rest, steps=64, periods=7, tolerance=0)
    assert result.periods == 7 and result.reason == "not asked whether steady (tolerance = 0)"
    assert "not asked whether steady (tolerance = 0) after 7 periods" in result.summary()
    assert "NOT steady" not in result.summary()
    assert integrate(at_rest, steps=64, periods=7).periods < 7


def test_a_motion_that_decays_says_how_many_more_periods_it_takes():
    """A transient of 2 % a period beside little sliding; a few periods tell nothing yet."""
    problem = ContactProblem(friction_oscillator(damping=0.03), ContactLaws("prescribed", normal_force=1e-3), 0.11)
    asked = {"tolerance": 1e-4, "steps": 200}
    assert "more may do" not in integrate(problem, periods=8, **asked).reason
    begun = integrate(problem, periods=60, **asked)
    missing = int(re.search(r"falls steadily: some (\d+) more may do$", begun.reason)[1])
    whole = integrate(problem, periods=60 + 2 * missing, **asked)
    assert whole.converged and whole.periods - 60 == pytest.approx(missing, rel=0.2)


def step_with_siconos(problem: ContactProblem, start: State, steps: int) -> tuple[np.ndarray, np.ndarray]:
    """Coordinates at the steps' ends and impulses of one pair: Siconos' Moreau-Jean scheme with position projection."""
    kernel = pytest.importorskip("siconos.kernel", reason="Siconos is not installed (Debian 12: python3-siconos)")
    model, dt = problem.model, 1 / (problem.frequency * steps)
    instants = 2j * np.pi * np.arange(10 * steps + 1)[:, None] / steps
    load = sum((np.exp(h * instants) * f).real for h, f in model.load.items())
    matrices = [np.array(matrix) for matrix in (model.mass, model.stiffness, model.damping)]
    body = kernel.LagrangianLinearTIDS(list(start.position), list(start.velocity), *matrices)
    rows = np.vstack([model.normal[0], model.tangential[0]])
    law = kernel.NewtonImpactFrictionNSL(0.0, 0.0, problem.laws.friction, 2)
    contact = kernel.Interaction(law, kernel.LagrangianLinearTIR(rows))
    system = kernel.NonSmoothDynamicalSystem(0.0, dt * (10 * steps + 1))
    system.insertDynamicalSystem(body)
    system.link(contact, body)
    impulse_solver, projection = kernel.FrictionContact(2), kernel.MLCPProjectOnConstraints()
    impulse_solver.numericsSolverOptions().dparam[0] = 1e-12
    impulse_solver.numericsSolverOptions().iparam[0] = 10000
    clock, integrator = kernel.TimeDiscretisation(0.0, dt), kernel.MoreauJeanDirectProjectionOSI(0.5)
    simulation = kernel.TimeSteppingDirectProjection(system, clock, integrator, impulse_solver, projection)
    simulation.setProjectionMaxIteration(20)
    simulation.setConstraintTolUnilateral(1e-10)
    simulation.setConstraintTol(1e-10)
    positions, impulses = [np.array(start.position)], []
    for k in range(10 * steps):
        body.setFExtPtr(0.5 * (load[k] + load[k + 1]))
        simulation.computeOneStep()
        positions.append(np.array(body.q()))
        impulses.append(np.array(contact.lambda_(1)))
        simulation.nextStep()
    return np.array(positions), np.array(impulses)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("preload", "shake", "limit"),
    [(2.0, (1.5, 0.5), 1e-10), (1.0, (0.5, 0.8), 5e-3)],
    ids=["slip under a varying normal load", "slip and lift-off"],
)
@pytest.mark.parametrize("steps", [200, 800])
def test_ten_periods_from_rest_agree_with_siconos(preload, shake, limit, steps):
    """While contact stays closed both are one scheme: equal to rounding. Lift-off is treated otherwise: O(dt) apart.

    Source: Acary (2013), doi:10.1016/j.cma.2012.12.012, the projected scheme of Siconos 4.4.
    """
    problem = ContactProblem(two_masses(preload, shake), ContactLaws(friction=0.4), 1.6 / (2 * np.pi))
    first = integrate(problem, "rest", steps=steps, periods=1, tolerance=0)
    start = State(first.scheme.expansion @ first.last.positions[0], np.zeros(4))
    ours = integrate(problem, "rest", steps=steps, periods=10, tolerance=0, contact_tolerance=1e-12)
    positions, impulses = step_with_siconos(problem, start, steps)
    for name, column in (("x", 2), ("y", 3)):
        history = ours.transient(name)
        assert np.abs(history - positions[:, column]).max() < limit * np.ptp(history), name
    last = ours.last.impulses
    assert last.sum(axis=0) == pytest.approx(impulses[-steps:].sum(axis=0), rel=2 * limit)


@pytest.fixture(scope="module")
def blade() -> ReducedModel:
    from ewr_fenicsx import build_reduced_model, load_scene  # loads dolfinx

    return build_reduced_model(load_scene(Path(__file__).parents[2] / "demos" / "blade_root.toml"))


def shaken(blade: ReducedModel, factor: float, harmonics: int = 5) -> ContactProblem:
    """The demo's blade root at 1000 Hz, near its resonance, under the demo's pull and a multiple of its shake."""
    model = replace(blade, load={0: blade.load[0], 1: factor * blade.load[1]})
    return ContactProblem(model, ContactLaws(friction=0.2), frequency=1000.0, harmonics=harmonics)


@pytest.mark.slow
@pytest.mark.parametrize(("factor", "opens"), [(1.0, 1), (2.0, 40)], ids=["slip", "slip and lift-off"])
def test_blade_root_is_second_order_in_the_step_and_within_the_time_budget(blade, factor, opens):
    """Errors fall about fourfold a halving; laws and energy hold at every step; at most 0.3 ms a step."""
    tip, start = {}, None
    for steps in (800, 1600, 3200):
        result = integrate(shaken(blade, factor), start, steps=steps, tolerance=1e-5, acceleration=True)
        assert result.converged, result.reason
        tip[steps], start = result.output("tip")[1], result.end
        gap, last = result.history("gap"), result.last.impulses
        assert (gap.max(axis=0) > 1e-7).sum() >= opens
        assert gap.min() > -0.02 * gap.max() * 800 / steps
        assert last[:, :40].min() >= 0
        assert (np.abs(last[:, 40:]) - 0.2 * last[:, :40]).max() <= 1e-7 * last.max()
        work = result.measure_energy()
        spent = work["stored"] + work["viscous"] + work["friction"] + work["impact"]
        assert work["excitation"] == pytest.approx(spent, rel=1e-9)
        assert abs(work["impact"]) < 2e-4 * work["excitation"]
    assert 1e3 * result.seconds / (result.periods * steps) < 0.3
    assert abs(tip[1600] - tip[800]) > 2.5 * abs(tip[3200] - tip[1600])
    assert abs(tip[3200] - tip[1600]) < 6e-4 * abs(tip[3200])  # second order: so the last is within 2e-4


@pytest.mark.slow
@pytest.mark.parametrize(("factor", "slipping"), [(0.1, 0), (0.5, 8)], ids=["full stick", "slip at the edges"])
def test_blade_root_below_gross_slip_agrees_with_the_harmonic_solver(blade, factor, slipping):
    """Tip and forces. What mean friction a pair keeps that always sticks depends on its past: compared without means.

    Gross slip and lift-off need many harmonics: `benchmarks/` has the table.
    """
    stepped = integrate(shaken(blade, factor), steps=1600, tolerance=1e-5, acceleration=True)
    assert stepped.converged, stepped.reason
    slip = np.ptp(stepped.history("slip"), axis=0)
    assert (slip > 0.05 * slip.max()).sum() == slipping or slip.max() < 1e-9
    errors = {}
    for N in (5, 15):
        harmonic = solve(shaken(blade, factor, N))
        tip = harmonic.output("tip")[1]
        errors["tip", N] = abs(stepped.output("tip")[1] - tip) / abs(tip)
        for name in ("normal_force", "friction_force"):
            ours, theirs = (h - h.mean(axis=0) for h in (stepped.history(name, 256), harmonic.history(name, 256)))
            errors[name, N] = np.sqrt(np.mean((ours - theirs) ** 2) / np.mean(theirs**2))
    assert errors["tip", 5] < 1e-3 and errors["tip", 15] < 3e-4
    for name in ("normal_force", "friction_force"):
        assert errors[name, 15] < 0.02, name
        assert errors[name, 15] < max(errors[name, 5] / 2, 1e-3), name


@pytest.mark.slow
def test_blade_root_forgets_where_it_started(blade):
    """Plain from rest and accelerated: one steady state, within the distance that each reports, in fewer periods."""
    problem = shaken(blade, 1.0)
    plain = integrate(problem, "rest", steps=800, periods=300)
    fast = integrate(problem, "rest", steps=800, acceleration=True)
    assert plain.converged and fast.converged
    assert fast.periods < plain.periods
    apart = abs(plain.output("tip")[1] - fast.output("tip")[1]) / abs(fast.output("tip")[1])
    assert apart < 2 * (plain.distance + fast.distance) < 2e-3
