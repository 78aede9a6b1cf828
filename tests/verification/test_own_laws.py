"""Laws that the package does not know, registered from outside: the recipe in docs/adding_a_law.md, and a cubic spring.

The recipe's Jenkins element has closed forms for its work a cycle and its equivalent stiffness; ``test_jenkins.py``
builds the same element of a spring in the model and Coulomb's law, and both give the same numbers. The cubic spring in
one harmonic is Duffing's ``(k - w^2 m) X + 3/4 c X^3 = P``.
"""

from __future__ import annotations

import ast
import re
import sys
from dataclasses import dataclass, replace
from functools import lru_cache
from importlib.util import module_from_spec, spec_from_file_location
from pathlib import Path

import numpy as np
import pytest
from effects import count_calls
from law_checks import check_rounded_corners
from small_models import friction_oscillator, random_structure
from test_jenkins import AMPLITUDES, LIMIT, SPRING, SUPPORT, drive, exact_force, exact_stiffness, exact_work

import ewr_fenicsx
from ewr_fenicsx import ContactLaws, ContactProblem, ReducedModel, integrate, solve
from ewr_fenicsx.accuracy.estimates import measure_distance
from ewr_fenicsx.balance.balance import HarmonicBalance
from ewr_fenicsx.errors import ModelError, UnheldBody
from ewr_fenicsx.laws.coulomb import Coulomb
from ewr_fenicsx.laws.law_kinds import Law, LawKind, Motion, PairGroup, Partial, Response, known_laws, register_law
from ewr_fenicsx.laws.mean_friction import MEAN_FRICTION_REGULARISATION
from ewr_fenicsx.problem.dashpots import read_weight
from ewr_fenicsx.problem.layout import hold
from ewr_fenicsx.solution.contact_state import SLIP, STICK, classify_contact, list_histories
from ewr_fenicsx.solution.solution import PeriodicSolution

RECIPE = Path(__file__).parents[2] / "docs" / "adding_a_law.md"


@pytest.fixture(scope="module", autouse=True)
def recipe(tmp_path_factory):
    """The recipe's code as a file of a user's, imported."""
    path = tmp_path_factory.mktemp("own") / "jenkins.py"
    path.write_text("\n".join(re.findall(r"```python\n(.*?)```", RECIPE.read_text(encoding="utf-8"), re.DOTALL)))
    spec = spec_from_file_location("jenkins", path)
    module = sys.modules["jenkins"] = module_from_spec(spec)
    spec.loader.exec_module(module)
    yield module
    del sys.modules["jenkins"]


def jenkins(**other) -> ContactLaws:
    return ContactLaws("prescribed", "jenkins", normal_force=0.0, parameters={"spring": SPRING, "limit": LIMIT} | other)


@lru_cache
def drive_law(amplitude: float, highest: int) -> PeriodicSolution:
    """The same motion as in ``test_jenkins.drive``; the spring is in the law, not in the model."""
    model = ReducedModel(
        mass=[[1e-3]],
        damping=[[0.0]],
        stiffness=[[SUPPORT]],
        tangential=[[1.0]],
        load={1: [SUPPORT * amplitude]},
        outputs={"driven": [1.0]},
    )
    return solve(ContactProblem(model, jenkins(), 1e-4, tuple(range(1, highest + 1, 2)), max(256, 64 * highest)))


@pytest.mark.parametrize(
    "amplitude, work, stiffness",
    [(0.32, 0.013, 3e-4), (0.45, 0.0093, 0.0025), (0.75, 0.0050, 0.0046), (1.5, 0.0043, 0.0117)],
)
def test_jenkins_law_tends_to_its_closed_forms(amplitude, work, stiffness):
    """Work a cycle, equivalent stiffness and the loop itself, whose corners converge like 1/N."""
    tau = 2 * np.pi * np.arange(512) / 512

    def measure(highest: int) -> tuple[float, float, float]:
        solution = drive_law(amplitude, highest)
        assert abs(solution.output("driven")[0] / amplitude - 1) < 1e-6
        found = -np.real(solution.pair_forces["tangential"][0, 0] / solution.output("driven")[0])
        loop = -solution.history("admissible_friction_force", 512)[:, 0]
        return (
            abs(solution.merit["friction_dissipation"] / exact_work(amplitude) - 1),
            abs(found / exact_stiffness(amplitude) - 1),
            np.abs(loop - exact_force(amplitude, tau)).max() / LIMIT,
        )

    few, some, many = (measure(n) for n in (5, 15, 45))
    assert many[0] < work and many[1] < stiffness
    assert many[2] < 0.6 * some[2] < 0.36 * few[2]


