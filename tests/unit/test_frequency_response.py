"""``frequency_response``: what it returns, writes and takes up again; and that blocks make one curve."""

from __future__ import annotations

import csv
from dataclasses import replace
from types import SimpleNamespace

import h5py
import numpy as np
import pytest
from small_models import friction_oscillator, lift_off_oscillator, stop_oscillator

from ewr_fenicsx import (
    ContactLaws,
    ContactProblem,
    frequency_response,
    frequency_sweep,
    refining,
    solve,
    solve_to_accuracy,
)
from ewr_fenicsx.balance import HarmonicBalance
from ewr_fenicsx.errors import ModelError, NotConverged, OutputError
from ewr_fenicsx.estimates import estimate_errors, measure_distance
from ewr_fenicsx.following import LARGEST_SURPRISE, Jump, agree
from ewr_fenicsx.frequency_sweep import FrequencyResponse
from ewr_fenicsx.refining import join_points, measure_gap, refine_point
from ewr_fenicsx.solution_store import read_records, restore, strip

LAWS = ContactLaws(friction=0.3)
FREQUENCIES = np.linspace(0.08, 0.4, 9)


def sweep(frequencies=FREQUENCIES, laws=LAWS, **settings):
    model = lift_off_oscillator(excitation=0.6, damping=0.1)
    return frequency_response(model, laws, frequencies, harmonics=5, progress=False, **settings)


def test_every_point_is_what_a_cold_solve_finds():
    curve = sweep()
    np.testing.assert_array_equal(curve.frequencies, FREQUENCIES)
    for solution in curve.solutions:
        cold = solve(ContactProblem(solution.problem.model, LAWS, solution.problem.frequency, harmonics=5))
        np.testing.assert_allclose(
            solution.output("tip"), cold.output("tip"), atol=1e-7 * abs(cold.output("tip")).max()
        )
    assert curve.output("tip").shape == (9, 6)


def test_adaptive_frequencies_resolve_the_resonance():
    coarse, fine = sweep(refine=0.3), sweep(refine=0.1)
    assert len(FREQUENCIES) < len(coarse.solutions) < len(fine.solutions)
    assert set(FREQUENCIES) <= set(fine.frequencies)
    steps = np.diff(fine.frequencies)
    peak = fine.frequencies[np.abs(fine.output("tip")[:, 1]).argmax()]
    near = np.abs(fine.frequencies[1:] - peak) < 0.03
    assert steps[near].max() < 0.5 * steps.max(), "points are where the curve bends"


def test_several_values_of_a_parameter_give_a_curve_each():
    family = {mu: replace(LAWS, friction=mu) for mu in (0.1, 0.3)}
    curves = sweep(laws=family)
    assert list(curves) == [0.1, 0.3]
    np.testing.assert_allclose(curves[0.3].output("tip"), sweep().output("tip"), rtol=1e-12)
    assert not np.allclose(curves[0.1].output("tip"), curves[0.3].output("tip"), rtol=1e-3)


def test_a_linear_joint_is_swept_without_newton():
    curve = sweep(laws=ContactLaws("bonded", "bonded"))
    assert [s.unknowns for s in curve.solutions] == [0] * 9
    assert repr(curve) == "FrequencyResponse(9 solutions from 0.08 to 0.4 Hz, 0 jumps, 0 missing)"


def test_table_and_files_hold_the_curve(tmp_path):
    curve = sweep(folder=tmp_path)
    with (tmp_path / "frequency_response.csv").open() as file:
        rows = list(csv.DictReader(file))
    np.testing.assert_array_equal([float(row["frequency [Hz]"]) for row in rows], FREQUENCIES)
    amplitudes = [float(row["|tip| harmonic 1"]) for row in rows]
    np.testing.assert_array_equal(amplitudes, np.abs(curve.output("tip")[:, 1]))
    for h in curve.orders:
        complex_ = [complex(float(row[f"re tip harmonic {h}"]), float(row[f"im tip harmonic {h}"])) for row in rows]
        np.testing.assert_array_equal(complex_, curve.output("tip")[:, h])
    assert np.abs(curve.output("tip")[:, 1].imag).max() > 0.1 * max(amplitudes), "there is a phase to keep"
    np.testing.assert_array_equal([float(row["J_T"]) for row in rows], curve.figure("J_T"))
    with h5py.File(tmp_path / "frequency_response.h5") as file:
        np.testing.assert_array_equal(file["curve_0/forces"][()], [s.forces for s in curve.solutions])
        np.testing.assert_array_equal(file["curve_0/table/J_T"][()], curve.figure("J_T"))
    with pytest.raises(ModelError, match='no figure "J_X"'):
        curve.figure("J_X")


