"""A body that hangs on friction alone: it rests, slides to and fro, or walks, and then no motion is periodic."""

from __future__ import annotations

import re
from dataclasses import replace
from itertools import combinations

import numpy as np
import pytest

from ewr_fenicsx import (
    ContactLaws,
    ContactProblem,
    PeriodicSolution,
    ReducedModel,
    frequency_response,
    integrate,
    solve,
)
from ewr_fenicsx.balance.balance import HarmonicBalance
from ewr_fenicsx.errors import NotConverged, UnheldBody
from ewr_fenicsx.in_time import walking
from ewr_fenicsx.in_time.time_stepping import State
from ewr_fenicsx.in_time.walking import NOTICED, Walk, measure_walk, walks
from ewr_fenicsx.runs import findings

LIMIT = 0.3


def sled(loads: dict[int, complex], pressed: dict[int, complex] | float = 1.0) -> ContactProblem:
    """A mass of one that lies on the ground, with nothing but friction to hold it."""
    model = ReducedModel(
        mass=[[1.0]],
        damping=[[0.0]],
        stiffness=[[0.0]],
        tangential=[[1.0]],
        load={h: [f] for h, f in loads.items()},
        outputs={"sled": [1.0]},
    )
    return ContactProblem(model, ContactLaws("prescribed", normal_force=pressed, friction=LIMIT), 0.3, 15)


def drift(problem: ContactProblem) -> float:
    """Way of the sled in a period after many, by time steps of ``x'' = f - clip`` of their own [m]."""
    steps, period = 4000, 1 / problem.frequency
    dt, v, ways = period / steps, 0.0, []
    tau = 2 * np.pi * (np.arange(steps) + 0.5) / steps
    signal = lambda given: sum((np.exp(1j * h * tau) * np.ravel(a)[0]).real for h, a in given.items())  # noqa: E731
    pressed = problem.laws.normal_force
    limit = LIMIT * (signal(pressed) if isinstance(pressed, dict) else np.full(steps, pressed))
    for _ in range(100):
        way = 0.0
        for push, most in zip(dt * signal(problem.loads), dt * limit, strict=True):
            free = v + push
            v = free - min(max(free, -most), most)
            way += v * dt
        ways.append(way)
    return ways[-1]


def measure(solution: PeriodicSolution) -> Walk:
    balance = HarmonicBalance(solution.problem.system)
    return measure_walk(balance, balance.pack(solution.forces, solution.rigid))


WALKERS = {
    "a mean load": ({0: 0.1, 1: 1.0}, 1.0),
    "a little too much": ({0: 0.1, 1: 0.25}, 1.0),
    "two harmonics": ({1: 1.0, 2: 0.7}, 1.0),
    "pressed in time": ({1: 1.0}, {0: 1.0, 1: 0.8}),
}
HELD = {
    "at rest": ({0: 0.1, 1: 0.19}, 1.0),
    "to and fro": ({1: 1.0}, 1.0),
    "to and fro by odd harmonics": ({1: 1.0, 3: 0.7}, 1.0),
}


@pytest.mark.parametrize("name", WALKERS)
def test_a_body_that_walks_has_no_periodic_solution(name):
    problem = sled(*WALKERS[name])
    assert abs(drift(problem)) > 1e-3
    with pytest.raises(NotConverged, match=r"hangs on friction walks.*add a support or friction") as caught:
        solve(problem)
    assert not caught.value.best.converged and len(caught.value.best.fallbacks) == 0, "no other way is tried"
    assert "Try fewer harmonics" not in str(caught.value)
    assert str(caught.value).count("hangs on friction walks") == 1, "what went wrong is said once"
    steady = integrate(problem, steps=400, periods=30)
    assert not steady.converged and "a body walks" in steady.reason


