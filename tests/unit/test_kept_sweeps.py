"""A sweep's work in progress: what is kept on disk and taken up again, damaged, or not to be written."""

from __future__ import annotations

from contextlib import contextmanager
from dataclasses import replace

import numpy as np
import pytest
from counted_calls import count_calls
from mpi4py import MPI
from small_models import lift_off_oscillator, stop_oscillator
from test_frequency_response import FREQUENCIES, LAWS, sweep

from ewr_fenicsx import ContactLaws, frequency_response, solve
from ewr_fenicsx.errors import NotConverged, OutputError
from ewr_fenicsx.response import following, frequency_sweep, response_curve, sweep_store
from ewr_fenicsx.response.following import agree
from ewr_fenicsx.response.solution_store import restore, strip
from ewr_fenicsx.solution import solution as solutions


def test_stability_that_was_looked_at_is_not_looked_at_again(tmp_path, monkeypatch):
    """Where that was interrupted; quick points are not worth a file, and another curve is another matter."""
    whole = sweep()
    with monkeypatch.context() as patch, pytest.raises(KeyboardInterrupt):
        patch.setattr(response_curve, "WORTH_A_POINT", 0.0)
        count_calls(patch, solutions, "find_growth", 4)
        whole.look_at_stability(MPI.COMM_SELF, work=tmp_path)
    monkeypatch.setattr(response_curve, "WORTH_A_POINT", np.inf)
    calls = count_calls(monkeypatch, solutions, "find_growth")
    curve = sweep()
    curve.look_at_stability(MPI.COMM_SELF, work=tmp_path)
    assert len(calls) == len(curve.solutions) - 4
    np.testing.assert_array_equal(curve.unstable, whole.unstable)
    calls.clear()
    curve = sweep(laws=replace(LAWS, friction=0.31))
    curve.look_at_stability(MPI.COMM_SELF, work=tmp_path)
    assert len(calls) == len(curve.solutions)
    assert len(list((tmp_path / "blocks").iterdir())) == 4, "the others were not worth it"


def test_what_was_found_of_stability_is_what_is_read(tmp_path):
    store = sweep_store.StabilityStore(tmp_path, "this curve")
    for point in (0, 2):
        store.write(point, point == 2)
    assert store.read(4) == {0: False, 2: True}
    assert sweep_store.StabilityStore(tmp_path, "this curve, another").read(4) == {}


def test_an_interrupted_sweep_goes_on_from_what_is_on_disk(tmp_path, monkeypatch):
    whole, solve_block = sweep(), frequency_sweep._solve_block
    with monkeypatch.context() as patch, pytest.raises(KeyboardInterrupt):
        count_calls(patch, frequency_sweep, "_solve_block", 1)
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
    with pytest.raises(OutputError, match="another model, laws, frequencies or settings"):
        sweep(folder=tmp_path, laws=replace(LAWS, friction=0.31))


def test_blocks_of_curves_in_another_order_are_not_taken_for_one_another(tmp_path):
    """They are numbered in that order; the values of the parameter may be of any type."""
    family = {mu: replace(LAWS, friction=mu) for mu in (0.1, 0.3)}
    curves = sweep(laws=family, work=tmp_path)
    with pytest.raises(OutputError, match="another model, laws, frequencies or settings"):
        sweep(laws=dict(reversed(family.items())), work=tmp_path)
    again = sweep(laws={np.float64(mu): laws for mu, laws in family.items()}, work=tmp_path)
    np.testing.assert_array_equal(again[0.3].output("tip"), curves[0.3].output("tip"))


def start_late(problem, **settings):
    """``solve``, that finds nothing at the first two frequencies."""
    found = solve(problem, **settings)
    if problem.frequency < 0.15:
        raise NotConverged("as if", best=found)
    return found