@pytest.mark.parametrize("amplitude", AMPLITUDES)
@pytest.mark.parametrize("highest", [5, 15])
def test_jenkins_law_is_a_spring_and_coulomb_s_law_in_one(amplitude, highest):
    law, parts = drive_law(amplitude, highest), drive(amplitude, highest)
    np.testing.assert_allclose(law.pair_forces["tangential"], parts.pair_forces["tangential"], atol=1e-7 * LIMIT)
    for theirs, ours in (
        ("admissible_friction_force", "admissible_friction_force"),
        ("slip_velocity", "slider_velocity"),
    ):
        expected = parts.history(theirs, 256)
        np.testing.assert_allclose(law.history(ours, 256), expected, atol=2e-6 * np.abs(expected).max())


def test_its_fields_and_states_come_out_like_those_of_the_package(recipe):
    solution = drive_law(0.75, 15)
    assert set(list_histories(solution)) == {"normal_force", *recipe.Jenkins.histories}
    state = classify_contact(solution, 512)
    slips = np.abs(solution.history("admissible_friction_force", 512)) >= LIMIT * (1 - 1e-12)
    np.testing.assert_array_equal(state, np.where(slips, SLIP, STICK))
    assert 0.1 < slips.mean() < 0.9


def test_each_of_its_derivatives_is_exact(recipe):
    """Full Jacobian against finite differences, and elimination against the full one, stuck and sliding pairs mixed."""
    model = random_structure(size=7, pairs=3)
    problem = ContactProblem(model, jenkins(limit=[0.3, 1.0, 100.0]), 0.1, 3, load={1: 3 * np.ones(7)})
    balance = HarmonicBalance(problem.system)
    point = np.random.default_rng(1).normal(size=balance.size)
    step = balance.linearise(point)
    assert list(step.steady) == [False, False, True]
    change = np.random.default_rng(2).normal(size=balance.size)
    assert all(recipe.compare_derivatives(problem, seed) < 1e-6 for seed in range(3))
    size = np.abs(step.multiply(change)).max()
    np.testing.assert_allclose(step.matrix() @ change, step.multiply(change), atol=1e-12 * size)
    np.testing.assert_allclose(step.solve(step.multiply(change)), change, atol=1e-10 * np.abs(change).max())


def test_a_wrong_derivative_is_found_out(recipe, monkeypatch):
    exact = recipe.SpringSlider.respond
    monkeypatch.setattr(
        recipe.SpringSlider, "respond", lambda *given: exact(*given)._replace(partials=exact(*given)[1][:2])
    )
    problem = ContactProblem(random_structure(size=7, pairs=3), jenkins(limit=100.0), 0.1, 3, load={1: 3 * np.ones(7)})
    assert recipe.compare_derivatives(problem) > 1e-3


def test_its_corners_round_to_the_exact_law():
    problem = ContactProblem(random_structure(size=7, pairs=3), jenkins(limit=0.3), 0.1, 3)
    check_rounded_corners(problem)


def test_below_its_limit_it_is_a_spring_for_the_mean_as_well():
    model = friction_oscillator(mass=1.0, damping=0.1, stiffness=1.0, load={0: 0.3, 1: 0.05})
    solution = solve(ContactProblem(model, jenkins(), 0.1, 3))
    omega = 2 * np.pi * 0.1
    assert solution.output("tip")[0].real == pytest.approx(0.3 / (1 + SPRING), rel=1e-8)
    assert solution.output("tip")[1] == pytest.approx(0.05 / (1 + SPRING - omega**2 + 0.1j * omega), rel=1e-8)


def test_a_slider_pulled_to_its_limit_by_a_mean_load_shakes_down():
    """Once it has slid as far as the load takes it, it rests, and what vibrates is elastic, at a resonance as well."""
    model = friction_oscillator(damping=0.02 * 2**0.5, load={0: 3.0, 1: 0.016j})
    law = ContactLaws("prescribed", "jenkins", normal_force=0.0, parameters={"spring": 1.0, "limit": 1.0})
    found = solve(ContactProblem(model, law, 2**0.5 / (2 * np.pi), 7))
    np.testing.assert_allclose(found.output("tip")[:2], [2.4, 0.4], rtol=1e-3)  # its force swings from 0.2 to 1
    assert found.merit["friction_dissipation"] < 1e-3 * found.merit["viscous_dissipation"]