def test_a_body_on_springs_that_creeps_to_where_they_hold_it_does_not_walk():
    """Shaken loose, it was called a walking one on its way, of which no motion is periodic."""
    shaken = replace(sled({0: 2.0, 1: 60.0}, 100.0).model, stiffness=[[100.0]], rigid_modes=None)
    problem = ContactProblem(shaken, ContactLaws("prescribed", normal_force=100.0, friction=0.3), 50.0, 5)
    begun = integrate(problem, State(np.zeros(1), np.zeros(1)), steps=400, periods=60)
    assert "walks" not in begun.reason and "falls steadily" in begun.reason
    assert solve(problem).output("sled")[0] == pytest.approx(2.0 / 100.0, rel=1e-6)


def test_a_body_that_comes_to_rest_where_it_is_pushed_to_does_not_walk():
    """It has gone some way in its first period, and begins and ends that without velocity."""
    free = ReducedModel([[1.0]], [[50.0]], [[0.0]], normal=[[-1.0]], load={0: [50.0]}, outputs={"x": [1.0]})
    problem = ContactProblem(free, ContactLaws(tangential="frictionless", initial_gap=0.5), 1.0, 3)
    moved = integrate(problem, State(np.zeros(1), np.zeros(1)), steps=400, periods=1, tolerance=0)
    assert moved.transient("x")[-1] == pytest.approx(0.5, rel=1e-6), "at its stop"
    assert "walks" not in moved.reason


@pytest.mark.parametrize(
    ("loads", "harmonics"),
    [({1: 6.432, 0: 0.00053}, 7), ({1: 5.391, 2: -0.003 - 0.021j}, 11), ({1: 9.278, 2: 0.082 + 0.036j}, 11)],
)
def test_a_walk_that_long_steps_hold_is_told(loads, harmonics):
    """By a fifth to two fifths of a per cent of what slides: of 512 steps friction turns in the same one with it."""
    problem = sled(loads)
    walk = solve(replace(problem, harmonics=harmonics)).walks_slowly
    assert walk.way == pytest.approx(abs(drift(problem)), rel=0.5)


@pytest.mark.parametrize(
    ("loads", "harmonics"),
    [
        ({1: 4.663, 3: -0.48 + 0.64j}, 7),
        ({1: -3.992 - 0.378j, 5: 0.163}, 5),
        ({1: 21.384, 3: -0.053 + 0.824j}, 5),
        ({1: 20.0, 3: 6.0}, 3),
    ],
)
def test_a_drift_that_long_steps_hold_is_no_walk(loads, harmonics):
    """By symmetry no odd loads make a body walk; few harmonics throw it off as a motion in time begins."""
    assert solve(replace(sled(loads), harmonics=harmonics)).walks_slowly is None


def test_a_body_whose_drift_fades_does_not_walk():
    """Thrown off while it is shaken, far above friction: by two per cent a period friction slows it down."""
    shaken = sled({1: 200.0}, 5.0)
    thrown = State(np.zeros(1), np.array([1.6]))
    problem = replace(shaken, laws=ContactLaws("prescribed", normal_force=5.0, friction=0.3), frequency=10.0)
    begun = integrate(problem, thrown, steps=400, periods=40)
    assert "walks" not in begun.reason and "falls steadily" in begun.reason


@pytest.mark.parametrize(("steps", "settles"), [(400, False), (1600, True)])
def test_a_drift_that_steps_do_not_tell_from_none_is_no_walk_for_certain(steps, settles):
    """Friction is none the other while the velocity turns within the same step; ringing nodes were to be the reason."""
    shaken = sled({1: 100.0}, 5.0)
    problem = replace(shaken, laws=ContactLaws("prescribed", normal_force=5.0, friction=0.3), frequency=10.0)
    moved = integrate(problem, State(np.zeros(1), np.array([0.16])), steps, periods=120)
    assert moved.converged == settles
    assert settles or ("or drifts" in moved.reason and "take more of them" in moved.reason)


@pytest.mark.parametrize("name", HELD)
def test_a_body_that_does_not_walk_is_solved(name):
    problem = sled(*HELD[name])
    solution = solve(problem)
    motion = np.ptp(solution.history("slip")[:, 0])
    assert abs(drift(problem)) < 1e-2 * max(motion, 1e-3)
    assert solution.converged and (motion < 1e-9) == (name == "at rest")