def test_a_table_leaves_out_figures_that_no_law_concerns():
    figures = {"penetration", "tension", "J_N", "J_T", "friction_dissipation", "cone_violation"}
    assert figures <= set(sweep().table())
    held = sweep(laws=ContactLaws("bonded", "bonded")).table()
    assert not figures & set(held) and "rms_tip" in held
    pressed = sweep(laws=ContactLaws("prescribed", normal_force=100.0, friction=0.3)).table()
    assert figures & set(pressed) == {"J_T", "friction_dissipation", "cone_violation"}


def test_an_interrupted_sweep_goes_on_from_what_is_on_disk(tmp_path, monkeypatch):
    whole, solve_block, begun = sweep(), frequency_sweep._solve_block, []

    def interrupted(follower, block, store):
        if len(begun) == 1:
            raise KeyboardInterrupt
        begun.append(block.number)
        return solve_block(follower, block, store)

    monkeypatch.setattr(frequency_sweep, "_solve_block", interrupted)
    with pytest.raises(KeyboardInterrupt):
        sweep(folder=tmp_path)
    assert len(list((tmp_path / "blocks").iterdir())) == 1
    assert not (tmp_path / "frequency_response.h5").exists()
    solved = []
    monkeypatch.setattr(
        frequency_sweep, "_solve_block", lambda f, b, s: solved.append(b.number) or solve_block(f, b, s)
    )
    curve = sweep(folder=tmp_path)
    assert solved == [1], "the first block was on disk"
    np.testing.assert_array_equal(curve.output("tip"), whole.output("tip"))
    with pytest.raises(OutputError, match="another model, laws or settings"):
        sweep(folder=tmp_path, laws=replace(LAWS, friction=0.31))


@pytest.mark.parametrize("keep", [0, 20, 3000], ids=["empty", "cut in its header", "cut"])
def test_a_damaged_block_is_named(tmp_path, keep):
    sweep(folder=tmp_path)
    block = tmp_path / "blocks" / "000_0000.h5"
    block.write_bytes(block.read_bytes()[:keep])
    with pytest.raises(OutputError, match=r"blocks/000_0000.h5 cannot be read: .*; give another place, or remove it"):
        sweep(folder=tmp_path)


def spoil_parent(folder):
    (folder / "taken").write_text("a file")
    return folder / "taken" / "below"


def spoil_results(folder):
    (folder / "frequency_response.h5").mkdir()
    return folder


def spoil_blocks(folder):
    (folder / "blocks").write_text("a file")
    return folder


@pytest.mark.parametrize(
    "spoil, message",
    [
        (spoil_parent, r"taken/below/frequency_response.h5 cannot be written: Not a directory; give a place where"),
        (spoil_results, "frequency_response.h5 cannot be written: it is a folder; give a place"),
        (spoil_blocks, r"blocks/000_0000.h5 cannot be written: .*; give a place"),
        (lambda _: "/proc", r"/proc/frequency_response.h5 cannot be written: .*; give a place where files can be"),
    ],
)
def test_a_folder_that_cannot_be_written_is_refused_before_any_solve(spoil, message, tmp_path, monkeypatch):
    monkeypatch.setattr(frequency_sweep, "_solve_block", lambda *_: pytest.fail("solved"))
    with pytest.raises(OutputError, match=message):
        sweep(folder=spoil(tmp_path))


def test_a_folder_is_made_and_a_table_names_one_that_is_not_there(tmp_path):
    curve = sweep(FREQUENCIES[:2], folder=tmp_path / "below" / "it")
    assert (tmp_path / "below" / "it" / "frequency_response.h5").exists()
    with pytest.raises(OutputError, match=r"nowhere/curve.csv cannot be written: No such file or directory; give"):
        curve.write_csv(tmp_path / "nowhere" / "curve.csv")


def test_records_bring_solutions_back():
    solution = sweep().solutions[3]
    back = restore(solution.problem, strip(solution))
    assert agree(back, solution)
    np.testing.assert_array_equal(back.forces, solution.forces)
    assert (back.reason, back.fallbacks, back.unknowns) == (solution.reason, solution.fallbacks, solution.unknowns)