def test_a_floating_body_may_hang_on_it_up_to_its_limit():
    free = lambda pull: ReducedModel(  # noqa: E731
        mass=[[1.0]], damping=[[0.1]], stiffness=[[0.0]], tangential=[[1.0]],
        load={0: [pull], 1: [0.01]}, outputs={"tip": [1.0]},
    )  # fmt: skip
    solution = solve(ContactProblem(free(0.5 * LIMIT), jenkins(), 0.1, 3))
    assert solution.output("tip")[0].real == pytest.approx(0.5 * LIMIT / SPRING, rel=1e-6)
    with pytest.raises(UnheldBody, match="nothing holds a floating body: 50% of the mean load"):
        solve(ContactProblem(free(2 * LIMIT), jenkins(), 0.1, 3))


@pytest.mark.parametrize("frequency", [158.0, 162.0])
def test_an_accuracy_holds_with_a_law_that_gives_way_by_itself(frequency):
    """Its weight is not the bare pair's mobility. Against Coulomb's law at a massless node behind the same spring."""
    law = ContactLaws("prescribed", "jenkins", normal_force=0.0, parameters={"spring": 2e6, "limit": 30.0})
    model = ReducedModel([[1.0]], [[20.0]], [[1e6]], tangential=[[1.0]], load={1: [100.0]}, outputs={"x": [1.0]})
    behind = ReducedModel(
        np.diag([1.0, 0.0]),
        np.diag([20.0, 0.0]),
        [[3e6, -2e6], [-2e6, 2e6]],
        tangential=[[0.0, 1.0]],
        load={1: [100.0, 0.0]},
        outputs={"x": [1.0, 0.0]},
    )
    rubs = ContactLaws("prescribed", normal_force=100.0, friction=0.3)
    exact = solve(ContactProblem(behind, rubs, frequency, 40, closure="spring"))
    found = solve(ContactProblem(model, law, frequency), accuracy=0.01)
    true = measure_distance(found, exact)
    assert not found.short and true < 0.025 and true / 3 < found.estimated_error < 3 * true


def test_a_survey_of_its_weight_begins_at_the_one_that_it_has():
    """The law makes a weight of its own of the one that it is given; given back, that would be another one."""
    usual = ContactProblem(random_structure(size=7, pairs=3), jenkins(), 0.1, 3)
    given_back = replace(usual, rho_tangential=read_weight(usual, "tangential"))
    np.testing.assert_allclose(given_back.system.laws[0].rho, usual.system.laws[0].rho, rtol=1e-14)


@register_law("normal", "duffing")
@dataclass(frozen=True, eq=False)
class Duffing(LawKind):
    """A cubic spring across the pair [N/m^3]: smooth, and both ways."""

    cubic: float
    histories = ("normal_force",)
    odd = True

    def acts_in(self, tangents: int) -> tuple[str, ...]:
        return ("normal",)

    def build(self, group: PairGroup) -> tuple[Law, ...]:
        return (CubicSpring(group.pairs, group.spread(self.cubic)),)


@dataclass(frozen=True, eq=False)
class CubicSpring(Law):
    pairs: np.ndarray
    cubic: np.ndarray
    direction: str = "normal"

    def evaluate(self, motion: Motion) -> Response:
        opening = motion.displacement["normal"]
        slope = Partial("displacement", "normal", 3 * self.cubic * opening**2)
        return Response(
            motion.force["normal"] + self.cubic * opening**3,
            (Partial("force", "normal", np.ones_like(opening)), slope),
        )


@pytest.mark.parametrize("frequency", [0.05, 0.12, 0.3])
def test_cubic_spring_is_duffing_s_oscillator(frequency):
    model = ReducedModel(
        mass=[[1.0]], damping=[[0.0]], stiffness=[[1.0]], normal=[[1.0]], load={1: [0.4]}, outputs={"tip": [1.0]}
    )
    laws = ContactLaws("duffing", "frictionless", parameters={"cubic": 0.7})
    solution = solve(ContactProblem(model, laws, frequency, (1,)))
    X = solution.output("tip")[0]
    assert abs(X.imag) < 1e-9
    omega = 2 * np.pi * frequency
    assert (1 - omega**2) * X.real + 0.75 * 0.7 * X.real**3 == pytest.approx(0.4, rel=1e-9)
    assert solution.unknowns == 2


def test_an_odd_law_that_sees_the_mean_keeps_even_harmonics_under_a_mean_load():
    model = ReducedModel(
        mass=[[1.0]], damping=[[0.1]], stiffness=[[1.0]], normal=[[1.0]], load={0: [0.5], 1: [0.4]},
        outputs={"tip": [1.0]},
    )  # fmt: skip
    laws = ContactLaws("duffing", "frictionless", parameters={"cubic": 0.7})
    short, full = (solve(ContactProblem(model, laws, 0.1, harmonics)) for harmonics in (7, range(8)))
    assert short.left_out == () and np.abs(full.forces[2]).max() > 1e-2 * np.abs(full.forces).max()
    np.testing.assert_allclose(short.forces, full.forces, atol=1e-9)


