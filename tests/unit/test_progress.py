"""What the bar says of runs whose steps take long."""

from __future__ import annotations

import logging

from mpi4py import MPI
from rich import console
from small_models import lift_off_oscillator

from ewr_fenicsx import ContactLaws, ContactProblem, integrate
from ewr_fenicsx.cli import show_progress
from ewr_fenicsx.display import share_display
from ewr_fenicsx.progress import count_progress


def test_steps_of_minutes_have_a_remaining_time(monkeypatch, capsys):
    """What was done when the bar began, as by a run that was interrupted, is not taken for speed."""
    now = 0.0
    monkeypatch.setattr(console, "monotonic", lambda: now)
    with count_progress("frequency response", 12, True) as report:
        for now, done in enumerate((6, 7, 8, 9)):
            now *= 100.0
            report(done)
    assert "9/12 left 0:05:00" in capsys.readouterr().err


def test_periods_of_time_stepping_are_counted_where_asked(capsys):
    problem = ContactProblem(lift_off_oscillator(), ContactLaws(), 0.2)
    quiet = integrate(problem, "rest", periods=3, tolerance=0)
    assert capsys.readouterr().err == ""
    shown = integrate(problem, "rest", periods=3, tolerance=0, progress=True)
    told = capsys.readouterr().err
    assert f"time stepping, periods, change {shown.changes[-1]:.0e}" in told
    assert "3/3" in told
    assert list(quiet.changes) == list(shown.changes)


def test_stages_counts_and_the_log_share_one_display(monkeypatch, capsys, caplog):
    """On a terminal; two displays would write over each other, and so would what is logged."""
    monkeypatch.setenv("FORCE_COLOR", "1")
    monkeypatch.setenv("TERM", "xterm")
    monkeypatch.setenv("COLUMNS", "80")
    log = logging.getLogger("ewr_fenicsx.solver.newton")
    with show_progress(MPI.COMM_SELF) as progress:
        progress("solve", None)
        log.info("100 Hz: cold start: [stalled]; next: time stepping")
        with share_display() as display:
            assert [task.fields["note"][:29] for task in display.tasks] == ["100 Hz: cold start: [stalled]"]
        progress("solve", 3.0)
        progress("sweep", None)
        with count_progress("frequency response", 12, True) as report:
            report(12)
        progress("sweep", 4.0)
        log.info("said to nobody")
        assert [(task.description, task.fields["note"], task.finished) for task in display.tasks] == [
            ("solve", "", True),
            ("sweep", "", True),
            ("frequency response", "", True),
        ]
    told = capsys.readouterr().err
    assert "12/12" in told and "stalled" not in told.splitlines()[-1] and caplog.records == []
    log.info("of no interest any more")
    assert caplog.records == []
