"""Mistakes in laws of one's own: each is named, and none passes for a solution."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import pytest
from small_models import friction_oscillator

from ewr_fenicsx import ContactLaws, ContactProblem, solve
from ewr_fenicsx.errors import ModelError, NotConverged
from ewr_fenicsx.laws import law_kinds
from ewr_fenicsx.laws.law_kinds import Law, LawKind, Partial, Response, register_law


def damper(**other) -> type:
    """The class of a law ``lam + v = 0``, or of one with other attributes."""
    evaluate = lambda _, motion: Response(  # noqa: E731
        motion.force["tangential"] + motion.velocity["tangential"],
        tuple(Partial(name, "tangential", np.ones_like(motion.force["tangential"])) for name in ("force", "velocity")),
    )
    return type("Damper", (Law,), {"pairs": np.arange(1), "direction": "tangential", "evaluate": evaluate} | other)


def answer(alter):
    return {"evaluate": lambda self, motion: alter(damper().evaluate(self, motion))}


def make_kind(*laws: type, **fields) -> type:
    """A kind that acts in the tangent and builds some laws."""
    build = lambda self, group: [law() for law in laws]  # noqa: E731
    return type("Kind", (LawKind,), {"acts_in": lambda self, tangents: ("tangential",), "build": build} | fields)


def pose(kind: type, monkeypatch, **parameters) -> ContactProblem:
    monkeypatch.setitem(law_kinds._KINDS, ("tangential", "mine"), kind)
    laws = ContactLaws("prescribed", "mine", normal_force=1.0, parameters=parameters)
    return ContactProblem(friction_oscillator(), laws, 0.1, 3)


@pytest.mark.parametrize(
    "laws, message",
    [
        ([damper(**answer(lambda r: r.residual))], r"Damper\.evaluate returns array.*; give a Response\("),
        (
            [damper(**answer(lambda r: r._replace(residual=r.residual.T)))],
            r"a residual of shape \(1, 128\), float64; give",
        ),
        (
            [damper(**answer(lambda r: r._replace(partials=(Partial("force", "tangential", 1.0),))))],
            r"a derivative by the tangential force of shape \(\), .* real numbers of shape \(128, 1\), instants by",
        ),
        (
            [damper(**answer(lambda r: r._replace(partials=(r.partials[1]._replace(variable="velocty"),))))],
            r'a Partial by the variable "velocty"; .* did you mean "velocity"\?',
        ),
        (
            [damper(**answer(lambda r: r._replace(partials=(r.partials[1]._replace(direction="tangent"),))))],
            r'a Partial by the direction "tangent"; .* did you mean "tangential"\?',
        ),
        ([damper(opposes="velocities")], r"Damper\.opposes = 'velocities'; .* did you mean \"velocity\"\?"),
        ([damper(opposes="velocity")], r'Damper\.opposes = "velocity", but it has no admit'),
        (
            [damper(opposes="velocity", admit=lambda self, trial: 0, impedance=np.ones(3))],
            r"Damper\.impedance has shape \(3,\); give one a pair, \(1,\)",
        ),
        ([damper(direction="normal")], r'Damper\.direction = "normal", where .* one in "tangential"'),
        (
            [damper(evaluate=lambda self, motion: motion.displacement["normal"])],
            r'a law asks for a "normal" signal of its pairs, which see "tangential" of that variable',
        ),
        (
            [damper(static_force_row=np.full(3, 1e-4))],
            r"Damper\.static_force_row has shape \(3,\); give one number, or one a pair, \(1,\)",
        ),
        ([], r"0 laws own the tangential force of pair 0; the kind that acts there must build one law"),
        ([damper(), damper()], r"2 laws own the tangential force of pair 0"),
    ],
)
def test_laws_that_make_no_sense_are_refused(laws, message, monkeypatch):
    """Before, a misspelt variable was taken for a displacement, and a row without a law for solved."""
    with pytest.raises(ModelError, match=message):
        solve(pose(dataclass(make_kind(*laws)), monkeypatch))


@pytest.mark.parametrize(
    "fields, message",
    [
        ({"acts_in": lambda *_: "tangential"}, r"Kind\.acts_in returns 'tangential'; give a tuple of some of \"normal"),
        ({"acts_in": lambda *_: ("tangental",)}, r"Kind\.acts_in returns \('tangental',\); give a tuple of some of"),
        ({"holds": lambda *_: "normal"}, r"Kind\.holds returns 'normal'; give a tuple"),
        ({"build": lambda *_: damper()()}, r"Kind\.build returns one Damper; give a tuple of its laws, as \(law,\)"),
    ],
)
def test_kinds_that_make_no_sense_are_refused(fields, message, monkeypatch):
    with pytest.raises(ModelError, match=message):
        solve(pose(dataclass(make_kind(damper(), **fields)), monkeypatch))


def test_what_a_law_reports_is_a_dictionary(monkeypatch):
    law = damper(fields=lambda self, motion: ["warmth"])
    with pytest.raises(ModelError, match=r"Damper\.fields returns \['warmth'\]; give a dictionary, name -> values"):
        solve(pose(dataclass(make_kind(law)), monkeypatch)).merit  # noqa: B018


@pytest.mark.parametrize(
    "report, told",
    [
        (lambda force: np.abs(force).max(axis=0), r"\(1,\), float64"),
        (lambda force: force.T, r"\(1, 128\), float64"),
        (lambda force: 1j * force, r"\(128, 1\), complex128"),
        (lambda force: 1.0, r"\(\), float64"),
    ],
)
def test_what_a_law_reports_is_of_each_pair_at_each_instant(report, told, monkeypatch):
    """Of one number a pair the fewer samples of field files took the first pair's for all."""
    law = damper(fields=lambda self, motion: {"warmth": report(motion.force["tangential"])})
    with pytest.raises(ModelError, match=rf'Damper\.fields returns a "warmth" of shape {told}; give real numbers of'):
        solve(pose(dataclass(make_kind(law)), monkeypatch)).merit  # noqa: B018