@pytest.mark.parametrize("loads", [{0: 0.002, 1: 1.0}, {1: 1.0, 2: 0.04}])
def test_a_body_that_walks_slowly_is_told(loads):
    """Its motion is nearly periodic, so that it is a solution; only where it is on average means nothing."""
    problem = sled(loads)
    assert abs(drift(problem)) > 1e-2
    solution = solve(problem)
    assert abs(solution.output("sled")[0]) > np.ptp(solution.history("slip")), "what the summary warns of"
    assert "may walk slowly" in solution.summary()
    walk = measure(solution)
    assert 0.25 * walk.way < abs(drift(problem)) < 4 * walk.way, "its order"
    assert walk.sliding == pytest.approx(solution.merit["J_T"], rel=1e-2)


def test_odd_loads_of_unlike_phases_make_no_body_walk():
    """The second half of a period goes the way of the first back; coarse steps alone drift."""
    problem = sled({1: 1.0132, 3: 0.0362 - 0.1081j})
    assert abs(drift(problem)) < 1e-5
    solution = solve(problem)
    assert solution.walks_slowly is None and "walk" not in solution.summary()


@pytest.mark.parametrize("static_friction", ["resolved", "held"])
def test_a_block_slides_down_an_incline_a_thousandth_beyond_the_friction_angle(static_friction):
    """In space: the limits of its friction are a polygon in the search for what holds it."""
    laws = ContactLaws(friction=0.3, static_friction=static_friction)
    for steeper in (0.999, 1.001):
        angle = np.arctan(0.3 * steeper)
        load = {0: 10 * np.array([0.6 * np.sin(angle), 0.8 * np.sin(angle), -np.cos(angle)])}
        rigid = {"mass": np.eye(3), "damping": np.zeros((3, 3)), "stiffness": np.zeros((3, 3))}
        block = ReducedModel(**rigid, normal=[[0.0, 0.0, 1.0]], tangential=np.eye(3)[:2], load=load)
        if steeper < 1:
            assert solve(ContactProblem(block, laws, 0.0)).converged
        else:
            with pytest.raises((UnheldBody, NotConverged), match=r"walks|held"):
                solve(ContactProblem(block, laws, 0.0))


def test_a_ladder_stands_at_rest():
    """By hand: the foot sticks and the top slides down the wall, N = (87.502, 24.996) and T = (-24.996, -12.498)."""
    angle, stiffness, foot, top = np.radians(35.0), np.zeros((7, 7)), np.zeros((2, 7)), np.zeros((2, 7))
    half = 0.5 * np.array([np.cos(angle), np.sin(angle)])
    for at, place, rows, spring in ((3, -half, foot, (0.8e5, 1e5)), (5, half, top, (1e5, 0.8e5))):
        ride = np.zeros((2, 7))
        ride[:, :2], ride[:, 2], rows[:, at : at + 2] = np.eye(2), (-place[1], place[0]), np.eye(2)
        stiffness += (ride - rows).T @ np.diag(spring) @ (ride - rows)
    mass, load = np.diag([10.0, 10.0, 1.0, 0.0, 0.0, 0.0, 0.0]), np.array([0.0, -100.0, 20 * np.cos(angle), 0, 0, 0, 0])
    ladder = ReducedModel(mass, 0.01 * mass, stiffness, [foot[1], -top[0]], [-foot[0], -top[1]], {0: load})
    for static_friction in ("held", "resolved"):
        found = solve(ContactProblem(ladder, ContactLaws(friction=0.5, static_friction=static_friction), 0.0))
        assert found.pair_forces["normal"][0].real == pytest.approx([87.502, 24.996], rel=1e-4)
        assert found.pair_forces["tangential"][0].real == pytest.approx([-24.996, -12.498], rel=1e-3)


