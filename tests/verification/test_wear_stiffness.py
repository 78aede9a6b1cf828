"""By how much wear takes the load from what wears, where only some pairs wear or touch: a punch on springs of its own.

With a mean pressure ``p`` given by the load, a pair that alone wears hands its load to the others.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import pytest
from small_models import lift_off_oscillator
from worn_punch import AREA, LOAD, PAIRS, SHARP, STIFFNESS, SWING, punch

from ewr_fenicsx import ContactLaws, ContactProblem, ReducedModel, Tolerance, evolve_wear, solve
from ewr_fenicsx.laws.law_kinds import Law, Motion, PairGroup, Partial, Response, register_law
from ewr_fenicsx.laws.unilateral import Unilateral
from ewr_fenicsx.solution.contact_state import OPEN, classify_contact
from ewr_fenicsx.wear.archard import SAMPLES, find_explicit_limit, find_wear_stiffness

STEEP = 4e-7  # wear coefficient [1/Pa] by which a cycle wears several times the pressure away
DECAY = 4 * STEEP * STIFFNESS * SWING  # of a pair's pressure a cycle, where all else stays


def test_a_pair_beside_others_that_do_not_wear_hands_its_load_to_them_and_wears_no_deeper():
    """They stand as stiff as before: its pressure falls by 4/5 of its wear, and is gone at 5/4 of the mean indent."""
    one = STEEP * np.eye(PAIRS)[4]
    limit = find_explicit_limit(find_wear_stiffness(solve(punch()), one))
    assert limit == pytest.approx(2 / (0.8 * DECAY), rel=SHARP)
    assert "more than contact can follow" in evolve_wear(punch(), 50, one).stopped
    worn = evolve_wear(punch(), 50, one, Tolerance(share=0.01)).depth[-1]
    assert worn[4] == pytest.approx(1.25 * LOAD / (PAIRS * AREA * STIFFNESS), rel=0.02)
    np.testing.assert_array_equal(worn[:4], 0.0)


def test_pressures_are_over_the_area_of_each_pair():
    """A pair of a small area wears faster, and what it wears relieves it by as much more."""
    areas = AREA * np.array([0.5, 1.0, 1.0, 2.0, 3.0])
    problem = replace(punch(), model=replace(punch().model, pair_area=areas))
    decay = find_wear_stiffness(solve(problem), np.full(PAIRS, STEEP))
    shared = np.eye(PAIRS) - 1 / PAIRS  # of equal springs under one punch
    np.testing.assert_allclose(decay, DECAY * (AREA / areas)[:, None] * shared, atol=SHARP * DECAY)


@pytest.mark.parametrize("jump", [None, Tolerance(share=0.01)])
def test_two_pairs_of_a_rigid_block_wear_as_one_of_twice_the_area(jump):
    """Nothing bends between them: what they leave of a common stiffness is rounding, and no limit to what follows."""

    def wear(pairs: int, area: float) -> float:
        block = ReducedModel(
            mass=np.eye(2),
            damping=np.diag([50.0, 0.0]),
            stiffness=np.diag([1e6, 0.0]),
            normal=[[0.0, 1.0]] * pairs,
            tangential=[[1.0, 0.0]] * pairs,
            load={0: [0.0, -100.0], 1: [80.0, 0.0]},
            pair_area=np.full(pairs, area),
        )
        problem = ContactProblem(
            block, ContactLaws(friction=0.3), 150.0, 5, closure="dashpot", rho_tangential=1e-3 * pairs
        )
        history = evolve_wear(problem, 30, 1e-11, jump)
        assert history.stopped is None
        return float(history.depth[-1].mean())

    assert wear(2, 1e-5) == pytest.approx(wear(1, 2e-5), rel=1e-6), "their dashpots give way as one"


def pads_at_one_place(areas, gap) -> ContactProblem:
    """Under a rigid block that slides to and fro by a given swing, 40 µm a cycle, under 100 N."""
    block = ReducedModel(
        mass=np.diag([0.0, 1.0]),
        damping=np.zeros((2, 2)),
        stiffness=np.diag([1e9, 0.0]),
        normal=[[0.0, 1.0]] * len(areas),
        tangential=[[1.0, 0.0]] * len(areas),
        load={0: [0.0, -100.0], 1: [1e9 * 1e-5, 0.0]},
        pair_area=areas,
    )
    return ContactProblem(block, ContactLaws(tangential="frictionless", initial_gap=np.array(gap)), 150.0, 3)


@pytest.mark.parametrize("jump", [None, Tolerance(share=0.01)])
def test_pads_at_one_place_wear_level_one_after_another_down_to_one_that_does_not(jump):
    """The first wears alone for five cycles, then the second with it, and neither any deeper than the third is.

    Pads that are level took the load in turn, a fallback a cycle, and jumps were no longer than a cycle.
    """
    problem = pads_at_one_place([1e-5, 3e-5, 2e-5], [0.0, 2e-6, 5e-6])
    history = evolve_wear(problem, 30, np.array([1e-9, 2e-9, 0.0]), jump)
    alone, both = np.minimum(history.cycles, 5.0), np.maximum(0.0, history.cycles - 5.0)
    first = np.minimum(5e-6, 4e-7 * alone + 4e-3 / (1e-5 / 1e-9 + 3e-5 / 2e-9) * both)
    second = np.maximum(0.0, first - 2e-6)
    within = SHARP if jump is None else 0.01
    exact = np.column_stack([first, second, 0 * first])
    np.testing.assert_allclose(history.depth, exact, atol=within * 5e-6)
    assert not history.leaps and not np.any(history.rate[-1])
    np.testing.assert_allclose(history.gap[-1], 5e-6, rtol=within)


def test_pads_that_wear_level_are_crossed_in_jumps_as_one_pad_is():
    """A million cycles: they took turns, as many fallbacks."""
    history = evolve_wear(pads_at_one_place([1e-5, 3e-5], [0.0, 0.0]), 10**6, 1e-11, Tolerance())
    np.testing.assert_allclose(history.depth[-1], 10**6 * 1e-11 * 100.0 / 4e-5 * 4e-5, rtol=SHARP)
    assert history.solves < 30


def test_nothing_takes_the_load_from_pairs_on_which_a_rigid_block_tips():
    """It follows what wears off three, two of which balance it; what they leave of its one spring is rounding."""
    arms = (-0.7, 0.1, 0.9)
    block = ReducedModel(
        mass=np.diag([1.0, 1.0, 0.4]),
        damping=np.diag([50.0, 0.0, 0.0]),
        stiffness=np.diag([1.3e6, 0.0, 0.0]),
        normal=[[0.3, 1.0, arm] for arm in arms],
        tangential=[[1.0, -0.3, 0.0]] * 3,
        load={0: [0.0, -100.0, 0.0], 1: [80.0, 0.0, 0.0]},
        pair_area=np.full(3, 1e-5),
    )
    problem = ContactProblem(block, ContactLaws(friction=0.1), 150.0, 3, closure="dashpot")
    np.testing.assert_array_equal(find_wear_stiffness(solve(problem), np.full(3, 1e-11)), 0.0)


def test_a_pair_wears_while_it_is_closed_and_stands_as_stiff_throughout():
    """Open for 45 % of the period. Its load over its depth is the static flexibility's inverse, and nothing floats."""
    model = replace(lift_off_oscillator(excitation=4.0), pair_area=[0.5])
    solution = solve(ContactProblem(model, ContactLaws(friction=0.3), 0.2, 9))
    closed = classify_contact(solution, SAMPLES) != OPEN
    assert 0.4 < np.mean(~closed) < 0.5
    flexibility = np.linalg.inv(model.stiffness)[3, 3]
    sliding = (closed * solution.sliding_speed(SAMPLES)).mean() / 0.2
    decay = find_wear_stiffness(solution, np.array([1e-3]))
    assert decay[0, 0] == pytest.approx(1e-3 * sliding / 0.5 / flexibility, rel=1e-12)