@register_law("normal", "gasket")
@dataclass(frozen=True, eq=False)
class Gasket(LawKind):
    """A spring and a damper across the pair [N/m, N s/m]: linear."""

    stiffness: float
    viscosity: float
    histories = ("normal_force",)
    odd = True

    def acts_in(self, tangents: int) -> tuple[str, ...]:
        return ("normal",)

    def build(self, group: PairGroup) -> tuple[Law, ...]:
        return (KelvinVoigt(group.pairs, self.stiffness, self.viscosity),)


@dataclass(frozen=True, eq=False)
class KelvinVoigt(Law):
    pairs: np.ndarray
    stiffness: float
    viscosity: float
    direction: str = "normal"
    linear: bool = True

    def evaluate(self, motion: Motion) -> Response:
        opening, rate = motion.displacement["normal"], motion.velocity["normal"]
        same = np.ones_like(opening)
        return Response(
            motion.force["normal"] + self.stiffness * opening + self.viscosity * rate,
            (
                Partial("force", "normal", same),
                Partial("displacement", "normal", self.stiffness * same),
                Partial("velocity", "normal", self.viscosity * same),
            ),
        )


def test_linear_laws_are_one_solve_and_no_snes():
    """Springs and dampers across the pairs, against the same in the model's matrices."""
    model = replace(random_structure(size=8, pairs=3), load={0: np.ones(8), 1: np.arange(8) - 3j, 2: np.ones(8)})
    laws = ContactLaws("gasket", "frictionless", parameters={"stiffness": 0.7, "viscosity": 0.3})
    with count_calls() as counts:
        solution = solve(ContactProblem(model, laws, 0.1, 4))
    assert not counts and solution.reason == "linear" and solution.iterations == 0 and solution.unknowns == 3 * 9
    rows = model.normal.T @ model.normal
    built_in = replace(model, stiffness=model.stiffness + 0.7 * rows, damping=model.damping + 0.3 * rows)
    expected = solve(ContactProblem(built_in, ContactLaws("prescribed", "frictionless", normal_force=0.0), 0.1, 4))
    np.testing.assert_allclose(solution.output("tip"), expected.output("tip"), rtol=1e-10, atol=1e-12)
    assert solution.merit["energy_error"] > 0.1 and solution.cautions == (), "its damper takes that, no truncation"


@register_law("tangential", "mount")
@dataclass(frozen=True, eq=False)
class Mount(LawKind):
    """A spring and a damper that see no mean, and a weak spring that does: linear."""

    histories = ("friction_force",)
    odd = True

    def acts_in(self, tangents: int) -> tuple[str, ...]:
        return ("tangential",)

    def build(self, group: PairGroup) -> tuple[Law, ...]:
        return (SeesNoMean(group.pairs),)


@dataclass(frozen=True, eq=False)
class SeesNoMean(Law):
    pairs: np.ndarray
    static_displacement_row: float = 0.03
    direction: str = "tangential"
    linear: bool = True

    def evaluate(self, motion: Motion) -> Response:
        away, rate = motion.oscillation["tangential"], motion.velocity["tangential"]
        same = np.ones_like(away)
        return Response(
            motion.force["tangential"] + 0.7 * away + 0.3 * rate,
            (
                Partial("force", "tangential", same),
                Partial("oscillation", "tangential", 0.7 * same),
                Partial("velocity", "tangential", 0.3 * same),
            ),
        )


def test_a_weak_spring_for_the_mean_counts_once_beside_several_derivatives():
    """Against springs and dampers in the model's matrices, another one at the mean."""
    model = replace(random_structure(size=8, pairs=3), load={0: np.ones(8), 1: np.arange(8) - 3j})
    laws = ContactLaws("prescribed", "mount", normal_force=0.0)
    solution = solve(ContactProblem(model, laws, 0.1, 2))
    rows = model.tangential.T @ model.tangential
    omega, (static, harmonic) = 0.2 * np.pi, (model.load[0], model.load[1])
    mean = np.linalg.solve(model.stiffness + 0.03 * rows, static)
    dynamic = model.stiffness + 0.7 * rows + 1j * omega * (model.damping + 0.3 * rows) - omega**2 * model.mass
    first = np.linalg.solve(dynamic, harmonic)
    expected = [model.outputs["tip"] @ x for x in (mean, first)]
    np.testing.assert_allclose(solution.output("tip")[:2], expected, rtol=1e-10)