def test_bodies_in_a_plane_come_to_rest_without_a_fallback():
    """But for one, of which a foot lifts off after a long way: the only one that was said to walk, and does not."""
    found = {}
    for seed in range(60):
        try:
            found[seed] = solve(ContactProblem(body_on_leaning_feet(seed), ContactLaws(friction=0.5), 0.0))
        except (UnheldBody, NotConverged):  # leaves its feet, or slides
            continue
    assert len(found) > 25 and [seed for seed, solution in found.items() if solution.fallbacks] == [34]
    normal, rubbing = (found[34].history(name, 1)[0] for name in ("normal_force", "friction_force"))
    assert normal[:2].min() > 0.4 and normal[2] == pytest.approx(0.0, abs=1e-9)
    assert rubbing == pytest.approx([-0.5 * normal[0], rubbing[1], 0.0], abs=2e-4) and abs(rubbing[1]) < 0.5 * normal[1]


def body_on_leaning_feet(seed: int) -> ReducedModel:
    """A rigid body in a plane (x, y, turn) on three massless feet on springs, each on ground of its own slope."""
    rng, each = np.random.default_rng(seed), np.eye(9)
    stiffness, normal, tangential = np.zeros((9, 9)), [], []
    for foot in (each[3:5], each[5:7], each[7:]):
        (x, y), lean = rng.uniform(-1.0, 1.0, 2), rng.normal(scale=0.6)
        stretch = np.array([[1.0, 0.0, -y], [0.0, 1.0, x]]) @ each[:3] - foot
        stiffness += stretch.T @ np.diag(rng.uniform(1e3, 2e3, 2)) @ stretch
        normal.append(np.array([np.sin(lean), np.cos(lean)]) @ foot)
        tangential.append(np.array([np.cos(lean), -np.sin(lean)]) @ foot)
    mass = np.diag([1.0, 1.0, 1.0, *np.zeros(6)])
    load = np.array([0.3 * rng.normal(), -1.0, 0.1 * rng.normal(), *np.zeros(6)])
    return ReducedModel(mass, 0.02 * mass, stiffness, normal, tangential, {0: load})


@pytest.mark.parametrize("angle", [0.0, 0.5, np.pi / 4])
def test_a_walk_in_a_plane_is_that_along_a_line_whichever_way_tangents_point(angle):
    """The sled with two tangents, neither of which need point along its way: what is told of it, and of its share."""
    line = replace(sled({0: 0.002, 1: 1.0}), closure="dashpot")
    cos, sin = np.cos(angle), np.sin(angle)
    model = ReducedModel(
        mass=np.eye(2), damping=np.zeros((2, 2)), stiffness=np.zeros((2, 2)),
        normal=np.zeros((1, 2)), tangential=[[cos, sin], [-sin, cos]],
        load={h: np.array([f[0], 0.0]) for h, f in line.model.load.items()},
    )  # fmt: skip
    here, there = (solve(problem, tolerance=1e-11) for problem in (line, replace(line, model=model)))
    assert here.walks_slowly.way > 1e-2
    assert tuple(there.walks_slowly) == pytest.approx(tuple(here.walks_slowly), rel=1e-6)
    assert tuple(measure(there)) == pytest.approx(tuple(measure(here)), rel=1e-3)


def test_where_a_walking_body_is_on_average_is_no_large_motion(monkeypatch):
    """Not of itself: a swing that is too large is told of a walking body as well."""
    solution = solve(sled({0: 0.002, 1: 1.0}))
    slip = solution.history("slip")
    swing, mean = np.ptp(slip) / 2, abs(slip.mean())
    assert mean > 1.5 * swing

    def doubt(limit: float) -> list[str]:
        monkeypatch.setattr(findings, "measure_spacing", lambda _: np.array([limit]))
        return findings.doubt_small_motion(solution, None, limit)

    assert doubt(1.2 * swing) == []
    slides, moves = doubt(0.5 * swing)
    assert "slide farther than their nodes are apart" in slides and moves.startswith("sled moves by up to")


