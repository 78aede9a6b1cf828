"""Operator splitting: laws as projections, its fixed point, and cold starts from where it ends."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from balance_points import LAWS, prepare
from small_models import PROBLEMS, lift_off_oscillator, random_structure

from ewr_fenicsx import ContactLaws, ContactProblem, ReducedModel, solve
from ewr_fenicsx.balance.balance import HarmonicBalance
from ewr_fenicsx.laws.law_kinds import TANGENTS
from ewr_fenicsx.solver import ladder, newton_path
from ewr_fenicsx.solver import splitting as splitting_module
from ewr_fenicsx.solver.splitting import FEWEST_SAMPLES, QUICK, Splitting, can_split, resample, settle

FEW = 7  # harmonics for which a splitting takes as few samples as it ever does


def pose_problem(problem: ContactProblem, closure: str = "dashpot") -> ContactProblem:
    """A problem with dashpots or springs, at the samples of a splitting."""
    return replace(problem, samples=FEWEST_SAMPLES, harmonics=FEW, closure=closure)


def pose(problem: ContactProblem, closure: str = "dashpot") -> HarmonicBalance:
    """Its balance."""
    return HarmonicBalance(pose_problem(problem, closure).system)


def find_defect(splitting: Splitting, state: np.ndarray) -> np.ndarray:
    """Admissible forces less those of the structure."""
    forces, admissible = splitting.compare(state)
    return admissible - forces


@pytest.fixture
def always_split(monkeypatch):
    """In small joints as well."""
    monkeypatch.setattr(splitting_module, "WORTHWHILE", 0)


@pytest.mark.parametrize("samples, taken", [(None, FEWEST_SAMPLES), (45, 45), (96, 96)])
def test_it_takes_the_samples_given_or_as_many_as_its_harmonics_need(samples, taken):
    """An odd number serves as well as another: with the balance's own it ends at the balance's solution."""
    balance = HarmonicBalance(replace(pose_problem(PROBLEMS["lift-off"]), samples=taken).system)
    splitting = Splitting(balance, samples)
    assert splitting.basis.samples == taken
    found = settle(splitting, splitting.begin(), 1e-7)
    assert found.defect <= 1e-7
    assert np.linalg.norm(balance.firm.residual(splitting.unknowns(found.state))) < 1e-5


def test_laws_see_trial_forces_that_they_cannot_change(monkeypatch):
    """They are parts of an array that other laws see parts of."""
    splitting = Splitting(pose(PROBLEMS["lift-off"]))

    def scale(law, trial):
        trial["normal"][:] *= 2.0
        return trial["normal"]

    monkeypatch.setattr(type(splitting.balance.system.laws[0]), "admit", scale)
    with pytest.raises(ValueError, match="read-only"):
        splitting.compare(splitting.begin())


@pytest.mark.parametrize("kind", LAWS)
def test_a_law_is_the_projection_that_it_says(kind):
    """Residual: the force less what the law admits of it less its impedance times the motion that it opposes."""
    point = prepare(kind, "mixed", (0, 1, 2, 3))
    balance = point.balance
    forces, rigid = balance.unpack(point.unknowns)
    seen = balance.sample(forces, balance.compliance.motion(forces, rigid))
    for law, motion in zip(balance.system.laws, seen, strict=True):
        assert law.opposes in ("displacement", "velocity")
        if law.impedance is None:
            assert law.linear
            continue
        if law.closes == "springs":  # surfaces move by what their springs give way, too, and forces oppose each step
            admitted = law.fields(motion)["admissible_friction_force"]
            bent = (admitted - motion.force[law.direction]) / law.impedance
            surface = motion.displacement[law.direction] + bent
            trial = admitted - law.impedance * (surface - np.roll(surface, 1, axis=0))
            np.testing.assert_allclose(law.admit({**motion.force, law.direction: trial}), admitted, atol=1e-12)
            continue
        moved, force = getattr(motion, law.opposes)[law.direction], motion.force[law.direction]
        if law.opposes == "displacement":
            moved = moved - law.static_target
        trial = {**motion.force, law.direction: force - law.impedance * moved}
        np.testing.assert_allclose(law.evaluate(motion).residual, force - law.admit(trial), atol=1e-12)


@pytest.mark.parametrize("name", ["plane, floating", "plane, lift-off"])
def test_friction_in_a_plane_is_a_projection_too(name):
    balance = pose(PROBLEMS[name])
    forces = 0.3 * np.random.default_rng(0).normal(size=(2, len(balance.basis.orders), balance.rows))
    forces = forces[0] + 1j * forces[1] * (np.array(balance.basis.orders) > 0)[:, None]
    seen = balance.sample(forces, balance.compliance.motion(forces, np.zeros(balance.rigid)))
    slips = 0
    for law, motion in zip(balance.system.laws, seen, strict=True):
        if law.direction == "normal":
            continue
        trial = {d: motion.force[d] - law.impedance * motion.velocity[d] for d in TANGENTS}
        residual, force = law.evaluate(motion).residual, motion.force[law.direction]
        np.testing.assert_allclose(residual, force - law.admit({**motion.force, **trial}), atol=1e-12)
        slips += np.count_nonzero(law.fields(motion)["slipping"])
    assert slips


@pytest.mark.parametrize("closure", ["dashpot", "spring"])
@pytest.mark.parametrize("kind", ["prescribed coulomb", "varying coulomb", "varying coulomb, mean zero"])
def test_given_normal_forces_lead_to_the_solution_of_the_balance(kind, closure):
    """Douglas-Rachford needs no Jacobian, and ends where Newton's method does."""
    balance = pose(prepare(kind, "slip").problem, closure)
    splitting = Splitting(balance)
    found = settle(splitting, splitting.begin(), 1e-8)
    unknowns = splitting.unknowns(found.state)
    assert found.defect < 1e-8 and found.iterations > 10
    assert np.linalg.norm(balance.firm.residual(unknowns)) < 1e-6
    assert np.linalg.norm(balance.firm.residual(balance.pack(*balance.full_stick))) > 0.1