@pytest.mark.parametrize(
    "bad", [[], [2.0, 1.0], [1.0, 1.0], [0.0, 1.0], [np.nan], [1.0, np.inf], np.ones((2, 2)), "120", None, [[1.0], 2.0]]
)
def test_frequencies_must_rise(bad):
    with pytest.raises(ModelError, match=r"frequencies.*; (give|make)"):
        sweep(frequencies=bad)


def test_a_single_frequency_is_one():
    assert sweep(0.2).frequencies.tolist() == [0.2]


@pytest.mark.parametrize(
    "arguments, message",
    [
        ({"refine": -1}, "refine = -1; give a positive change from point to point such as 0.1, or None"),
        ({"refine": 0}, "refine = 0; give"),
        ({"refine": np.nan}, "refine = nan; give"),
        ({"refine": np.inf}, "refine = inf; give"),
        ({"refine": "fine"}, "refine = 'fine'; give"),
        ({"accuracy": 0.1, "modes": 5}, "modes = 5; list the modal coordinates"),
        ({"accuracy": 1.5}, "accuracy = 1.5; give a relative error between 0 and 1"),
        ({"laws": {}}, "laws = {}; give ContactLaws, or a dictionary"),
        ({"laws": [LAWS]}, r"laws has ContactLaws\(.*; give one ContactLaws for all pairs, or a list of \(pairs, Con"),
        ({"laws": {"good": LAWS, "bad": 0.3}}, "laws has 0.3; give one ContactLaws"),
        ({"sample": 64}, 'sample: no argument of frequency_response; did you mean "samples"'),
        ({"laws": []}, r"laws must cover each of the 1 pairs once; they cover \[\]"),
    ],
)
def test_what_makes_no_sweep_is_refused_before_any_solve(arguments, message, monkeypatch):
    monkeypatch.setattr(frequency_sweep, "_solve_block", lambda *_: pytest.fail("solved"))
    with pytest.raises(ModelError, match=message):
        sweep(**arguments)


def test_every_point_of_an_accurate_sweep_is_as_accurate_as_asked():
    """Against a sweep with many harmonics, and against single solves to the same accuracy, from cold."""
    accuracy = 0.02
    curve = sweep(accuracy=accuracy)
    model = curve.solutions[0].problem.model
    truth = frequency_response(model, LAWS, FREQUENCIES, 60, progress=False)
    for found, true in zip(curve.accurate, truth.solutions, strict=True):
        assert found.reached and found.estimate.total <= accuracy
        assert measure_distance(found.solution, true) <= accuracy
        single = solve_to_accuracy(ContactProblem(model, LAWS, true.problem.frequency), accuracy)
        assert measure_distance(found.solution, single.solution) <= 2 * accuracy
    tops = [s.orders[-1] for s in curve.solutions]
    assert len(set(tops)) > 1, "harmonics are chosen at each frequency"
    assert [found.solution for found in curve.accurate] == list(curve.solutions)
    table = curve.table()
    np.testing.assert_array_equal(table["highest_harmonic"], tops)
    np.testing.assert_array_equal(table["estimate"], [found.estimate.total for found in curve.accurate])
    assert f"|tip| harmonic {max(tops)}" in table
    lean = tops.index(min(tops))
    assert curve.output("tip")[lean, curve.orders.index(max(tops))] == 0.0, "a harmonic that this one has not"


def test_a_finer_sweep_gives_the_same_curve():
    coarse, fine = sweep(accuracy=0.02), sweep(np.linspace(0.08, 0.4, 17), accuracy=0.02)
    for here, there in zip(coarse.accurate, fine.accurate[::2], strict=True):
        assert measure_distance(here.solution, there.solution) <= 0.04


def test_points_that_are_not_as_accurate_as_asked_say_why():
    curve = sweep(FREQUENCIES[2:4], accuracy=1e-6)
    assert not any(found.reached for found in curve.accurate)
    assert all("harmonic 63 is the highest allowed" in found.limit for found in curve.accurate)
    assert (curve.table()["estimate"] > 1e-6).all()