def block_on_feet(seed: int, harmonics: int) -> ContactProblem:
    """A rigid block (x, y, angle) on two springy feet, shaken at two frequencies; its numbers drawn at random."""
    rng = np.random.default_rng(seed)
    height, stiff, along = 0.05 * rng.random(), 1e5, 5e4
    mass = np.diag([1, 1, 0.01] + [1e-3] * 4)
    stiffness = np.diag([0, 0, 0, along, stiff, along, stiff]).astype(float)
    damping, normal, tangential = np.diag([0, 0, 0, 3.0, 6, 3, 6]), np.zeros((2, 7)), np.zeros((2, 7))
    for foot, side in enumerate((-1, 1)):
        normal[foot, [1, 2, 4 + 2 * foot]] = 1, 0.1 * side, -1
        tangential[foot, [3 + 2 * foot, 0, 2]] = 1, -1, -height
    load = np.zeros((3, 7), dtype=complex)
    load[0, 1], load[0, 0] = -10, rng.choice([0, 0, 0.02, 0.2])
    load[1, 0], load[1, 1] = rng.uniform(0.5, 6), rng.uniform(0, 4) * np.exp(2j * np.pi * rng.random())
    load[2, 0] = rng.choice([0, rng.uniform(0, 4)]) * np.exp(2j * np.pi * rng.random())
    loads = {0: load[0].real, 1: load[1], 2: load[2]}
    model = ReducedModel(mass, damping, stiffness, normal, tangential, loads, outputs={"x": np.eye(7)[0]})
    return ContactProblem(model, ContactLaws(friction=float(rng.choice([0.2, 0.4]))), 20.0, harmonics)


@pytest.mark.parametrize("seed, harmonics", [(212, 9), (107, 15), (31, 15), (50, 3)])
def test_a_walk_is_told_as_it_is_in_time_also_where_a_truncation_happens_to_leave_next_to_nothing(seed, harmonics):
    """By up to more than its amplitude a cycle: what springs carry here is a hundredth of what that would take."""
    solution = solve(block_on_feet(seed, harmonics))
    moved = integrate(solution.problem, "rest", 1000, 60, tolerance=0).transient("x")
    walked = abs(moved[-1] - moved[-10001]) / 10
    assert walked > 0.03 * np.abs(solution.output("x")[1])
    told = [line for line in solution.cautions if "may walk slowly" in line]
    assert len(told) == 1
    assert float(re.search(r"order of (\S+) m", told[0]).group(1)) == pytest.approx(walked, rel=0.4)


@pytest.mark.parametrize("name", HELD)
def test_what_friction_leaves_over_where_it_holds_is_far_below_what_is_noticed(name, monkeypatch):
    monkeypatch.setattr("ewr_fenicsx.in_time.walking.NOTICED", 0.1 * NOTICED)
    solution = solve(replace(sled(*HELD[name]), harmonics=tuple(range(16))))  # a list: with the mean, symmetry or not
    balance = HarmonicBalance(solution.problem.system)
    assert np.any(balance.static_displacement_row > 0) and balance.basis.has_mean
    assert not walks(balance, balance.pack(solution.forces, solution.rigid))
    assert "walk" not in solution.summary() and measure(solution).share < 0.3 * walking.HELD


def test_how_much_is_too_much_is_told_however_little():
    with pytest.raises(UnheldBody, match=r"body: 0\.01% of the mean load stays unbalanced"):
        solve(sled({0: LIMIT / (1 - 1e-4)}))


def pull_bond(lift: float, friction: float, sideways: float = 0.2) -> ContactProblem:
    """A floating mass that a bonded foot holds down, and a foot under a given normal force sideways."""
    each = np.eye(5)  # the mass's x and y, the bonded foot's x and y, the other foot's x
    stretch = [each[0] - each[2], each[1] - each[3], each[0] - each[4]]
    stiffness = 5.0 * sum(np.outer(row, row) for row in stretch)
    model = ReducedModel(
        mass=np.diag([1.0, 1.0, 0.0, 0.0, 0.0]),
        damping=0.05 * stiffness,
        stiffness=stiffness,
        normal=[each[3], 0 * each[3]],
        tangential=[each[2], each[4]],
        load={0: lift * each[1] + sideways * each[0], 1: 0.3 * each[0] + 0.1j * each[1]},
        outputs={"sled": each[0]},
    )
    bond = ContactLaws("bonded", friction=friction)
    return ContactProblem(
        model, [([0], bond), ([1], ContactLaws("prescribed", normal_force=4.0, friction=0.5))], 0.1, 7
    )


