"""``frequency_response``: what it returns and writes, and what it refuses."""

from __future__ import annotations

import csv
from contextlib import contextmanager
from dataclasses import replace
from itertools import pairwise
from types import SimpleNamespace

import h5py
import numpy as np
import pytest
from small_models import friction_oscillator, lift_off_oscillator, stop_oscillator

from ewr_fenicsx import ContactLaws, ContactProblem, frequency_response, solve
from ewr_fenicsx.errors import ModelError, OutputError
from ewr_fenicsx.response import following, frequency_sweep, response_curve
from ewr_fenicsx.response.following import Jump
from ewr_fenicsx.response.response_curve import FrequencyResponse

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


def test_adaptive_frequencies_resolve_the_resonance_of_a_linear_joint_too():
    """No contact's state changes there: no point was inserted, and a peak between two points was missed."""
    model = friction_oscillator(damping=0.01)
    laws = ContactLaws("prescribed", "frictionless", normal_force=1.0)
    curve = frequency_response(model, laws, [0.1, 0.2, 0.3], refine=0.1, progress=False)
    assert np.abs(curve.output("tip")[:, 1]).max() == pytest.approx(100.0, rel=2e-3)
    undamped = frequency_response(replace(model, damping=[[0.0]]), laws, [0.1, 0.2], refine=0.1, progress=False)
    assert np.abs(undamped.output("tip")[:, 1]).max() > 1e4
    assert len(undamped.solutions) < 500


@pytest.mark.parametrize(
    "gap, frequencies, harmonics, refine",
    [
        (0.5, np.linspace(0.1, 0.25, 6), 9, 0.2),
        (0.5, np.linspace(0.1, 0.25, 6), 9, 0.05),
        (1.0, [0.163, 0.173], 3, 0.005),
    ],
)
def test_neighbours_on_a_refined_curve_are_as_near_as_asked_beyond_its_folds_too(gap, frequencies, harmonics, refine):
    """Those found by arc length were not looked at: changes were up to five times as large."""
    laws = ContactLaws(tangential="frictionless", initial_gap=gap)
    curve = frequency_response(stop_oscillator(), laws, frequencies, harmonics, progress=False, refine=refine)
    assert not curve.jumps and not curve.missing
    assert np.diff(curve.frequencies).min() < 0 < np.diff(curve.frequencies)[-1], "it folds, and comes back"
    states = [following.read_state(s) for s in curve.solutions]
    changes = [following.compare_states(*pair) for pair in pairwise(states)]
    assert max(changes) <= refine * (1 + 1e-9)
    assert np.mean(changes) > 0.4 * refine, "and no more points than that takes"


def test_a_sharp_peak_that_is_traced_is_refined_as_well():
    """It is so narrow that steps of a ten thousandth of the range were too long."""
    laws = ContactLaws("prescribed", normal_force=0.01, friction=0.5)
    peaked, points = friction_oscillator(damping=1e-4), np.linspace(0.12, 0.2, 5)
    curve = frequency_response(peaked, laws, points, 3, progress=False, refine=0.03)
    changes = [following.compare_states(*map(following.read_state, pair)) for pair in pairwise(curve.solutions)]
    assert max(changes) <= 0.03 * (1 + 1e-9)


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


def test_a_table_is_the_same_to_the_last_bit_however_often_it_is_made():
    """Sizes of strided amplitudes went, now and then, by what lay behind them in memory: files differed."""
    curve = frequency_response(lift_off_oscillator(), LAWS, np.linspace(0.1, 0.35, 26), 9, progress=False)
    assert all(of_harmonic.flags.c_contiguous for of_harmonic in curve.output("tip").T)
    first, elsewhere, differ = curve.table(), [], set()
    for k in range(100):
        elsewhere.append(np.zeros(37 * k + 1, dtype=np.int8))
        differ |= {name for name, values in curve.table().items() if not np.array_equal(values, first[name])}
    assert differ == set()