@pytest.mark.parametrize(
    "name, goal",
    [
        ("floating, slip", 1e-5),  # the last to settle are mean friction forces, which next to nothing decides
        ("floating, mean zero", 1e-6),
        ("lift-off", 1e-6),
        ("plane, floating", 1e-6),
        ("plane, lift-off", 1e-6),
    ],
)
@pytest.mark.parametrize("closure", ["dashpot", "spring"])
def test_so_does_contact_that_opens_of_floating_bodies_and_in_a_plane(name, goal, closure):
    balance = pose(PROBLEMS[name], closure)
    splitting = Splitting(balance)
    found = settle(splitting, splitting.begin(), goal)
    assert found.defect < goal and found.iterations > 10
    assert np.linalg.norm(balance.firm.residual(splitting.unknowns(found.state))) < 1e-4
    assert np.linalg.norm(balance.firm.residual(balance.pack(*balance.full_stick))) > 1e-2


@pytest.mark.parametrize("name", PROBLEMS)
def test_where_it_ends_the_balance_is_solved_as_exactly_as_it_ends(name):
    """What mean friction's own equation adds is no force on the structure; the share of it would stay as a residual."""
    splitting = Splitting(pose(PROBLEMS[name]))
    found = settle(splitting, splitting.begin(), 1e-9, QUICK._replace(iterations=2000, patience=1000))
    firm = splitting.balance.firm
    assert np.any(firm.static_force_row >= 1e-4) or name == "floating, mean zero"
    assert found.defect <= 1e-9 and firm.measure_residual(splitting.unknowns(found.state)) < 1e-8


@pytest.mark.parametrize("dear_from, scales", [(0, [1, 1, 10, 100]), (10_000, [1, 1])])
def test_larger_scales_lead_on_in_large_joints_where_a_splitting_stalls(dear_from, scales, monkeypatch):
    """Small ones have Newton steps that cost less."""
    balance, asked = pose(PROBLEMS["lift-off"]), []
    monkeypatch.setattr(splitting_module, "DEAR_FROM", dear_from)

    def stall(splitting: Splitting, *arguments):
        asked.append(splitting.scale[splitting.by_rate][0])
        found = settle(splitting, *arguments)
        return found._replace(defect=5e-3) if len(asked) < 4 else found

    monkeypatch.setattr(splitting_module, "settle", stall)
    looks = list(splitting_module.come_near(balance, Splitting.begin))
    np.testing.assert_allclose(asked[: len(scales)], np.array(scales) * asked[0])
    assert bool(looks) == (dear_from == 0)
    for _, unknowns in looks:
        assert balance.firm.measure_residual(unknowns) < 1e-3


