"""What the bar says of runs whose steps take long."""

from __future__ import annotations

from rich import console

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
