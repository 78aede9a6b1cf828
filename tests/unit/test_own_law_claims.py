"""What a law of one's own says of itself, or leaves out, and what is made of it: symmetry, sliding, stability."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
import pytest
from small_models import friction_oscillator, lift_off_oscillator

from ewr_fenicsx import ContactLaws, ContactProblem, ReducedModel, frequency_response, solve, solve_to_accuracy
from ewr_fenicsx.errors import UnheldBody
from ewr_fenicsx.in_time.deviations import differentiate_laws, step_deviations
from ewr_fenicsx.laws.law_kinds import Law, LawKind, MeanBound, Motion, PairGroup, Partial, Response, register_law
from ewr_fenicsx.solution.contact_state import OPEN, SLIP, STICK, classify_contact


@register_law("tangential", "claimed spring")
@dataclass(frozen=True, eq=False)
class ClaimedSpring(LawKind):
    """A spring along the pair with terms of all powers, said to be odd [N/m, N/m^2, N/m^3]."""

    linear: float = 1.0
    square: float = 0.0
    cubic: float = 0.0
    histories: ClassVar[tuple[str, ...]] = ("friction_force", "slip")
    odd: ClassVar[bool] = True

    def acts_in(self, tangents: int) -> tuple[str, ...]:
        return ("tangential",)

    def build(self, group: PairGroup) -> tuple[Law, ...]:
        return (PowerSpring(group.pairs, self.linear, self.square, self.cubic),)


@register_law("tangential", "honest spring")
@dataclass(frozen=True, eq=False)
class HonestSpring(ClaimedSpring):
    """The same, not said to be odd."""

    odd: ClassVar[bool] = False


@register_law("tangential", "slippery spring")
@dataclass(frozen=True, eq=False)
class SlipperySpring(ClaimedSpring):
    """The same, said to slip."""

    slides: ClassVar[bool] = True


@register_law("tangential", "bounded spring")
@dataclass(frozen=True, eq=False)
class BoundedSpring(ClaimedSpring):
    """The same, said to carry mean forces between two bounds [N]."""

    smallest: float = 0.0
    largest: float = 0.0

    def bound_mean(self, spread) -> MeanBound:
        return MeanBound(self.smallest, self.largest)


@dataclass(frozen=True, eq=False)
class PowerSpring(Law):
    pairs: np.ndarray
    slope: float
    square: float
    cubic: float
    direction: str = "tangential"

    def evaluate(self, motion: Motion) -> Response:
        x = motion.displacement["tangential"]
        return Response(
            motion.force["tangential"] + self.slope * x + self.square * x**2 + self.cubic * x**3,
            (
                Partial("force", "tangential", np.ones_like(x)),
                Partial("displacement", "tangential", self.slope + 2 * self.square * x + 3 * self.cubic * x**2),
            ),
        )


@register_law("tangential", "lagging spring")
@dataclass(frozen=True, eq=False)
class LaggingSpring(ClaimedSpring):
    """The same, whose force lags behind by what the law sees of its rate [s]."""

    lag: float = 0.0

    def build(self, group: PairGroup) -> tuple[Law, ...]:
        return (SpringWithLag(group.pairs, self.linear, self.square, self.cubic, lag=self.lag),)


@dataclass(frozen=True, eq=False)
class SpringWithLag(PowerSpring):
    lag: float = 0.0

    def evaluate(self, motion: Motion) -> Response:
        rate = motion.force_rate["tangential"]
        residual, partials = super().evaluate(motion)
        own = Partial("force_rate", "tangential", np.full_like(rate, self.lag))
        return Response(residual + self.lag * rate, (*partials, own))


def spring_along(name: str, load: float = 1.0, **powers: float) -> ContactProblem:
    laws = ContactLaws("prescribed", name, normal_force=0.0, parameters=powers)
    return ContactProblem(friction_oscillator(damping=0.1, load={1: load}), laws, 0.13, 7)


def test_a_law_that_is_said_to_be_odd_and_is_not_is_told():
    """Its even harmonics are zero in the solution, and a quarter of the motion is not."""
    claimed, honest = (solve(spring_along(name, square=0.5)) for name in ("claimed spring", "honest spring"))
    assert claimed.left_out == (0, 2, 4, 6) and honest.left_out == ()
    even = np.linalg.norm(honest.output("tip")[[0, 2]]) / abs(honest.output("tip")[1])
    assert even > 0.2 and honest.cautions == ()
    (told,) = claimed.cautions
    assert "which was left out by symmetry: is odd = True right of ClaimedSpring" in told


def test_a_law_of_even_harmonics_alone_that_is_said_to_be_odd_is_told():
    """Without them it has no force at all."""
    claimed = solve(spring_along("claimed spring", linear=0.0, square=0.5))
    assert not np.any(claimed.forces)
    assert any("which was left out by symmetry: is odd = True right of ClaimedSpring" in c for c in claimed.cautions)


@pytest.mark.parametrize("load", [0.0, 1.0])
def test_a_law_that_is_odd_as_it_says_goes_without_a_word(load):
    solution = solve(spring_along("claimed spring", load, cubic=0.5))
    assert solution.left_out and solution.cautions == ()


def test_no_accuracy_is_reached_by_a_symmetry_that_is_not_there():
    found = solve_to_accuracy(spring_along("claimed spring", square=0.5), 0.01)
    assert not found.reached and "left out by symmetry" in found.limit
    assert solve_to_accuracy(spring_along("claimed spring", cubic=0.5), 0.01).reached


@pytest.mark.parametrize("name, state", [("claimed spring", STICK), ("slippery spring", SLIP)])
def test_a_law_that_says_nothing_of_slipping_slides_if_its_kind_does(name, state):
    """What is stuck by its states has no sliding, and wears nothing; what is said to slide does."""
    solution = solve(spring_along(name, cubic=0.5))
    np.testing.assert_array_equal(classify_contact(solution, 64), state)
    moved = np.abs(solution.history("slip_velocity")).mean() / solution.problem.frequency
    assert moved > 1.0 and solution.merit["J_T"] == pytest.approx(moved * (state == SLIP))


def test_a_pair_that_is_open_slides_whatever_its_friction_leaves_unsaid():
    laws = ContactLaws(tangential="claimed spring", parameters={"linear": 0.01})
    solution = solve(ContactProblem(lift_off_oscillator(excitation=4.0), laws, 0.16, 9))
    is_open = classify_contact(solution, 256) == OPEN
    np.testing.assert_array_equal(solution.sliding_speed(256) > 0, is_open)
    assert 0.1 < is_open.mean() < 0.9


@pytest.mark.parametrize(
    "bounds, holds",
    [((-1.0, 1.0), True), ((0.0, 1.0), False), ((-1.0, 0.0), False), ((-np.inf, np.inf), True)],
)
def test_a_law_holds_a_floating_body_by_what_it_carries_either_way(bounds, holds):
    """Which way it must is not known before the state is."""
    floating = friction_oscillator(stiffness=0.0, damping=0.1, load={0: 0.5, 1: 1.0})
    parameters = dict(zip(("smallest", "largest"), bounds, strict=True))
    laws = ContactLaws("prescribed", "bounded spring", normal_force=0.0, parameters=parameters)
    if holds:
        assert solve(ContactProblem(floating, laws, 0.3, 3)).output("tip")[0].real == pytest.approx(0.5)
    else:
        with pytest.raises(UnheldBody, match="can move without any contact noticing"):
            solve(ContactProblem(floating, laws, 0.3, 3))


UNSEEN = "stability is not looked at: SpringWithLag sees force_rate"


@pytest.mark.parametrize("load, cubic, told", [(1.0, 0.5, (UNSEEN,)), (1.0, 0.0, ()), (0.0, 0.5, ())])
def test_a_law_that_costs_the_look_at_stability_is_told_where_there_is_something_to_see(load, cubic, told):
    """Not where all laws are linear, nor at rest; the same spring without a lag is looked at."""
    assert solve(spring_along("lagging spring", load, cubic=cubic, lag=0.01)).cautions == told
    assert solve(spring_along("claimed spring", load, cubic=cubic)).cautions == ()


HARDENING = ReducedModel([[1.0]], [[2.0]], [[1e4]], tangential=[[1.0]], load={1: [20.0]}, outputs={"x": [1.0]})
CUBIC = ContactLaws("prescribed", "claimed spring", normal_force=0.0, parameters={"linear": 0.0, "cubic": 1.5e7})


@pytest.mark.parametrize("harmonics", [3, 4, 5])
def test_few_harmonics_make_no_instability(harmonics):
    """A hardening spring far above its linear resonance: with three, deviations have an exponent that is none."""
    found = None
    for frequency in range(10, 31, 2):
        found = solve(ContactProblem(HARDENING, CUBIC, float(frequency), harmonics), found)
    assert abs(found.output("x")[1]) > 0.04, "on the upper branch"
    slopes = differentiate_laws(found, 1024)
    assert np.abs(np.linalg.eigvals(step_deviations(found.problem.system, slopes).matrix)).max() < 1
    assert found.multiplier == 0 and not found.unstable


def test_a_hardening_spring_is_followed_round_its_folds_to_what_leaves():
    """Forces there are eighty times those that hold the mass in place, and far less where the branch comes back."""
    curve = frequency_response(HARDENING, CUBIC, np.linspace(15.0, 45.0, 16), 3, progress=False)
    between = [solution for solution in curve.solutions if solution.side < 0]
    assert curve.jumps == () and len(curve.solutions) < 300
    # one harmonic, at the resonance: a = 20 / (2 omega) and omega^2 = 1e4 + 3/4 1.5e7 a^2
    peak = np.sqrt((1e4 + np.sqrt(1e8 + 3 * 1.5e7 * 10.0**2)) / 2)
    resonant = curve.frequencies[np.argmax(np.abs(curve.output("x")[:, 1]))]
    assert resonant == pytest.approx(peak / (2 * np.pi), rel=0.01)
    assert len(between) > 50 and all(solution.unstable for solution in between)
    assert between[len(between) // 2].multiplier.real > 1.1
    told = between[0].cautions[-1]
    assert told.startswith("unstable") and "integrate" not in told


def test_one_such_law_costs_the_whole_joint_the_look():
    """A mass that taps a springy stop, unstable by itself; a pair beside it that does next to nothing hides that."""
    stiffness = [[1.6, -0.6, 0.0], [-0.6, 4.6, -3.0], [0.0, -3.0, 3.0]]
    model = ReducedModel(
        np.diag([1.0, 1.0, 0.0]), np.diag([0.01, 0.01, 0.0]), stiffness,
        normal=[[0.0, 0.0, -1.0], [0.0, 0.0, 0.0]], tangential=[[0.0, 0.0, 0.0], [1.0, 0.0, 0.0]],
        load={1: [0.0, 1.0, 0.0]}, outputs={},
    )  # fmt: skip

    def join(name: str, **parameters: float) -> ContactProblem:
        beside = ContactLaws("prescribed", name, normal_force=0.0, parameters=parameters)
        return ContactProblem(model, [([0], ContactLaws("unilateral", "frictionless")), ([1], beside)], 0.42, 15)

    looked_at = solve(join("claimed spring", linear=1e-6))
    assert looked_at.unstable and not any("not looked at" in line for line in looked_at.cautions)
    lagging = solve(join("lagging spring", linear=1e-6, lag=0.01))
    assert not lagging.unstable and lagging.cautions == (UNSEEN,)
    assert UNSEEN in lagging.summary()
