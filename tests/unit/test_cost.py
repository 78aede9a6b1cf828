"""What accuracy costs: errors of figures against closed forms, fronts and slopes of given rows, surveys."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from matplotlib.figure import Figure
from small_models import friction_oscillator, lift_off_oscillator, random_structure

from ewr_fenicsx import ContactLaws, ContactProblem, integrate, solve
from ewr_fenicsx.accuracy.cost import (
    choose_cheapest,
    compare_figures,
    find_front,
    fit_slope,
    list_settings,
    measure_figures,
    survey,
)
from ewr_fenicsx.accuracy.estimates import measure_distance
from ewr_fenicsx.output import cost_plots
from ewr_fenicsx.output.cost_plots import draw_work_precision
from ewr_fenicsx.runs.cost_report import CostReport

PROBLEM = ContactProblem(lift_off_oscillator(), ContactLaws(friction=0.3), 0.7 / (2 * np.pi))


def row(knob="N", value=1, seconds=1.0, error=0.1, converged=True) -> dict:
    return {"knob": knob, "value": value, "unknowns": value, "seconds": seconds, "converged": converged} | {
        "errors": {"output": error}
    }


@pytest.fixture(scope="module")
def truth():
    return measure_figures(solve(replace(PROBLEM, harmonics=80)))


def test_figures_have_no_error_against_themselves(truth):
    errors = compare_figures(truth, truth)
    assert all(error == 0 for name, error in errors.items() if name not in ("signorini", "coulomb"))


def test_errors_are_relative(truth):
    """All motions and forces 1 % larger: every error is that, wear's, a product, twice that."""
    scaled = replace(truth, output=1.01 * truth.output, sliding=1.01 * truth.sliding, wear=1.01**2 * truth.wear)
    scaled = replace(scaled, normal_force=1.01 * truth.normal_force)
    errors = compare_figures(scaled, truth)
    for name in ("output", "rms", "J_T", "largest normal force", "normal forces"):
        assert errors[name] == pytest.approx(0.01)
    assert errors["wear"] == pytest.approx(0.0201)
    assert errors["deepest wear"] == pytest.approx(0.0201)


def test_the_rms_is_that_of_all_outputs(truth):
    both = replace(truth, output=np.column_stack([truth.output, truth.output]))
    second = replace(both, output=both.output * [1.0, 1.5])
    assert compare_figures(second, both)["rms"] == pytest.approx(np.sqrt((1 + 1.5**2) / 2) - 1)


def test_a_phase_error_shows_in_the_response_and_not_in_its_rms(truth):
    turned = replace(truth, output=truth.output * np.exp(0.02j))
    errors = compare_figures(turned, truth)
    assert errors["output"] == pytest.approx(0.02, rel=1e-3)
    assert errors["rms"] < 1e-12


def test_time_stepping_tells_the_same_figures(truth):
    """The two formulations meet: on response, sliding, forces and wear.

    With theta = 1/2 the velocity of the contact node, which has no mass, rings from step to step, and J_T and wear,
    integrals of its absolute value, are 6 % too large: some damping at the scale of the step takes that away.
    """
    high = solve(replace(PROBLEM, harmonics=40))
    steady = integrate(replace(PROBLEM, harmonics=40), high, 1600, 60, 1e-7, theta=0.55)
    errors = compare_figures(measure_figures(steady), truth)
    for name in ("output", "rms", "J_T", "normal forces", "wear"):
        assert errors[name] < 0.003, name


def test_without_outputs_the_contact_tells_how_far_off_a_response_is():
    """As for estimated errors: by what the contact rows move, and their forces, in both formulations."""
    posed = replace(PROBLEM, model=replace(PROBLEM.model, outputs={}))
    coarse, high = (solve(replace(posed, harmonics=n)) for n in (3, 40))
    steady = integrate(replace(posed, harmonics=40), high, 1600, 60, 1e-7, theta=0.55)
    finest, (few, stepped) = measure_figures(high), map(measure_figures, (coarse, steady))
    for name in ("output", "rms"):
        assert compare_figures(few, finest)[name] > 0.02, name
        assert compare_figures(stepped, finest)[name] < 0.01, name
    told = measure_distance(coarse, high)
    assert compare_figures(few, finest)["output"] == pytest.approx(told, rel=1e-12)


def test_a_joint_that_neither_slides_nor_wears_has_no_error_in_it():
    bonded = measure_figures(solve(replace(PROBLEM, laws=ContactLaws("bonded", "bonded"))))
    assert set(compare_figures(bonded, bonded).values()) == {0.0}


def test_a_survey_finds_more_harmonics_more_accurate(truth):
    settings = [s for s in list_settings(PROBLEM, (1, 5, 15), fixed=5) if s.knob == "N"]
    rows = survey(settings, truth, repeats=1)
    assert [r["value"] for r in rows] == [1, 5, 15]
    errors = [r["errors"]["output"] for r in rows]
    assert errors[0] > errors[1] > errors[2]
    assert all(r["converged"] and r["seconds"] > 0 for r in rows)


