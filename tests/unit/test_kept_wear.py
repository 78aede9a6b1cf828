"""Files of wear: what is kept as it is found, how a run goes on from it, and what is told where it cannot."""

from __future__ import annotations

from contextlib import contextmanager
from dataclasses import replace

import numpy as np
import pytest
from counted_calls import count_calls
from small_models import dovetail

from ewr_fenicsx import ContactLaws, ContactProblem, Tolerance, evolve_wear
from ewr_fenicsx.errors import OutputError
from ewr_fenicsx.wear import cycle_jumps, wear

WEAR = 1e-10


def pose() -> ContactProblem:
    return ContactProblem(dovetail(excitation=200.0), ContactLaws(friction=0.2), 600.0, harmonics=5)


@pytest.mark.parametrize("keep", [0, 20, 3000], ids=["empty", "cut in its header", "cut"])
def test_a_damaged_file_of_wear_is_named(tmp_path, keep):
    run = lambda: evolve_wear(pose(), 2, WEAR, file=tmp_path / "wear.h5")  # noqa: E731
    run()
    whole = (tmp_path / "wear.h5").read_bytes()
    (tmp_path / "wear.h5").write_bytes(whole[:keep])
    with pytest.raises(
        OutputError, match=r"wear.h5 cannot be read: .*; give another place, or remove it to begin anew"
    ):
        run()


@pytest.mark.parametrize(
    "place, message",
    [
        ("taken/below/wear.h5", "taken/below/wear.h5 cannot be written: Not a directory; give a place"),
        (".", "cannot be written: it is a folder; give a place where files can be"),
        ("/proc/wear.h5", "/proc/wear.h5 cannot be written: .*; give a place where files can be"),
    ],
)
def test_a_file_that_cannot_be_written_is_refused_before_any_solve(place, message, tmp_path, monkeypatch):
    (tmp_path / "taken").write_text("a file")
    monkeypatch.setattr(cycle_jumps, "solve", lambda *_, **__: pytest.fail("solved"))
    with pytest.raises(OutputError, match=message):
        evolve_wear(pose(), 2, WEAR, file=tmp_path / place)


def test_a_file_is_gone_on_with_whatever_the_types_of_its_numbers(tmp_path, monkeypatch):
    """It was said to hold another calculation."""
    first = evolve_wear(pose(), 2, WEAR, Tolerance(first=2), file=tmp_path / "wear.h5")
    monkeypatch.setattr(wear, "check_place", lambda _: pytest.fail("not finished"))
    same = replace(pose(), frequency=np.int64(600), harmonics=np.int64(5))
    jump, tolerance = Tolerance(share=np.float64(0.01), first=np.int64(2)), np.float64(1e-8)
    again = evolve_wear(same, np.int64(2), np.float64(WEAR), jump, file=tmp_path / "wear.h5", tolerance=tolerance)
    np.testing.assert_array_equal(again.depth, first.depth)


def test_a_finished_file_is_read_where_nothing_can_be_written(tmp_path, monkeypatch):
    run = lambda: evolve_wear(pose(), 2, WEAR, file=tmp_path / "wear.h5")  # noqa: E731
    first = run()
    monkeypatch.setattr(wear, "check_place", lambda _: pytest.fail("asked for a place to write"))
    np.testing.assert_array_equal(run().depth, first.depth)


@pytest.mark.parametrize("worth, versions", [(0.0, 5), (1e9, 1)])
def test_slow_solves_are_kept_as_they_are_found(worth, versions, tmp_path, monkeypatch):
    """A hundred of them, as of long jumps, may take hours: a run that was killed had lost all."""
    written = []
    write = wear.WearFile.write
    monkeypatch.setattr(wear.WearFile, "write", lambda *given: written.append(write(*given)))
    monkeypatch.setattr(wear, "WORTH", worth)
    problem = ContactProblem(dovetail(excitation=200.0), ContactLaws(friction=0.2), 600.0)
    evolve_wear(problem, 5, 1e-10, file=tmp_path / "wear.h5", progress=False)
    assert len(written) == versions


def test_the_first_solution_outlives_an_interruption_of_the_first_step(tmp_path, monkeypatch):
    """With an accuracy it is by far the longest of all, and was lost."""
    run = lambda: evolve_wear(pose(), 2, WEAR, file=tmp_path / "wear.h5", progress=False)  # noqa: E731
    with monkeypatch.context() as patch, pytest.raises(KeyboardInterrupt):
        count_calls(patch, cycle_jumps.WearRun, "advance", 0)
        run()
    monkeypatch.setattr(cycle_jumps.WearRun, "begin", lambda _: pytest.fail("began anew"))
    assert run().cycles.tolist() == [0, 1, 2]


def test_a_resumed_run_shows_at_once_what_is_done(tmp_path, monkeypatch):
    """The next cycle may take long; until then the bar stood at 0."""
    told, follow = [], cycle_jumps.solve_from

    @contextmanager
    def record(title, total, shown):
        yield told.append

    def interrupt(problem, *start):
        if len(told) == 4:
            raise KeyboardInterrupt
        return follow(problem, *start)

    run = lambda: evolve_wear(pose(), 5, WEAR, file=tmp_path / "wear.h5", progress=True)  # noqa: E731
    monkeypatch.setattr(wear, "count_progress", record)
    with monkeypatch.context() as patch, pytest.raises(KeyboardInterrupt):
        patch.setattr(cycle_jumps, "solve_from", interrupt)
        run()
    assert told == [0, 1, 2, 3]
    told.clear()
    run()
    assert told == [3, 4, 5]