def test_a_point_without_a_more_accurate_solution_stays_and_says_so(monkeypatch):
    def fail(problem, *_, **__):
        raise NotConverged("lost", best=solve(problem))

    monkeypatch.setattr(refining, "solve_to_accuracy", fail)
    coarse, curve = sweep(), sweep(accuracy=0.02)
    np.testing.assert_array_equal(curve.output("tip"), coarse.output("tip"))
    assert not any(found.reached for found in curve.accurate)
    assert all(found.limit.startswith("no solution found with harmonics up to 5") for found in curve.accurate)
    assert [found.estimate.total for found in curve.accurate] == [estimate_errors(s).total for s in coarse.solutions]


def test_a_point_without_a_more_accurate_solution_is_solved_on_a_model_with_more_modes(monkeypatch):
    """Its forces are not a solution there, though they were one before."""

    def fail(problem, *_, **__):
        raise NotConverged("lost", best=solve(problem))

    monkeypatch.setattr(refining, "solve_to_accuracy", fail)
    curve = sweep()
    model = curve.solutions[0].problem.model
    stiffer = replace(model, stiffness=1.1 * model.stiffness)
    problem = ContactProblem(stiffer, LAWS, FREQUENCIES[0], 5)
    for found in refining.refine_points(problem, curve.solutions, 0.02):
        balance = HarmonicBalance(found.solution.problem.system)
        left = np.linalg.norm(balance.residual(balance.pack(found.solution.forces, found.solution.rigid)))
        assert found.solution.problem.model is stiffer and found.solution.converged and left < 1e-8
        assert not found.reached and found.limit


def test_an_accurate_curve_may_begin_with_the_mean_alone():
    at_rest = replace(model := lift_off_oscillator(), load={0: model.load[0]})
    curve = frequency_response(at_rest, LAWS, FREQUENCIES[:2], harmonics=0, accuracy=0.01, progress=False)
    assert all(found.reached for found in curve.accurate)


def test_an_accurate_curve_goes_round_its_folds():
    """With more harmonics the upper fold comes earlier: points that fall off there go, the rest is one curve."""
    model, laws = stop_oscillator(), ContactLaws(tangential="frictionless", initial_gap=1.0)
    frequencies = np.linspace(0.15, 0.18, 7)
    curve = frequency_response(model, laws, frequencies, 7, progress=False, accuracy=0.01)
    assert curve.jumps == () and curve.missing == ()
    assert set(frequencies) <= set(curve.frequencies)
    assert all(found.reached for found in curve.accurate)
    turns = np.flatnonzero(np.diff(np.sign(np.diff(curve.frequencies)))) + 1
    assert len(turns) == 2
    # between the folds the response falls all the way but for the accuracy: no point is one of another branch
    heights = np.abs(curve.output("tip")[turns[0] : turns[1] + 1, curve.orders.index(1)])
    assert (np.diff(heights) < 0.01 * heights[:-1]).all()
    assert heights[0] > 1.7 and heights[-1] < 1.01


def test_a_curve_that_falls_off_its_branch_is_broken_there():
    """A point from the lower branch in place of the upper one: told where it is wanted, left out elsewhere."""
    model, laws = stop_oscillator(), ContactLaws(tangential="frictionless", initial_gap=1.0)
    upper = frequency_response(model, laws, [0.160, 0.165, 0.166, 0.167], 7, progress=False)
    found = [solve_to_accuracy(s.problem, 0.02, s) for s in upper.solutions]
    lower = None
    for frequency in (0.18, 0.172, 0.169, 0.166):
        lower = solve(replace(upper.solutions[2].problem, frequency=frequency), lower)
    fallen = [*found[:2], replace(found[2], solution=lower), found[3]]
    frequencies = list(upper.frequencies)
    assert join_points(upper.solutions, found, frequencies)[1] == []
    kept, jumps = join_points(upper.solutions, fallen, frequencies)
    assert kept == fallen
    assert [jump.frequency for jump in jumps] == [(0.165, 0.166), (0.166, 0.167)]
    kept, jumps = join_points(upper.solutions, fallen, [0.160, 0.165, 0.167])
    assert kept == [fallen[0], fallen[1], fallen[3]] and jumps == []


def test_breaks_of_a_curve_are_where_its_jumps_are():
    """Between the points that a jump names, or the first one beyond; each jump once, also where a curve runs back."""
    points = [SimpleNamespace(problem=SimpleNamespace(frequency=f)) for f in (1.0, 2.0, 3.0, 2.5, 2.0, 3.0, 5.0)]
    breaks = lambda *ends: FrequencyResponse(tuple(points), tuple(Jump(e, "") for e in ends), ()).breaks  # noqa: E731
    assert breaks() == ()
    assert breaks((2.0, 3.0)) == (1,) and breaks((2.0, 3.0), (2.0, 3.0)) == (1, 4)
    assert breaks((3.0, 2.5)) == (2,) and breaks((3.0, 4.0)) == (5,)
    assert breaks((3.7, 5.0)) == (5,), "from a point between given frequencies, which is not kept"