def test_a_bond_that_pulls_has_no_friction_but_holds():
    """The cone was taken to forbid the pull, and the body for unheld, where without friction it was held."""
    rubs, glides = solve(pull_bond(1.0, 0.3)), solve(pull_bond(1.0, 0.0))
    np.testing.assert_allclose(rubs.output("sled"), glides.output("sled"), atol=1e-9)
    barely = pull_bond(0.01, 0.3)  # presses for a part of the period, and rubs then
    steady = integrate(barely)
    assert steady.converged
    np.testing.assert_allclose(solve(barely).output("sled")[1], steady.output("sled")[1], rtol=1e-3)
    with pytest.raises(UnheldBody, match="nothing holds a floating body"):
        solve(pull_bond(1.0, 0.0, sideways=2.5))


def press_ring(twist: float, nodes: int = 12) -> ContactProblem:
    """A ring of bars spread against a hub that does not move, and turned by ``twist`` of what friction can hold."""
    angle = 2 * np.pi * np.arange(nodes) / nodes
    outward, around = np.stack([np.cos(angle), np.sin(angle)], 1), np.stack([-np.sin(angle), np.cos(angle)], 1)
    stiffness, place = np.zeros((2 * nodes, 2 * nodes)), np.arange(2 * nodes).reshape(nodes, 2)
    for i, j in combinations(range(nodes), 2):
        along, bar = outward[j] - outward[i], np.zeros(2 * nodes)
        bar[place[j]], bar[place[i]] = along, -along
        stiffness += 1e7 * np.outer(bar, bar)
    rows = lambda direction: (np.eye(nodes)[:, :, None] * direction[:, None]).reshape(nodes, -1)  # noqa: E731
    pressure, push = -rows(outward), rows(around).sum(axis=0)  # the hub's nodes rest: q_N = -u.n, q_T = u.t
    load = {0: -100.0 * pressure.sum(axis=0) + twist * 100.0 * LIMIT * push}
    mass = np.eye(2 * nodes)
    model = ReducedModel(mass, 1e-5 * stiffness, stiffness, pressure, rows(around), load)
    return ContactProblem(model, ContactLaws(friction=LIMIT), frequency=0.0, harmonics=0)


@pytest.mark.parametrize("twist", [0.0, 1e-9, 1e-3, 0.9])
def test_a_ring_that_friction_holds_does_not_walk_however_little_it_has_to_hold(twist):
    """Without a twist nothing but rounding is left over, and friction forces are nothing but rounding either."""
    problem = press_ring(twist)
    solution = solve(problem)
    assert solution.history("normal_force", 1) == pytest.approx(100.0)
    assert solution.history("friction_force", 1) == pytest.approx(-twist * 100.0 * LIMIT, abs=1e-6)


def test_a_sweep_leaves_out_where_the_body_walks(tmp_path):
    """The pull is not carried where the mass follows the load, whatever the frequency; the rest of a family is kept."""
    problem = sled({0: 0.1, 1: 1.0})
    laws = {1.0: problem.laws, 9.0: ContactLaws("prescribed", normal_force=9.0, friction=LIMIT)}
    curves = frequency_response(problem.model, laws, [0.2, 0.3], 5, progress=False, folder=tmp_path)
    assert curves[1.0].missing == (0.2, 0.3) and curves[9.0].missing == ()
    none, all_ = (path.read_text().splitlines() for path in sorted(tmp_path.glob("*.csv")))
    assert len(none) == 1 and len(all_) == 3, "a curve without a solution is a table without rows"