def test_each_setting_turns_one_knob():
    settings = list_settings(PROBLEM, (1, 3, 5), fixed=5)
    usual = next(s.problem for s in settings if s.knob == "tolerance")
    for s in settings:
        differs = {
            name
            for name in ("samples", "rho_normal", "rho_tangential", "closure", "harmonics")
            if not np.array_equal(getattr(s.problem, name), getattr(usual, name))
        }
        differs |= {"tolerance"} if s.tolerance != 1e-8 else set()
        allowed = s.knob.count(",") + 1  # "N, springs, 8 N samples" are three
        assert len(differs) <= allowed, (s.knob, differs)
    knobs = {s.knob for s in settings}
    assert {"N", "samples", "rho_N over default", "rho_T over default", "tolerance", "N, odd harmonics only"} <= knobs


def test_factor_one_is_the_default_weight_on_every_flank():
    model = random_structure(size=9, pairs=3)
    laws = [([0, 2], ContactLaws()), ([1], ContactLaws("prescribed", normal_force=1.0))]
    settings = list_settings(ContactProblem(model, laws, 0.1), (1, 3), fixed=3)
    usual = next(s.problem for s in settings if s.knob == "tolerance")
    for knob in ("rho_N over default", "rho_T over default"):
        same = next(s.problem for s in settings if s.knob == knob and s.value == 1.0)
        for ours, theirs in zip(same.system.laws, usual.system.laws, strict=True):
            np.testing.assert_allclose(ours.rho, theirs.rho, rtol=1e-14)


@pytest.mark.parametrize("mass, tried", [(1e-6, True), (1.0, False)])
def test_springs_are_tried_where_they_act_only(mass, tried):
    """A contact node nearly without mass gives way like a spring at high harmonics; one with mass does not."""
    model = friction_oscillator(mass=mass, damping=0.0, stiffness=1.0)
    problem = ContactProblem(model, ContactLaws("prescribed", normal_force=1.0), 1.0)
    assert tried == ("N, springs" in {s.knob for s in list_settings(problem, (3, 5), fixed=3)})


def test_the_front_holds_what_nothing_beats():
    rows = [
        row(seconds=1, error=0.1),
        row(seconds=2, error=0.2),
        row(seconds=3, error=0.01),
        row(seconds=0.5, error=0.3),
    ]
    assert find_front(rows, "output") == [3, 0, 2]
    rows.append(row(seconds=0.1, error=1e-9, converged=False))
    assert find_front(rows, "output") == [3, 0, 2]


def test_slopes_are_powers():
    size = np.array([1.0, 2.0, 4.0, 8.0])
    assert fit_slope(size, 3 * size**-2.0) == pytest.approx(-2)
    assert np.isnan(fit_slope([1.0, 2.0], [1.0, 0.5]))


def test_an_error_met_by_chance_does_not_count():
    rows = [
        row(value=3, seconds=1, error=0.009),
        row(value=5, seconds=2, error=0.05),
        row(value=9, seconds=4, error=0.008),
    ]
    assert choose_cheapest(rows, "output", 0.01)["value"] == 9
    assert choose_cheapest(rows, "output", 0.001) is None


def test_an_error_that_no_setting_has_is_drawn_as_such(tmp_path, monkeypatch):
    """Given normal forces are exact: nothing that a logarithmic axis could show, beside a panel that has something."""
    drawn = []
    save = Figure.savefig
    monkeypatch.setattr(Figure, "savefig", lambda figure, path, **more: (drawn.append(figure), save(figure, path)))
    rows = [row(value=n, seconds=n, error=1 / n) for n in (1, 2, 5)]
    rows = [r | {"errors": r["errors"] | {"forces": 0.0}} for r in rows]
    draw_work_precision(tmp_path / "cost.png", rows, {"output": "response", "forces": "normal forces"}, "a beam")
    assert (tmp_path / "cost.png").stat().st_size > 0
    response, forces = drawn[0].axes
    assert len(response.get_lines()) == 2 and response.get_xscale() == "log"
    assert not forces.get_lines() and [text.get_text() for text in forces.texts] == ["exact with every setting"]
    assert drawn[0]._suptitle.get_text() == "a beam"


def test_the_front_is_of_all_settings_also_of_those_without_a_curve(tmp_path, monkeypatch):
    """What nothing beats would else be called so only because its rivals are not drawn."""
    drawn = []
    monkeypatch.setattr(Figure, "savefig", lambda figure, path, **more: drawn.append(figure))
    rows = [row(value=n, seconds=n, error=1 / n) for n in (1, 2, 5)]
    rows += [row(value=5, seconds=0.5, error=0.01) | {"knob": "rival"}]
    draw_work_precision(tmp_path / "cost.png", rows, {"output": "response"}, shown=["N"])
    curve, front = drawn[0].axes[0].get_lines()
    assert list(curve.get_xdata()) == [1, 2, 5] and list(front.get_xdata()) == [0.5]


def test_what_ewr_cost_recommends_is_drawn(tmp_path, monkeypatch):
    """Its choice is among all settings of N; a curve of each is in the picture."""
    drawn = []
    monkeypatch.setattr(cost_plots, "draw_work_precision", lambda path, rows, *more: drawn.extend(rows))
    rows = [row(value=3, seconds=1, error=0.1) | {"knob": f"N, way {way}"} for way in range(5)]
    CostReport("a beam", rows, "time stepping", 0.0, "", {}).write(tmp_path)
    assert [r["knob"] for r in drawn] == [r["knob"] for r in rows]