def test_a_curve_that_is_refined_again_tells_its_jumps_once(monkeypatch):
    """As with more modes; a jump told twice would break the curve at a second place."""
    curve, jump = sweep(accuracy=0.1), Jump((0.1, 0.2), "with more harmonics")
    monkeypatch.setattr(frequency_sweep, "join_points", lambda points, found, *_: (found, [jump]))
    problem = curve.solutions[0].problem
    for _ in range(2):
        curve = frequency_sweep.refine_response(curve, problem, curve.frequencies, 0.1)
        assert curve.jumps == (jump,)


def test_accurate_curves_are_kept_in_files(tmp_path):
    """Forces of solutions with different harmonics in one array; each has its own rows."""
    curve = sweep(accuracy=0.02, folder=tmp_path)
    with h5py.File(tmp_path / "frequency_response.h5") as file:
        records = read_records(file["curve_0"])
        np.testing.assert_array_equal(file["curve_0/table/estimate"][()], curve.table()["estimate"])
    assert len({len(record.forces) for record in records}) > 1
    problem = ContactProblem(curve.solutions[0].problem.model, LAWS, 1.0)
    for record, solution in zip(records, curve.solutions, strict=True):
        back = restore(replace(problem, frequency=record.frequency), record)
        assert back.orders == solution.orders
        np.testing.assert_array_equal(back.output("tip"), solution.output("tip"))
        assert np.linalg.norm(HarmonicBalance(back.problem.system).residual(pack(back))) < 1e-8
    with (tmp_path / "frequency_response.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert [int(row["highest_harmonic"]) for row in rows] == [s.orders[-1] for s in curve.solutions]


def pack(solution):
    return HarmonicBalance(solution.problem.system).pack(solution.forces, solution.rigid)


def test_a_point_that_crossed_a_fold_is_told_or_left_out():
    """The upper branch's solution in place of the unstable one: near enough to pass for it but for its side."""
    model, laws = stop_oscillator(), ContactLaws(tangential="frictionless", initial_gap=1.0)
    curve = frequency_response(model, laws, np.linspace(0.15, 0.18, 7), 7, progress=False)
    points = [s for s in curve.solutions if s.side < 0 and 0.1697 < s.problem.frequency < 0.17055]
    assert len(points) >= 3
    upper = solve(points[1].problem, max(curve.solutions, key=lambda s: abs(s.output("tip")[1])))
    assert upper.side == 1 and 0.04 < measure_gap(points[1], upper) < LARGEST_SURPRISE
    found = [refine_point(s.problem, s, 0.02, 1e-8, 7) for s in points]
    assert join_points(points, found, []) == (found, [])
    found[1] = replace(found[1], solution=upper)
    kept, jumps = join_points(points, found, [])
    assert kept == [found[0], *found[2:]] and jumps == []
    kept, (jump, *_) = join_points(points, found, [points[1].problem.frequency])
    assert kept == found and "this is beyond its fold" in jump.why
    assert jump.frequency == (points[0].problem.frequency, points[1].problem.frequency)


def test_harmonics_that_symmetry_makes_zero_cost_no_point_of_a_curve_anything():
    model, laws = friction_oscillator(), ContactLaws("prescribed", normal_force=1.0, friction=0.3)
    short, listed = (
        frequency_response(model, laws, [0.12, 0.14, 0.16], harmonics, progress=False)
        for harmonics in (5, (0, 1, 2, 3, 4, 5))
    )
    assert {s.unknowns for s in short.solutions} == {6} and {s.unknowns for s in listed.solutions} == {11}
    assert {s.left_out for s in short.solutions} == {(0, 2, 4)}
    (accurate,) = frequency_response(model, laws, [0.12], accuracy=0.05, progress=False).solutions
    assert accurate.left_out == tuple(h for h in accurate.orders if h % 2 == 0) and accurate.why_left_out
    np.testing.assert_allclose(short.output("tip"), listed.output("tip"), rtol=1e-7, atol=1e-12)