def test_what_slides_while_it_is_open_takes_no_pressure_off():
    """Closed for a fifth of the cycle, in which it slides a tenth of its way: ``2 X (1 - c)``, ``c`` that of its end.

    A cycle takes ``decay`` of the depth that is left over; by the whole way it was ten times as much, more than contact
    can follow, and the wear of single cycles was given up.
    """
    spring, load, swing, area, closing = 1e7, 100.0, 1e-5, 2e-5, 0.8
    model = ReducedModel(
        mass=np.zeros((2, 2)),
        damping=np.zeros((2, 2)),
        stiffness=np.diag([1e9, spring]),  # what rubs is driven, what presses is the spring
        normal=[[0.0, 1.0]],
        tangential=[[1.0, 0.0]],
        load={0: [0.0, load * closing], 1: [1e9 * swing, -load]},
        pair_area=[area],
    )
    problem = ContactProblem(model, ContactLaws(tangential="frictionless"), 100.0, 31)
    coefficient = 0.5 * area / (spring * 2 * swing * (1 - closing))  # so that decay is a half
    decay = find_wear_stiffness(solve(problem), np.array([coefficient]))
    assert decay[0, 0] == pytest.approx(0.5, rel=0.1)
    history, left = evolve_wear(problem, 20, coefficient), [load * (1 - closing)]
    for _ in range(20):
        left.append(left[-1] - coefficient * swing / area * spring * left[-1] ** 2 / load)
    assert history.stopped is None
    np.testing.assert_allclose(load * (1 - closing) - spring * history.depth[:, 0], left, rtol=0.02)


