"""What the bar says of runs whose steps take long."""

from __future__ import annotations

from rich import console
from small_models import lift_off_oscillator

from ewr_fenicsx import ContactLaws, ContactProblem, integrate
from ewr_fenicsx.progress import count_progress


def test_steps_of_minutes_have_a_remaining_time(monkeypatch, capsys):
    """What was done when the bar began, as by a run that was interrupted, is not taken for speed."""
    now = 0.0
    monkeypatch.setattr(console, "monotonic", lambda: now)
    with count_progress("frequency response", 12, True) as report:
        for now, done in enumerate((6, 7, 8, 9)):
            now *= 100.0
            report(done)
    assert "9/12 0:05:00 left 0:05:00" in capsys.readouterr().err


def test_periods_of_time_stepping_are_counted_where_asked(capsys):
    problem = ContactProblem(lift_off_oscillator(), ContactLaws(), 0.2)
    quiet = integrate(problem, "rest", periods=3, tolerance=0)
    assert capsys.readouterr().err == ""
    shown = integrate(problem, "rest", periods=3, tolerance=0, progress=True)
    told = capsys.readouterr().err
    assert f"time stepping, periods, change {shown.changes[-1]:.0e}" in told
    assert "3/3" in told
    assert list(quiet.changes) == list(shown.changes)