def test_a_problem_without_an_unknown_left_creates_no_snes():
    """At rest, with the mean friction set to zero under a given force: rows, but nothing to find."""
    model = replace(random_structure(), load={0: np.ones(9)})
    laws = ContactLaws("prescribed", normal_force=1.0, static_friction="zero")
    with count_calls() as counts:
        solution = solve(ContactProblem(model, laws, 0.1, 3))
    assert not solution.unstable and "0 unknowns" in solution.summary()
    assert not counts["SNES"] and solution.unknowns == 0 and solution.converged
    assert not np.any(solution.forces)


@register_law("tangential", "rail")
@dataclass(frozen=True, eq=False)
class Rail(LawKind):
    """Rubs along the first tangent and is guided across it."""

    friction: float = 0.2
    needs = ("normal",)

    def acts_in(self, tangents: int) -> tuple[str, ...]:
        return ("tangential",)

    def holds(self, tangents: int) -> tuple[str, ...]:
        return ("second_tangential",)

    def build(self, group: PairGroup) -> tuple[Law, ...]:
        return (
            Coulomb(
                group.pairs,
                group.spread(self.friction),
                group.weight["tangential"],
                static_force_row=MEAN_FRICTION_REGULARISATION,
            ),
        )


def test_a_rail_in_space_is_a_joint_in_the_plane():
    """Held across, it is the model without that motion; what guides it is no friction, whatever its cone."""
    model = random_structure(size=12, tangents=2)
    model = replace(model, load={0: -40 * model.normal.sum(axis=0), 1: 2 * np.arange(12) + 5j})
    rail = solve(ContactProblem(model, ContactLaws(tangential="rail"), 0.1, 5))
    held = hold(model, model.rows("second_tangential"))[0]
    plane = solve(ContactProblem(replace(held, tangential=held.rows("tangential")), ContactLaws(), 0.1, 5))
    np.testing.assert_allclose(rail.output("tip"), plane.output("tip"), rtol=1e-9)
    assert not rail.fallbacks and not plane.fallbacks, "a fallback may choose between solutions"
    assert plane.merit["friction_dissipation"] > 0 and np.ptp(rail.history("second_friction_force")) > 1.0
    assert rail.merit == pytest.approx(plane.merit, rel=1e-6, abs=1e-9)


def test_own_kinds_are_known_by_name_and_guard_it(recipe):
    assert "jenkins" in known_laws("tangential") and "duffing" in known_laws("normal")
    with pytest.raises(ModelError, match=r'tangential = "coulomb" is ewr_fenicsx\.laws\.coulomb\.DryFriction already'):
        register_law("tangential", "coulomb")(recipe.Jenkins)
    assert register_law("tangential", "jenkins")(recipe.Jenkins) is recipe.Jenkins, "the same again does no harm"


@pytest.mark.parametrize(
    "parameters, message",
    [
        ({"spring": 1.0}, "missing 1 required positional argument: 'limit'; give it in parameters="),
        ({"spring": 1.0, "limt": 2.0}, r'parameters\["limt"\] is not known .* they take .*; did you mean "limit"\?'),
    ],
)
def test_parameters_of_own_kinds_are_checked(parameters, message):
    with pytest.raises(ModelError, match=message):
        ContactLaws("prescribed", "jenkins", normal_force=1.0, parameters=parameters)


def test_time_integration_says_that_it_does_not_know_them():
    with pytest.raises(ModelError, match='tangential = "jenkins": time integration knows only coulomb, frictionless'):
        integrate(ContactProblem(friction_oscillator(), jenkins(), 0.1, 3))


def test_the_driver_names_no_kind_of_law():
    """From the composition to the result files: no name of a kind, no class of a law."""
    files = {path.stem: path for path in Path(ewr_fenicsx.__file__).parent.rglob("*.py")}
    names, laws = {*known_laws("normal"), *known_laws("tangential")}, {"Signorini", "Coulomb", "Bond", "Unilateral"}
    for module in (
        "layout", "contact_problem", "elimination", "balance", "solution", "ladder", "newton", "snes", "smoothing",
        "statics", "contact_state", "output",
    ):  # fmt: skip
        tree = ast.parse(files[module].read_text(encoding="utf-8"))
        words = {
            node.value for node in ast.walk(tree) if isinstance(node, ast.Constant) and isinstance(node.value, str)
        }
        assert words & names == set(), module
        assert {node.id for node in ast.walk(tree) if isinstance(node, ast.Name)} & laws == set(), module