def test_a_load_that_open_pairs_do_not_share_wears_on_and_on():
    """Four of five never touch, and nothing takes the load from the fifth, whatever a cycle wears."""
    problem = punch(0.1 * np.array([1.0, 1.0, 0.0, 1.0, 1.0]))
    assert find_explicit_limit(find_wear_stiffness(solve(problem), np.full(PAIRS, STEEP))) == np.inf
    history = evolve_wear(problem, 20, STEEP)
    assert history.stopped is None
    assert history.depth[-1, 2] == pytest.approx(20 * 4 * STEEP * LOAD / AREA * SWING, rel=SHARP)


@pytest.mark.parametrize("first", [2, 1000])
def test_jumps_keep_their_tolerance_where_pairs_flap_in_turn(first):
    """A stiff rocker on a soft spring hangs on one pair at a time, each of which wears as if the other were not there.

    Together they are a million times stiffer than one: damped by that, jumps wore half as deep. Each pair slides for
    half a cycle, while the spring is lifted by ``tilt / 2`` on average.
    """
    spring, load, tilt, swing, areas, cycles = 1e4, 50.0, 2e-4, 1e-5, np.array([1e-5, 5e-5]), 3000
    model = ReducedModel(
        mass=np.zeros((3, 3)),
        damping=np.zeros((3, 3)),
        stiffness=np.diag([1e9, spring, 1e10]),  # what rubs and what tilts is driven, what presses is the spring
        normal=[[0.0, 1.0, 1.0], [0.0, 1.0, -1.0]],
        tangential=[[1.0, 0.0, 0.0]] * 2,
        load={0: [0.0, -load, 0.0], 1: [1e9 * swing, 0.0, 1e10 * tilt]},
        pair_area=areas,
    )
    problem = ContactProblem(model, ContactLaws(tangential="frictionless"), 100.0, 5)
    history = evolve_wear(problem, cycles, 3e-11, Tolerance(share=0.05, first=first))
    decay = 3e-11 / areas * 2 * swing * spring
    exact = (load / spring + tilt / 2) * (1 - np.exp(-decay * cycles))
    np.testing.assert_allclose(history.depth[-1], exact, atol=0.05 * exact.max())
    assert history.solves < 50