def test_what_one_splitting_found_another_scale_takes_as_it_is():
    balance = pose(PROBLEMS["floating, slip"])
    first, second = Splitting(balance), Splitting(balance, stiffness=10.0)
    np.testing.assert_allclose(second.scale, np.where(first.by_rate, 10.0, 1.0) * first.scale)
    state = settle(first, first.begin(), 1e-3).state
    taken = second.take_over(first, state)
    np.testing.assert_allclose(second.compare(taken)[0], first.compare(state)[0], atol=1e-9 * np.abs(state).max())
    np.testing.assert_allclose(second.unknowns(taken), first.unknowns(state), atol=1e-9)


def test_friction_under_given_normal_forces_is_found_from_anywhere_at_the_resonance():
    """The problem is monotone, however light the damping: every start leads to the one solution, step by step nearer.

    Mean forces of pairs that stick, which are not determined, are set to zero.
    """
    model = random_structure(size=10)
    model = replace(model, damping=1e-3 * model.stiffness, load={0: np.zeros(10), 1: 5.0 * np.ones(10)})
    omega = np.sqrt(np.linalg.eigvals(np.linalg.solve(model.mass, model.stiffness)).real.min())
    normal_force = {0: [9.0, 8.0, 10.0], 1: [3.0j, 2.0, -4.0]}
    laws = ContactLaws("prescribed", friction=0.4, normal_force=normal_force, static_friction="zero")
    balance = pose(ContactProblem(model, laws, omega / (2 * np.pi)))
    splitting, rng = Splitting(balance), np.random.default_rng(0)
    begin = splitting.begin()
    starts = [begin, *(100 * np.abs(begin).max() * rng.normal(size=begin.shape) for _ in range(3))]
    ends = []
    for state in starts:
        before = np.inf
        for _ in range(6000):
            defect = find_defect(splitting, state)
            size = np.linalg.norm(defect / np.sqrt(splitting.scale))
            assert size <= before * (1 + 1e-9) + 1e-12
            before, state = size, state + defect
        ends.append(splitting.unknowns(state))
    for end in ends:
        np.testing.assert_allclose(end, ends[0], atol=1e-5 * np.abs(ends[0]).max())
    assert np.linalg.norm(balance.firm.residual(ends[0])) < 1e-5
    assert np.linalg.norm(ends[0] - balance.pack(*balance.full_stick)) > 0.1 * np.linalg.norm(ends[0])


def test_extrapolation_takes_fewer_iterations():
    splitting = Splitting(pose(PROBLEMS["floating, slip"]))
    found = settle(splitting, splitting.begin(), 1e-4)
    state, unit = splitting.begin(), splitting.balance.force_unit * np.sqrt(FEWEST_SAMPLES / 2)
    plain = 1
    while np.linalg.norm(defect := find_defect(splitting, state)) > 1e-4 * unit and plain < 2000:
        state, plain = state + defect, plain + 1
    assert found.defect <= 1e-4 and 1.5 * found.iterations < plain


def test_full_stick_is_its_own_answer_where_nothing_slips():
    splitting = Splitting(pose(PROBLEMS["stuck"]))
    assert settle(splitting, splitting.begin(), 1e-8).iterations == 1


def test_the_state_of_a_coarser_set_goes_on_with_more_samples():
    coarse, fine = (
        Splitting(HarmonicBalance(replace(PROBLEMS["lift-off"], harmonics=n, closure="dashpot").system))
        for n in (5, 40)
    )
    found = settle(coarse, coarse.begin(), 1e-4)
    went_on = resample(found.state, fine)
    assert len(went_on) == 4 * len(found.state)
    np.testing.assert_allclose(went_on[::4], found.state, atol=1e-9 * np.abs(found.state).max())
    assert settle(fine, went_on, 1e-3).iterations < settle(fine, fine.begin(), 1e-3).iterations