@pytest.mark.parametrize(
    "model, laws, frequencies, refine",
    [
        (stop_oscillator(), ContactLaws(tangential="frictionless", initial_gap=1.0), np.linspace(0.15, 0.19, 5), None),
        (lift_off_oscillator(excitation=0.6, damping=0.1), LAWS, FREQUENCIES, None),
        (lift_off_oscillator(excitation=0.6, damping=0.1), LAWS, FREQUENCIES, 0.3),
    ],
    ids=["folds", "steps between", "refined"],
)
def test_a_block_goes_on_from_the_points_that_it_has(tmp_path, monkeypatch, model, laws, frequencies, refine):
    """Wherever it is interrupted, to the last bit; only the point in progress is solved again."""
    monkeypatch.setattr(frequency_sweep, "BLOCK", 20)
    monkeypatch.setattr(sweep_store, "WORTH", 0.0)
    if laws is LAWS:
        monkeypatch.setattr(frequency_sweep, "solve", start_late)
    run = lambda **given: frequency_response(model, laws, frequencies, 7, False, refine=refine, **given)  # noqa: E731
    with monkeypatch.context() as patch:
        calls = count_calls(patch, following, "solve_from")
        whole = run()
    for n, most in enumerate(range(0, len(calls), max(1, len(calls) // 7))):
        folder, name = tmp_path / str(n), "blocks/000_0000.h5"
        with monkeypatch.context() as patch, pytest.raises(KeyboardInterrupt):
            count_calls(patch, following, "solve_from", most)
            run(work=folder)
        assert (folder / name).exists(), "the cold start is kept in any case"
        with monkeypatch.context() as patch:
            cold, more = count_calls(patch, frequency_sweep, "solve"), count_calls(patch, following, "solve_from")
            curve = run(work=folder)
        assert not cold and len(more) <= len(calls)
        np.testing.assert_array_equal(curve.frequencies, whole.frequencies)
        np.testing.assert_array_equal([s.forces for s in curve.solutions], [s.forces for s in whole.solutions])
        assert [s.iterations for s in curve.solutions] == [s.iterations for s in whole.solutions]
        assert curve.missing == whole.missing and curve.jumps == whole.jumps
    assert len(more) < 0.9 * len(calls), "not much of it where one step is a fold, with hundreds of points"


def test_starts_that_led_nowhere_are_not_tried_again(tmp_path, monkeypatch):
    monkeypatch.setattr(sweep_store, "WORTH", 0.0)
    monkeypatch.setattr(frequency_sweep, "solve", start_late)
    with monkeypatch.context() as patch, pytest.raises(KeyboardInterrupt):
        count_calls(patch, frequency_sweep, "solve", 2)
        sweep(work=tmp_path)
    calls = count_calls(monkeypatch, frequency_sweep, "solve")
    curve = sweep(work=tmp_path)
    assert len(calls) == 2, "the third frequency and the second block"
    np.testing.assert_array_equal(curve.output("tip"), sweep().output("tip"))


def test_points_that_cost_nothing_are_not_written_one_by_one(tmp_path, monkeypatch):
    written, write = [], sweep_store.BlockStore.write
    monkeypatch.setattr(sweep_store, "WORTH", 1000.0)
    monkeypatch.setattr(sweep_store.BlockStore, "write", lambda self, *what: written.append(what) or write(self, *what))
    sweep(FREQUENCIES[:3], work=tmp_path)
    assert [state.passed for _, state in written] == [3]


def test_the_bar_counts_frequencies(tmp_path, monkeypatch):
    """The last one when all is done: until then blocks are joined. A resumed sweep begins where it was."""
    told = []

    @contextmanager
    def record(title, total, shown):
        told.append((title, total))
        yield lambda done=None, note="": told.append(note or done)

    monkeypatch.setattr(frequency_sweep, "count_progress", record)
    sweep(FREQUENCIES[:3])
    assert told == [("frequency response", 3), 0, 1, 2, 2, "joining blocks", 3]
    told.clear()
    with monkeypatch.context() as patch, pytest.raises(KeyboardInterrupt):
        patch.setattr(sweep_store, "WORTH", 0.0)
        count_calls(patch, frequency_sweep, "_solve_block", 1)
        sweep(work=tmp_path)
    assert told == [("frequency response", 9), 0, *range(1, 8), 7]
    told.clear()
    sweep(work=tmp_path)
    assert told == [("frequency response", 9), 7, 7, 8, 8, "joining blocks", 9]


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


def test_records_bring_solutions_back():
    solution = sweep().solutions[3]
    back = restore(solution.problem, strip(solution))
    assert agree(back, solution)
    np.testing.assert_array_equal(back.forces, solution.forces)
    assert (back.reason, back.fallbacks, back.unknowns) == (solution.reason, solution.fallbacks, solution.unknowns)
