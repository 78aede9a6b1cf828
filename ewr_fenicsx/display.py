"""What runs show on a terminal: stages, counts with the time that remains, and what the solver is about.

One display for all of them: two at a time would write over each other.
"""

from __future__ import annotations

import logging
from collections.abc import Iterator
from contextlib import contextmanager

from rich.console import Console
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    ProgressColumn,
    SpinnerColumn,
    Task,
    TaskID,
    TextColumn,
    TimeElapsedColumn,
    TimeRemainingColumn,
)
from rich.table import Column
from rich.text import Text

LOOKS_BACK = 600.0  # seconds from whose speed the rest is estimated: steps that take minutes have one as well
PACKAGE = "ewr_fenicsx"  # whose log is shown

_shown: list[Progress] = []  # the display that is on, if any


class OfCounts(ProgressColumn):
    """A column of lines that count something; stages leave it empty."""

    def __init__(self, column: ProgressColumn):
        self.column = column
        super().__init__()

    def render(self, task: Task) -> Text:
        return self.column(task) if task.fields["counted"] else Text()


@contextmanager
def share_display() -> Iterator[Progress]:
    """The display that is on, or a new one."""
    if _shown:
        yield _shown[0]
        return
    columns = (
        SpinnerColumn(finished_text="✓"),
        TextColumn("{task.description:<12}"),
        TimeElapsedColumn(),
        OfCounts(BarColumn(bar_width=20)),
        OfCounts(MofNCompleteColumn()),
        OfCounts(TextColumn("left")),
        OfCounts(TimeRemainingColumn()),
        TextColumn("{task.fields[note]}", markup=False, table_column=Column(no_wrap=True, overflow="ellipsis")),
    )
    with Progress(*columns, console=Console(stderr=True, highlight=False), speed_estimate_period=LOOKS_BACK) as display:
        _shown.append(display)
        try:
            yield display
        finally:
            _shown.remove(display)


def add_line(display: Progress, title: str, total: int | None = None) -> TaskID:
    """A line of the display; ``total``: what is counted, None for a stage."""
    return display.add_task(title, total=1 if total is None else total, counted=total is not None, note="")


@contextmanager
def note_log(display: Progress) -> Iterator[None]:
    """What the package logs stands beside the last line that is not done, and nowhere else."""
    logger, handler = logging.getLogger(PACKAGE), _Notes(display)
    level, passes_on = logger.level, logger.propagate
    logger.setLevel(logging.INFO)
    logger.propagate = False  # FFCx has the root logger print
    logger.addHandler(handler)
    try:
        yield
    finally:
        logger.removeHandler(handler)
        logger.setLevel(level)
        logger.propagate = passes_on


class _Notes(logging.Handler):
    def __init__(self, display: Progress):
        super().__init__()
        self.display = display

    def emit(self, record: logging.LogRecord) -> None:
        running = [task for task in self.display.tasks if not task.finished]
        if running:
            self.display.update(running[-1].id, note=record.getMessage())