def test_a_table_leaves_out_figures_that_no_law_concerns():
    figures = {"penetration", "tension", "J_N", "J_T", "friction_dissipation", "cone_violation"}
    assert figures <= set(sweep().table())
    held = sweep(laws=ContactLaws("bonded", "bonded")).table()
    assert not figures & set(held) and "rms_tip" in held
    pressed = sweep(laws=ContactLaws("prescribed", normal_force=100.0, friction=0.3)).table()
    assert figures & set(pressed) == {"J_T", "friction_dissipation", "cone_violation"}


def test_stability_is_looked_at_with_a_bar_before_anything_is_written(tmp_path, monkeypatch):
    """Tables hold it; rank 0, which writes them, would do it by itself while all others wait."""
    shown = []

    @contextmanager
    def record(title, total, shown_at_all):
        shown.append((title, total, shown_at_all, (tmp_path / "frequency_response.h5").exists()))
        yield lambda done=None, note="": None

    monkeypatch.setattr(response_curve, "count_progress", record)
    family = {mu: replace(LAWS, friction=mu) for mu in (0.1, 0.3)}
    model = lift_off_oscillator(excitation=0.6, damping=0.1)
    curves = frequency_response(model, family, FREQUENCIES, folder=tmp_path)
    assert shown == [("stability", 9, True, False)] * 2
    assert all("unstable" in vars(curve) for curve in curves.values())
    sweep(work=tmp_path / "work")
    assert len(shown) == 2, "nothing is written that would hold it"
    assert [path.name for path in (tmp_path / "work").iterdir()] == ["blocks"]


def test_a_folder_is_made_and_a_table_names_one_that_is_not_there(tmp_path):
    curve = sweep(FREQUENCIES[:2], folder=tmp_path / "below" / "it")
    assert (tmp_path / "below" / "it" / "frequency_response.h5").exists()
    with pytest.raises(OutputError, match=r"nowhere/curve.csv cannot be written: No such file or directory; give"):
        curve.write_csv(tmp_path / "nowhere" / "curve.csv")


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
        ({"settings": {}}, "settings: no argument of frequency_response"),
        ({"laws": []}, "laws must cover each of the 1 pairs once; they leave out pair 0"),
    ],
)
def test_what_makes_no_sweep_is_refused_before_any_solve(arguments, message, monkeypatch):
    monkeypatch.setattr(frequency_sweep, "_solve_block", lambda *_: pytest.fail("solved"))
    with pytest.raises(ModelError, match=message):
        sweep(**arguments)


def test_a_sweep_across_a_mode_without_damping_keeps_what_it_finds():
    """A trial of the continuation hit the mode exactly, and the sweep ended with an error."""
    rubs = ContactLaws("prescribed", normal_force=1.0, friction=0.4)
    frequencies = [0.14, 0.15, 1 / (2 * np.pi), 0.17]
    curve = frequency_response(friction_oscillator(damping=0.0), rubs, frequencies, 5, False)
    assert not curve.missing and {0.14, 0.15, 0.17} < set(curve.frequencies)
    assert [jump.frequency[1] for jump in curve.jumps] == [1 / (2 * np.pi)]


def test_a_curve_without_a_solution_says_so():
    curve = FrequencyResponse((), (), (20.0, 21.0))
    for ask in (lambda: curve.figure("rms_tip"), lambda: curve.output("tip")):
        with pytest.raises(ModelError, match="no solution was found from 20 to 21 Hz: solve"):
            ask()
    assert [len(column) for column in curve.table().values()] == [0] * 4


def test_breaks_of_a_curve_are_where_its_jumps_are():
    """Between the points that a jump names, or the first one beyond; each jump once, also where a curve runs back."""
    points = [SimpleNamespace(problem=SimpleNamespace(frequency=f)) for f in (1.0, 2.0, 3.0, 2.5, 2.0, 3.0, 5.0)]
    breaks = lambda *ends: FrequencyResponse(tuple(points), tuple(Jump(e, "") for e in ends), ()).breaks  # noqa: E731
    assert breaks() == ()
    assert breaks((2.0, 3.0)) == (1,) and breaks((2.0, 3.0), (2.0, 3.0)) == (1, 4)
    assert breaks((3.0, 2.5)) == (2,) and breaks((3.0, 4.0)) == (5,)
    assert breaks((3.7, 5.0)) == (5,), "from a point between given frequencies, which is not kept"


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