@pytest.mark.parametrize("name", ["floating, slip", "lift-off", "plane, floating", "prescribed"])
def test_a_solution_is_a_state_that_stays(name):
    """Forces and motions of a solution with as many samples, joined into a state, are admitted as they are."""
    problem = pose_problem(PROBLEMS[name])
    solution, splitting = solve(problem, tolerance=1e-11), Splitting(HarmonicBalance(problem.system))
    motion = problem.system.compliance.motion(solution.forces, solution.rigid)
    state = splitting.join(solution.forces, motion)
    found = settle(splitting, state, 1e-9)
    kept = splitting.balance.unpack(splitting.unknowns(found.state))[0]
    np.testing.assert_allclose(kept, solution.forces, atol=1e-3 * np.abs(solution.forces).max())


@pytest.mark.parametrize("closure", ["dashpot", "spring", "mass"])
@pytest.mark.parametrize("name", PROBLEMS)
def test_a_cold_start_finds_what_climbing_finds(name, closure, monkeypatch, always_split):
    problem = replace(PROBLEMS[name], closure=closure)
    split = solve(problem)
    monkeypatch.setattr(ladder, "can_split", lambda _: False)
    climbed = solve(replace(problem))
    for output in problem.model.outputs:
        found, expected = split.output(output), climbed.output(output)
        np.testing.assert_allclose(found, expected, atol=1e-6 * np.abs(expected).max())
    assert split.fallbacks == climbed.fallbacks == ()


def test_from_where_it_ends_newton_takes_fewer_steps(monkeypatch, always_split):
    problems = [replace(p, harmonics=15) for name, p in PROBLEMS.items() if name not in ("stuck", "prescribed")]
    split = sum(solve(p).iterations for p in problems)
    monkeypatch.setattr(ladder, "can_split", lambda _: False)
    assert 1.5 * split < sum(solve(replace(p)).iterations for p in problems)


def test_where_springs_do_not_settle_dashpots_lead_on(monkeypatch):
    """In joints that bounce, beside a structure that answers as a mass: what comes out is near."""
    balance = pose(PROBLEMS["lift-off"], "spring")
    sprung, asked = Splitting(balance), []
    assert sprung.sprung.any() and not np.any(Splitting(balance, springs=False).sprung)

    def stall(splitting: Splitting, *arguments):
        asked.append(bool(splitting.sprung.any()))
        found = settle(splitting, *arguments)
        return found._replace(defect=0.03) if asked[-1] else found

    monkeypatch.setattr(splitting_module, "settle", stall)
    _, unknowns = next(splitting_module.come_near(balance, Splitting.begin))
    assert asked == [True, False, False]
    assert (
        np.linalg.norm(balance.residual(unknowns))
        < 0.1
        < np.linalg.norm(balance.residual(balance.pack(*balance.full_stick)))
    )


def test_where_it_does_not_settle_newton_climbs(monkeypatch, always_split):
    """No Newton step is lost on a start far from a solution; those lost on one that leads nowhere count."""
    problem = PROBLEMS["floating, slip"]
    monkeypatch.setattr(ladder, "can_split", lambda _: False)
    climbed = solve(replace(problem)).iterations
    monkeypatch.setattr(ladder, "can_split", can_split)
    monkeypatch.setattr(splitting_module, "settle", lambda *at: settle(*at)._replace(defect=0.1))
    assert solve(replace(problem)).iterations == climbed
    monkeypatch.setattr(splitting_module, "settle", settle)
    monkeypatch.setattr(ladder, "SPLIT_STEPS", 1)
    monkeypatch.setattr(newton_path, "can_follow", lambda _: False)  # it leads on from there
    assert solve(replace(problem)).iterations > climbed


def test_scales_are_firmer_where_bodies_above_their_modes_would_blow_a_state_up(monkeypatch):
    """At some harmonic they move against the force by about as much as the scale divides it."""

    def split(harmonics: int, *firmnesses: float) -> Splitting:
        monkeypatch.setattr(splitting_module, "FIRMNESSES", firmnesses)
        return Splitting(HarmonicBalance(replace(PROBLEMS["floating, slip"], harmonics=harmonics).system))

    given = splitting_module.FIRMNESSES
    usual, few, chosen, none = split(63, 1.0), split(15, *given), split(63, *given), split(63, 1.0, 3.0)
    np.testing.assert_array_equal(few.scale, split(15, 1.0).scale)
    reflected = 2 * usual.inverse[1:] - np.eye(usual.balance.rows)
    assert usual.growth == pytest.approx(np.linalg.norm(reflected, 2, axis=(1, 2)).max(), rel=0.1)
    assert chosen.growth < 5 < 30 < usual.growth
    np.testing.assert_allclose(chosen.scale, np.where(usual.by_rate, 1, 10) * usual.scale)
    assert settle(usual, usual.begin(), 1e-3).defect > 0.03
    found = settle(chosen, chosen.begin(), 1e-3)
    assert found.defect <= 1e-3 and found.iterations < 40
    np.testing.assert_array_equal(none.scale, usual.scale)  # where nothing tried is firm enough
    np.testing.assert_array_equal(none.inverse, usual.inverse)