def ring_on_a_shaft(off: float, pairs: int = 24, radius: float = 1.0, stiffness: float = 1e8) -> ReducedModel:
    """A rigid ring on elastic springs all round a shaft, whose normals are ``off`` the radial direction [rad].

    Coordinates: the ring's x, y and rotation times radius; per pair the shaft's node, normal and tangential.
    """
    angle = 2 * np.pi * np.arange(pairs) / pairs
    turned = angle + off * np.random.default_rng(0).standard_normal(pairs)
    normal, tangential = np.zeros((2, pairs, 3 + 2 * pairs))
    n = -np.column_stack([np.cos(turned), np.sin(turned)])  # out of the ring, inwards
    t = np.column_stack([-n[:, 1], n[:, 0]])
    moved = np.array([[[1.0, 0.0, -radius * np.sin(a)], [0.0, 1.0, radius * np.cos(a)]] for a in angle])
    normal[:, :3], tangential[:, :3] = (sign * np.einsum("ki,kij->kj", d, moved) for sign, d in ((-1, n), (1, t)))
    normal[np.arange(pairs), 3 + 2 * np.arange(pairs)] = 1.0
    tangential[np.arange(pairs), 4 + 2 * np.arange(pairs)] = -1.0
    mass, springs = np.diag([1.0, 1.0, 1.0, *np.zeros(2 * pairs)]), np.diag([0.0] * 3 + [stiffness] * 2 * pairs)
    load = np.zeros((2, 3 + 2 * pairs))
    load[0, 1], load[1, 0] = -2000.0, 5.0
    return ReducedModel(
        mass=mass,
        damping=5.0 * mass + 1e-6 * springs,
        stiffness=springs,
        normal=normal,
        tangential=tangential,
        load=dict(enumerate(load)),
        outputs={"turned": np.eye(3 + 2 * pairs)[2]},
    )


@pytest.mark.parametrize("off", [0.0, 1e-9, 1e-8, 1e-7])
def test_a_round_joint_is_held_by_friction_however_its_nodes_are_rounded(off):
    """Normals off by a mesh's rounding seemed to resist rotation: a ring turned without end, silently."""
    solution = solve(ContactProblem(ring_on_a_shaft(off), ContactLaws(friction=0.2), 100.0))
    assert abs(solution.output("turned")[0]) < 1e-9
    assert np.any(solution.problem.system.laws[-1].static_displacement_row > 0), "it hangs on friction"
    assert "walk" not in solution.summary()


def test_a_law_of_ones_own_need_not_tell_when_it_slips():
    """The walk is then told as if it stuck throughout, and so too short; it ended in a KeyError."""
    solution = solve(sled({0: 0.002, 1: 1.0}))
    system = solution.problem.system

    class Silent(type(system.laws[0])):
        def fields(self, motion):
            return {}

    balance = HarmonicBalance(replace(system, laws=tuple(Silent(**vars(law)) for law in system.laws)))
    unknowns, told = balance.pack(solution.forces, solution.rigid), measure(solution)
    silent = measure_walk(balance, unknowns)
    assert not walks(balance, unknowns) and silent.share == told.share > walking.HELD
    assert 0 < silent.way < told.way


@pytest.mark.parametrize("share", [1e-4, 1e-6, 1e-8])
def test_a_light_sled_walks_however_large_the_forces_beside_it_are(share):
    """Where all forces together said solved, and only the closer look at its own ones that it walks."""
    model = ReducedModel(
        mass=np.diag([share, 1.0]),
        damping=np.diag([0.0, 0.5]),
        stiffness=np.diag([0.0, 10.0]),
        normal=[[0.0, 0.0], [0.0, 1.0]],
        tangential=[[1.0, 0.0], [0.0, 0.0]],
        load={0: [0.1 * share, -50.0], 1: [share, 5.0]},
    )
    pressed = ContactLaws("prescribed", normal_force=share, friction=LIMIT)
    laws = [((0,), pressed), ((1,), ContactLaws("unilateral", "frictionless"))]
    with pytest.raises(NotConverged, match="walks"):
        solve(ContactProblem(model, laws, 0.3, 15))