def test_a_bound_of_the_mean_is_told_as_one(monkeypatch):
    """It is asked for where a body floats."""
    problem = pose(dataclass(make_kind(damper(), bound_mean=lambda self, spread: (-1.0, 1.0))), monkeypatch)
    floating = friction_oscillator(stiffness=0.0, damping=0.1)
    with pytest.raises(ModelError, match=r"Kind\.bound_mean returns \(-1\.0, 1\.0\); give a MeanBound\(smallest"):
        solve(replace(problem, model=floating))


def test_a_law_that_is_not_linear_as_it_says_is_named(monkeypatch):
    law = damper(linear=True, **answer(lambda r: r._replace(residual=r.residual + r.residual**3)))
    with pytest.raises(NotConverged, match="one linear solve does not do: is linear = True right of Damper"):
        solve(pose(dataclass(make_kind(law)), monkeypatch))


def test_states_that_a_law_tells_as_numbers_count_as_well(monkeypatch):
    tells = damper(fields=lambda self, motion: {"slipping": np.ones(motion.force["tangential"].shape)})
    solution = solve(pose(dataclass(make_kind(tells)), monkeypatch))
    assert np.all(solution.sliding_speed(64).max(axis=0) > 0) and solution.merit["J_T"] > 0


def test_a_law_that_admits_no_force_of_each_pair_at_each_instant_is_refused(monkeypatch):
    """In a joint that is large enough for a splitting; small ones never ask."""
    monkeypatch.setattr("ewr_fenicsx.solver.splitting.WORTHWHILE", 0)
    law = damper(opposes="velocity", admit=lambda self, trial: trial["tangential"].T, linear=False)
    with pytest.raises(ModelError, match=r"Damper\.admit returns an array of shape \(1, 64\); give one of \(64, 1\)"):
        solve(pose(dataclass(make_kind(law)), monkeypatch))


def test_a_history_that_no_law_reports_is_not_zero(monkeypatch):
    solution = solve(pose(dataclass(make_kind(damper(), histories=("slip", "warmth"))), monkeypatch))
    assert np.any(solution.history("slip"))
    with pytest.raises(ModelError, match='names "warmth" in its histories, and no law of it reports that in fields'):
        solution.history("warmth")


def test_parameters_that_do_not_fit_name_their_law(monkeypatch):
    fields = {"__annotations__": {"limit": list}, "build": lambda self, group: group.spread(self.limit)}
    problem = pose(dataclass(make_kind(**fields)), monkeypatch, limit=[1.0, 2.0, 3.0])
    with pytest.raises(ModelError, match='tangential = "mine": 3 values for 1 pairs; give one, or one a pair'):
        solve(problem)


@pytest.mark.parametrize(
    "residual, advice",
    [
        (lambda force: np.nan * force, "infinities or NaN: look at Kind"),
        (lambda force: force**2 + 1, "derivatives of Kind"),
    ],
)
def test_advice_where_laws_of_one_s_own_find_no_solution(residual, advice, monkeypatch):
    """Not to step it in time, which knows none of them."""
    law = damper(**answer(lambda r: r._replace(residual=residual(r.residual))))
    with pytest.raises(NotConverged, match=advice) as failure:
        solve(pose(dataclass(make_kind(law)), monkeypatch))
    assert "integrate(problem)" not in str(failure.value) and "use solve" not in str(failure.value)


def test_a_side_that_is_none_and_a_class_that_is_no_dataclass_are_refused(monkeypatch):
    with pytest.raises(ModelError, match=r'register_law\("tangental", "x"\): .*; did you mean "tangential"\?'):
        register_law("tangental", "x")
    monkeypatch.setitem(law_kinds._KINDS, ("tangential", "bare"), type("Bare", (LawKind,), {}))
    with pytest.raises(ModelError, match=r'tangential = "bare": Bare is no dataclass; write @dataclass'):
        ContactLaws(tangential="bare")


def test_what_is_no_python_file_is_refused(tmp_path):
    with pytest.raises(ModelError, match=r"give a Python file, NAME\.py"):
        law_kinds.load_laws(tmp_path / "my_laws")