def test_a_structure_without_an_answer_is_climbed(monkeypatch, always_split):
    def refuse(_):
        raise np.linalg.LinAlgError

    monkeypatch.setattr(splitting_module, "Splitting", refuse)
    assert solve(replace(PROBLEMS["floating, slip"])).fallbacks == ()


def test_laws_that_are_no_projections_are_not_split(monkeypatch, always_split):
    """As laws of one's own that do not say so."""
    balance = pose(PROBLEMS["lift-off"])
    assert can_split(balance)
    monkeypatch.setattr(type(balance.system.laws[0]), "opposes", "")
    assert not can_split(balance)
    assert solve(replace(PROBLEMS["lift-off"])).fallbacks == ()


def test_a_static_state_is_split_as_well(always_split):
    """At 0 Hz there is one sample, and the pair that the load opens is open."""
    model = lift_off_oscillator()
    for lift, opens in ((0.1, False), (30.0, True)):
        model = replace(model, load={0: np.array([0.0, lift, 0.0, -1.0])})
        solution = solve(ContactProblem(model, ContactLaws(friction=0.1), 0.0))
        assert solution.fallbacks == () and (abs(solution.forces[0, 0]) < 1e-8) == opens


def test_a_defect_is_measured_by_the_forces_where_the_unit_of_force_is_far_above_them(always_split):
    """As where full stick closes gaps that stay open: what settles is near a solution all the same."""
    problem = pose_problem(PROBLEMS["lift-off"])
    balance = HarmonicBalance(problem.system)
    vast = HarmonicBalance(problem.system, 100 * balance.force_unit)
    ends = [settle(s := Splitting(b), s.begin(), 1e-3) for b in (balance, vast)]
    assert ends[0].iterations == ends[1].iterations > 10
    np.testing.assert_array_equal(ends[0].state, ends[1].state)


@pytest.mark.filterwarnings("error")
def test_what_runs_to_infinity_is_left_before_the_laws_see_it():
    balance = pose(PROBLEMS["lift-off"])
    splitting = Splitting(balance)
    found = settle(splitting, 1e300 * splitting.begin(), 1e-3)
    assert found.defect == np.inf and found.iterations == 1
    state = np.full_like(splitting.begin(), np.nan)
    assert settle(splitting, state, 1e-3).defect == np.inf


@pytest.mark.parametrize("harmonic", [40, 70])
def test_it_sees_the_harmonics_of_a_normal_force_that_is_given(harmonic):
    """With samples for its own five only, 70 folded back: it ended 40 % from the solution."""
    stiffness = 2.2 * np.eye(6) - np.eye(6, k=1) - np.eye(6, k=-1)
    model = ReducedModel(
        0.3 * np.eye(6), 0.02 * stiffness, stiffness, tangential=np.eye(6), load={1: [0, 0, 0, 0, 0, 3.0]}
    )
    pressed = ContactLaws("prescribed", normal_force={0: 2.0, harmonic: 1.5}, friction=0.3)
    problem = ContactProblem(model, pressed, 0.2, 5, closure="dashpot")
    balance = HarmonicBalance(problem.system)
    splitting = Splitting(balance)
    solution = solve(problem)
    found, wanted = settle(splitting, splitting.begin(), 1e-8), balance.pack(solution.forces, solution.rigid)
    assert found.defect <= 1e-8
    assert np.linalg.norm(splitting.unknowns(found.state) - wanted) < 0.03 * np.linalg.norm(wanted)
    few = balance.system.restrict((0, 1, 2, 3))
    assert few.basis.samples > 2 * harmonic, "nor do fewer harmonics take fewer"