@pytest.mark.parametrize("damped", [True, False])
def test_jumps_keep_their_tolerance_where_a_stop_that_does_not_wear_takes_the_load(damped):
    """A pad wears evenly till then, a thousandth of all cycles: asked for a tenth, it wore half as deep again.

    It ends as deep as the stop's gap and what the stop gives way by under the whole load.
    """
    load, spring, swing, area, gap, cycles = 100.0, 1e8, 1e-5, 1e-5, 1e-5, 10**6
    model = ReducedModel(
        mass=np.zeros((4, 4)),
        damping=np.zeros((4, 4)),
        stiffness=spring * np.array([[10, 0, 0, 0], [0, 2.00001, -1, -1], [0, -1, 1, 0], [0, -1, 0, 1]]),
        normal=[[0.0, 0.0, 1.0, 0.0], [0.0, 0.0, 0.0, 1.0]],
        tangential=[[1.0, 0.0, 0.0, 0.0]] * 2,
        load={0: [0.0, -load, 0.0, 0.0], 1: [10 * spring * swing, 0.0, 0.0, 0.0]},
        pair_area=[area, area],
    )
    problem = ContactProblem(model, ContactLaws(tangential="frictionless", initial_gap=np.array([0.0, gap])), 100.0, 1)
    pace = gap / (1e-3 * cycles)
    coefficient = np.array([pace * area / (load * 4 * swing), 0.0])
    history = evolve_wear(problem, cycles, coefficient, Tolerance(share=0.1, damped=damped))
    assert history.depth[-1, 0] == pytest.approx(gap + load / spring, rel=0.1)
    assert history.solves < 150


@register_law("normal", "rough")
@dataclass(frozen=True, eq=False)
class Rough(Unilateral):
    """Surfaces whose asperities give way like springs [N/m]."""

    asperities: float = 0.0

    def build(self, group: PairGroup) -> tuple[Law, ...]:
        return (Asperities(group.pairs, group.clearance, self.asperities),)


@dataclass(frozen=True, eq=False)
class Asperities(Law):
    pairs: np.ndarray
    initial_gap: np.ndarray
    asperities: float
    direction: str = "normal"

    @property
    def stick_flexibility(self) -> float:
        return 1 / self.asperities

    def evaluate(self, motion: Motion) -> Response:
        gap = motion.displacement["normal"] + self.initial_gap
        stiffness = np.where(gap < 0, self.asperities, 0.0)
        by = Partial("force", "normal", np.ones(gap.shape)), Partial("displacement", "normal", stiffness)
        return Response(motion.force["normal"] + stiffness * gap, by)

    def fields(self, motion: Motion) -> dict[str, np.ndarray]:
        gap = motion.displacement["normal"] + self.initial_gap
        return {"admissible_normal_force": np.maximum(0, -self.asperities * gap), "open": gap >= 0}


def test_a_law_that_gives_way_by_itself_takes_the_load_from_what_wears_as_slowly():
    """An interference between stiff bodies is left to it, and wears away exponentially, in closed form.

    By the bodies' stiffness alone, which is a thousand times its own, jumps were damped as much too hard: 8 % too
    shallow where 1 % was asked for, in a hundred times as many solves.
    """
    stiffness, asperities, swing, interference, coefficient = 1e11, 1e8, 1e-5, 1e-6, 1e-11  # N/m, m, 1/Pa
    model = ReducedModel(
        mass=1e-6 * np.eye(2),
        damping=np.zeros((2, 2)),
        stiffness=np.diag([stiffness, 1e6]),
        normal=[[1.0, 0.0]],
        tangential=[[0.0, 1.0]],
        load={1: [0.0, 1e6 * swing]},
        pair_area=[AREA],
    )
    laws = ContactLaws("rough", "frictionless", initial_gap=-interference, parameters={"asperities": asperities})
    problem = ContactProblem(model, laws, frequency=10.0, harmonics=3)
    both = 1 / (1 / stiffness + 1 / asperities)
    decay = 4 * coefficient * both / AREA * swing
    assert find_wear_stiffness(solve(problem), np.array([coefficient])) == pytest.approx(decay, rel=1e-3)
    cycles = round(2 / decay)
    history = evolve_wear(problem, cycles, coefficient, Tolerance(share=0.01))
    assert history.depth[-1, 0] == pytest.approx(interference * (1 - (1 - decay) ** cycles), rel=0.001)
    assert history.solves < 60
