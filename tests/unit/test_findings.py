"""What is said of a study, for people: as much as there are reasons, however many points they hold for."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest
from small_models import lift_off_oscillator

from ewr_fenicsx import ContactLaws, evolve_wear, frequency_response
from ewr_fenicsx.accuracy.estimates import ErrorEstimate
from ewr_fenicsx.runs import findings


@pytest.mark.parametrize("count, told", [(2, "0.1, 0.2"), (9, "9 solutions from 0.1 to 0.9")])
def test_points_that_fall_short_for_the_same_reason_share_a_line(count, told):
    """Few are named, many are counted; another reason is another line; the worst estimate stands for all."""
    model, laws = lift_off_oscillator(excitation=0.6, damping=0.1), ContactLaws(friction=0.3)
    curve = frequency_response(model, laws, 0.1 * np.arange(1, 11), 3, progress=False, accuracy=0.5)
    assert all(found.reached for found in curve.accurate)
    lines = findings.tell_sweep(curve, curve.solutions[0].problem)
    assert not any("NOT as accurate" in line for line in lines)
    worst = max(found.estimate.total for found in curve.accurate[:count])
    limits = ["harmonic 9 is the highest allowed"] * count + [""] * (9 - count) + ["the modes are too few"]
    accurate = [replace(f, reached=not limit, limit=limit) for f, limit in zip(curve.accurate, limits, strict=True)]
    lines = findings.tell_sweep(replace(curve, accurate=tuple(accurate)), curve.solutions[0].problem)
    short = [line for line in lines if "NOT as accurate" in line]
    assert len(short) == 2
    assert f"at {told} Hz: up to {worst:.1g}; harmonic 9 is the highest allowed; allow more" in short[0]
    assert "at 1 Hz: up to" in short[1] and "the modes are too few" in short[1]


@pytest.mark.parametrize(
    "errors, told",
    [
        (
            (0.01, 1e-4),
            "  estimated error of the response, that of the mesh aside, 0.01 "
            "(harmonics and samples 0.01, modes 0.0001)",
        ),
        (
            (0.3, np.nan),
            "  estimated error of the response, that of the mesh aside, 0.3 (harmonics and samples 0.3); "
            "solver.accuracy = 0.01 takes",
        ),
        (
            (np.inf, np.nan),
            "  NOT accurate: estimated error of the response, that of the mesh aside, inf; solver.accuracy = 0.01 "
            "takes",
        ),
    ],
)
def test_an_error_that_nobody_asked_for_comes_with_its_remedy_where_it_is_large(errors, told):
    estimate = ErrorEstimate(errors[0], np.nan, modes=errors[1])
    line = findings.tell_estimate(estimate, "the response")
    assert line.startswith(told) and ("solver" in line) == ("solver" in told)
    assert findings.list_causes(estimate)["total"] == (errors[0] + np.nan_to_num(errors[1]) if errors[0] < 1 else None)


def test_errors_that_cannot_be_told_are_null_in_the_facts_of_sweeps_and_wear():
    """As of single solutions: Infinity is no JSON, which MATLAB and others would not read."""
    model = replace(lift_off_oscillator(excitation=0.6, damping=0.1), pair_area=[1.0])
    curve = frequency_response(model, ContactLaws(friction=0.3), [0.1, 0.2], 3, progress=False, accuracy=0.5)
    unknown = replace(curve.accurate[0], estimate=ErrorEstimate(np.inf, np.nan), reached=False)
    facts = findings.list_facts_of_sweep(
        replace(curve, accurate=(unknown, curve.accurate[1])), curve.solutions[0].problem
    )
    assert facts["accuracy"]["estimate"] == {"total": None}
    json.dumps(facts, allow_nan=False)
    worn = evolve_wear(replace(curve.solutions[0].problem, harmonics=3), 2, 1e-6, accuracy=0.5, progress=False)
    facts = findings.list_facts_of_wear(replace(worn, steps=(replace(worn.steps[0], estimate=np.inf),)))
    assert facts["accuracy"]["estimate"] == {"total": None} and facts["accuracy"]["short_after_cycles"] == [0]
    json.dumps(facts, allow_nan=False)


def test_frequencies_without_a_solution_share_a_line():
    curve = frequency_response(lift_off_oscillator(), ContactLaws(friction=0.3), [0.1], 1, progress=False)
    for missing, told in (((0.4, 0.3), "0.3, 0.4"), (np.arange(2.0, 9.0), "7 frequencies from 2 to 8")):
        lines = findings.tell_sweep(replace(curve, missing=tuple(missing)), curve.solutions[0].problem)
        assert f"  no solution at {told} Hz" in lines
