"""What a summary warns of: few multiples of the loads' harmonics, harmonics left out, modes without damping hit."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from small_models import friction_oscillator, lift_off_oscillator, stop_oscillator

from ewr_fenicsx import ContactLaws, ContactProblem, ReducedModel, solve, solve_to_accuracy
from ewr_fenicsx.errors import NotConverged
from ewr_fenicsx.solution.remedies import list_remedies

RUBS = ContactLaws("prescribed", normal_force=1.0, friction=0.3)


def load_at(harmonic: int, harmonics: int = 5, laws: ContactLaws = RUBS) -> ContactProblem:
    """The same motion whatever the harmonic, but for the weights: the frequency is so many times lower."""
    model = friction_oscillator(damping=0.02)
    model, frequency = replace(model, load={harmonic: model.load[1]}), 0.12 / harmonic
    return ContactProblem(model, laws, frequency, harmonics, samples=64 * harmonic, closure="dashpot")


@pytest.mark.parametrize("harmonic", [2, 3, 4])
def test_few_multiples_of_a_load_s_harmonic_are_told(harmonic):
    (told,) = solve(load_at(harmonic)).cautions
    assert f"all loads act at multiples of harmonic {harmonic}, and few of these are kept" in told
    assert f"give harmonics = {5 * harmonic} or more" in told
    advised, usual = solve(load_at(harmonic, 5 * harmonic)), solve(load_at(1))
    assert advised.cautions == usual.cautions == ()
    assert advised.output("tip")[harmonic] == pytest.approx(usual.output("tip")[1], rel=0.02)


def test_few_multiples_do_where_nothing_rubs_or_opens():
    assert solve(load_at(3, laws=replace(RUBS, friction=5.0))).cautions == ()
    both = lift_off_oscillator()
    assert solve(ContactProblem(replace(both, load=both.load | {3: both.load[1]}), RUBS, 0.1)).cautions == ()


def test_a_harmonic_that_a_list_lacks_is_told_where_contact_excites_it():
    problem = ContactProblem(lift_off_oscillator(), ContactLaws(friction=0.3), 0.16, 9)
    whole, listed = solve(problem), solve(replace(problem, harmonics=(0, 1, 2, 4, 5)))
    share = np.linalg.norm(whole.forces[3]) / np.linalg.norm(whole.forces[1:])
    assert share > 0.2
    (told,) = (line for line in listed.cautions if "not kept" in line)
    assert "at harmonic 3, which is not kept: add it" in told
    assert float(told.split("%")[0].split()[-1]) / 100 == pytest.approx(share, rel=0.5)
    assert not any("not kept" in line for line in solve(replace(problem, harmonics=(0, 1, 2, 3))).cautions)


def test_harmonics_that_are_zero_by_symmetry_may_be_left_out_of_a_list():
    model = friction_oscillator(damping=0.02)
    odd = solve(ContactProblem(model, RUBS, 0.12, (1, 3, 5, 7), closure="dashpot"))
    assert not any("not kept" in line for line in odd.cautions) and odd.merit["friction_dissipation"] > 0
    few = solve(ContactProblem(model, RUBS, 0.12, (1, 2, 5), closure="dashpot"))
    assert any("at harmonic 3, which is not kept" in line for line in few.cautions)


def test_an_accuracy_may_take_as_many_multiples_whatever_the_harmonic():
    tops = [solve_to_accuracy(load_at(h), 1e-6).limit for h in (1, 3)]
    assert ["harmonic 63 is the highest" in tops[0], "harmonic 189 is the highest" in tops[1]] == [True, True], tops


def test_multiples_that_an_accuracy_did_without_count_as_kept():
    """It leaves out what does not matter, and was then told to have too few."""
    model = ReducedModel([[1.0]], [[20.0]], [[1e6]], None, [[1.0]], {2: [100.0]}, outputs={"x": [1.0]})
    solution = solve(ContactProblem(model, replace(RUBS, normal_force=200.0), 75.0), accuracy=0.01)
    assert solution.orders[-1] >= 6 and 4 not in solution.orders and solution.estimated_error <= 0.01
    assert not any("multiples of harmonic" in line for line in solution.cautions)


@pytest.mark.parametrize("friction", [0.0, 0.3])
def test_a_mode_without_damping_that_is_hit_is_told(friction):
    """Friction that the load overcomes adds no bound; a tenth of a per cent of damping does."""
    laws = replace(RUBS, friction=friction)
    for damping, told in ((0.0, True), (0.2, False)):
        model = ReducedModel([[1.0]], [[damping]], [[1e4]], None, [[1.0]], {1: [1.0]}, outputs={"x": [1.0]})
        solution = solve(ContactProblem(model, laws, 100 / (2 * np.pi)))
        assert told == any("harmonic 1 hits a mode without damping" in line for line in solution.cautions)
        assert (abs(solution.output("x")[1]) > 1.0) == told


def test_a_load_that_stands_still_is_no_mode_that_is_hit():
    """A tuned absorber without damping: the dynamic stiffness does no work, and is there all the same."""
    stiffness = [[3.0, -1.0, -1.0], [-1.0, 1.0, 0.0], [-1.0, 0.0, 2.0]]
    model = ReducedModel(np.eye(3), np.zeros((3, 3)), stiffness, None, [[0, 0, 1.0]], {1: [1.0, 0, 0]}, outputs={})
    solution = solve(ContactProblem(model, RUBS, 1 / (2 * np.pi)))
    np.testing.assert_allclose(solution.coordinates[1], [0.0, -1.0, 0.0], atol=1e-6)
    assert not any("without damping" in line for line in solution.cautions)


def test_a_limit_that_swings_counts_as_what_acts_at_its_harmonic():
    model = friction_oscillator(damping=0.02)
    laws = replace(RUBS, normal_force={0: 1.0, 1: 0.6})
    swings = ContactProblem(replace(model, load={2: model.load[1]}), laws, 0.06)
    assert not any("multiples of harmonic" in line for line in solve(swings).cautions)


def test_a_resonance_without_damping_that_has_no_solution_is_named():
    """Friction alone bounds it; what a user should do is not to ask for fewer harmonics."""
    model = ReducedModel([[1.0]], [[0.0]], [[1e6]], None, [[1.0]], {1: [100.0]}, outputs={"tip": [1.0]})
    laws = ContactLaws("prescribed", normal_force=270.0, friction=0.3)
    with pytest.raises(NotConverged, match=r"\. Harmonic 1 hits a mode without damping, .*: add damping"):
        solve(ContactProblem(model, laws, 1000 / (2 * np.pi), 5))


def test_a_resonance_without_damping_that_a_springy_stop_bounds_is_named():
    """The stop's spring takes forces of its own at the harmonic, not small ones; a millionth beside it all is well."""
    taps = ContactLaws(tangential="frictionless", initial_gap=1.0)
    beside = ContactProblem(stop_oscillator(damping=0.0, excitation=0.5), taps, (1 + 1e-6) / (2 * np.pi), 5)
    found = solve(beside)
    hit = replace(beside, frequency=(1 + 1e-10) / (2 * np.pi))
    for residual, problem, named in ((1e-7, hit, True), (1e-3, hit, False), (1e-7, beside, False)):
        best = replace(found, problem=problem, residual=residual, converged=False)
        assert ("Harmonic 1 hits a mode without damping" in list_remedies(best)) == named


def test_a_model_without_a_load_is_told_of():
    problem = ContactProblem(replace(lift_off_oscillator(), load={}), ContactLaws(), 0.1)
    assert any("nothing acts on the joint" in line for line in solve(problem).cautions)
    loaded = solve(replace(problem, load={0: lift_off_oscillator().load[0]}))
    pressed = solve(replace(problem, laws=ContactLaws(initial_gap=-1.0)))
    assert pressed.pair_forces["normal"][0].real.min() > 0.0
    assert not any("nothing acts" in line for line in (*loaded.cautions, *pressed.cautions))


@pytest.mark.parametrize("samples, told", [(12, True), (20, True), (21, False), (None, False)])
def test_samples_that_fold_harmonics_back_are_told(samples, told):
    solution = solve(ContactProblem(lift_off_oscillator(), ContactLaws(friction=0.3), 0.16, 5, samples))
    assert any("a period are few for harmonic 5" in line for line in solution.cautions) == told


def test_few_samples_do_where_nothing_opens_or_slips():
    problem = ContactProblem(lift_off_oscillator(), ContactLaws("bonded", "bonded"), 0.1, 5, 11)
    assert not any("a period are few" in line for line in solve(problem).cautions)
