"""What a problem keeps of what it was given: nothing that is done to it afterwards. And what its copies are."""

from __future__ import annotations

import copy
import pickle
from dataclasses import replace

import numpy as np
import pytest
from small_models import lift_off_oscillator, random_structure

from ewr_fenicsx import ContactLaws, ContactProblem, ReducedModel, evolve_wear, frequency_response, integrate
from ewr_fenicsx.errors import ModelError
from ewr_fenicsx.given import keep
from ewr_fenicsx.solver.weights import adopt_weights


@pytest.mark.parametrize("normal", ["unilateral", "prescribed"])
def test_what_is_done_to_given_arrays_afterwards_changes_nothing(normal):
    """Also in problems that are made of this one, and in what is computed when it is first asked for."""
    pairs, harmonics, force = [2, 0, 1], [0, 1, 3], {0: np.full(3, 5.0), 1: np.full(3, 1j)}
    friction, gap, rho, wear = np.full(3, 0.3), np.full(3, 1e-3), np.full(3, 7.0), np.full(3, 2e-3)
    laws = ContactLaws(
        normal, friction=friction, initial_gap=gap, normal_force=force if normal == "prescribed" else None
    )
    given = {"rho_normal": rho, "rho_tangential": rho, "closure": gap, "wear": wear}
    problem = ContactProblem(random_structure(), [(pairs, laws)], 0.1, harmonics, **given)
    pairs[:], harmonics[2], force[1] = [0, 1, 2], 9, 0.0
    for array in (friction, gap, rho, wear, force[0]):
        array *= 3
    for kept in (problem, replace(problem), pickle.loads(pickle.dumps(problem))):
        assert kept.groups[0][0].tolist() == [2, 0, 1] and kept.basis.orders == (0, 1, 3)
        np.testing.assert_array_equal(kept.friction, 0.3)
        np.testing.assert_array_equal(kept.system.laws[-1].friction, 0.3)
        np.testing.assert_array_equal(kept.clearance, 3e-3 if normal == "unilateral" else 0.0)
        for h, amplitude in kept.given_force.items():
            np.testing.assert_array_equal(amplitude, {0: 5.0, 1: 1j}[h])
        for name, value in {"rho_normal": 7.0, "rho_tangential": 7.0, "closure": 1e-3, "wear": 2e-3}.items():
            np.testing.assert_array_equal(getattr(kept, name), value)
    for array in (problem.wear, problem.rho_normal, laws.friction):
        with pytest.raises(ValueError, match="read-only"):
            array[0] = 1.0
    assert replace(problem).wear is problem.wear, "what nobody can write to need not be copied again"
    assert adopt_weights(problem, replace(problem)) is problem
    view = wear[:]
    view.flags.writeable = False
    assert keep(view) is not view, "its base can be written to"


def test_arrays_of_own_parameters_are_kept_as_well():
    given = {"stiffness": [np.ones(2)], "by_name": {"a": np.ones(2)}}
    kept = keep(given)
    given["stiffness"][0][:], given["by_name"]["a"][:] = 2.0, 3.0
    given["stiffness"].append(4.0)
    np.testing.assert_array_equal(kept["stiffness"], [[1.0, 1.0]])
    np.testing.assert_array_equal(kept["by_name"]["a"], 1.0)


def test_what_was_pickled_can_be_written_to_no_more_than_before():
    laws = [([2, 0, 1], ContactLaws(friction=np.full(3, 0.3)))]
    problem = ContactProblem(random_structure(), laws, 0.1, wear=np.ones(3), load={1: np.ones(9)})
    for kept in (problem, pickle.loads(pickle.dumps(problem)), copy.deepcopy(problem)):
        model = kept.model
        for array in (model.mass, model.tangential, model.rigid_modes, kept.loads[1], kept.wear):
            assert not array.flags.writeable
        assert not kept.laws[0][1].friction.flags.writeable


@pytest.mark.parametrize("modal", [True, False])
def test_a_steady_state_can_be_sent_to_another_process(modal):
    damping = np.diag([0.1, 0.2]) if modal else np.array([[0.1, 0.05], [0.05, 0.2]])
    stiffness = np.diag([1.0, 3.0])
    model = ReducedModel(np.eye(2), damping, stiffness, [[0.0, 1.0]], load={1: [1.0, 0.5]}, outputs={"x": [1, 1]})
    found = integrate(ContactProblem(model, ContactLaws(tangential="frictionless"), 0.1, 3), steps=50, periods=3)
    assert found.scheme.is_diagonal == modal
    sent = pickle.loads(pickle.dumps(found))
    np.testing.assert_array_equal(sent.output("x"), found.output("x"))
    again, first = (integrate(s.problem, s.end, steps=50, periods=1).output("x") for s in (sent, found))
    np.testing.assert_array_equal(again, first)
    position, velocity, carried = sent.scheme.begin(found.end)
    ahead = [s.scheme.run_period(position, velocity, carried, 1e-8, 100) for s in (sent, found)]
    np.testing.assert_array_equal(ahead[0].positions, ahead[1].positions)


def test_numbers_of_a_result_in_other_units_leave_it_as_it_was():
    """A depth in micrometres, in place, made the summary's a million times as deep."""
    model = replace(lift_off_oscillator(), pair_area=[1.0])
    problem = ContactProblem(model, ContactLaws(friction=0.3), 0.16, 3)
    wear = evolve_wear(problem, 2, 1e-6, progress=False)
    curve = frequency_response(model, problem.laws, [0.1, 0.16], 3, progress=False)
    steady = integrate(problem, "rest", steps=50, periods=2, tolerance=0)
    told, table = wear.list_outcome(), curve.table()
    for numbers in (wear.depth, wear.cycles, curve.frequencies, steady.transient("tip")):
        numbers *= 1000
    assert wear.list_outcome() == told and curve.frequencies.tolist() == [0.1, 0.16]
    np.testing.assert_array_equal(curve.table()["frequency [Hz]"], table["frequency [Hz]"])
    assert 1000 * steady.transient("tip")[-1] == numbers[-1]


def test_loads_and_outputs_of_a_model_cannot_be_written_to():
    """A load taken out of a model was gone without a word; one that was put in ended in an error of numpy's."""
    model = random_structure()
    for kept in (model, pickle.loads(pickle.dumps(model)), copy.deepcopy(model)):
        for change in (
            lambda d: d.pop(1),
            lambda d: d.update({3: 5.0}),
            lambda d: d.clear(),
            lambda d: d.__setitem__(3, 5.0),
        ):
            for part in (kept.load, kept.outputs, keep({"a": 1.0})):
                with pytest.raises(TypeError, match="make another one"):
                    change(part)
        assert kept.load.keys() == model.load.keys() and kept.outputs.keys() == model.outputs.keys()
    assert replace(model, load={**model.load, 3: np.ones(model.size)}).load.keys() == {*model.load, 3}


def test_entries_that_a_mask_hides_are_refused():
    """They were read as the numbers that lie under the mask."""
    hidden = lambda values: np.ma.masked_array(values, mask=[True])  # noqa: E731
    given = {"mass": [[1.0]], "damping": [[20.0]], "stiffness": [[1e6]], "tangential": [[1.0]], "load": {1: [100.0]}}
    for name, value in {"mass": hidden([1.0]), "load": {1: hidden([100.0])}, "outputs": {"x": hidden([1.0])}}.items():
        with pytest.raises(ModelError, match=f"{name}.* has entries that its mask hides"):
            ReducedModel(**{**given, name: value})
    with pytest.raises(ModelError, match="friction has entries that its mask hides"):
        ContactLaws(friction=hidden([0.3]))
    model = ReducedModel(**{**given, "mass": np.ma.masked_array([[1.0]], mask=[[False]])})
    assert model.mass == 1.0
    laws = ContactLaws("prescribed", friction=0.3, normal_force={0: np.ma.masked_array([5.0], mask=[False])})
    assert type(laws.normal_force[0]) is np.ndarray
    for name, value in {"wear": hidden([1e-6]), "closure": hidden([1e-9]), "harmonics": hidden([1])}.items():
        with pytest.raises(ModelError, match=f"{name}.*mask"):
            ContactProblem(model, laws, 0.1, **{name: value})
    with pytest.raises(ModelError, match=r"normal_force.* has entries that its mask hides"):
        ContactProblem(model, replace(laws, normal_force={0: hidden([5.0])}), 0.1)
