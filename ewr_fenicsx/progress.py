"""Progress of long runs on the terminal: how much is done, and how long the rest will take."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager

LOOKS_BACK = 600.0  # seconds from whose speed the rest is estimated: steps that take minutes have one as well
Report = Callable[..., None]  # the amount done so far, or None where that is as before; note: what goes on, or ""


@contextmanager
def count_progress(title: str, total: int, shown: bool) -> Iterator[Report]:
    """A bar on standard error with the time that remains; where that is no terminal, only its last state.

    Args:
        title: What is counted.
        total: How much there is to do.
        shown: Whether to show anything at all.

    Returns:
        A function to call with the amount done so far; ``note``, until the next call, stands beside the title.
    """
    if not shown:
        yield lambda done=None, note="": None
        return
    from rich.console import Console  # only for those who watch
    from rich.progress import (
        BarColumn,
        MofNCompleteColumn,
        Progress,
        TextColumn,
        TimeElapsedColumn,
        TimeRemainingColumn,
    )

    columns = (
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        TimeElapsedColumn(),
        TextColumn("left"),
        TimeRemainingColumn(),
    )
    console = Console(stderr=True, highlight=False)
    with Progress(*columns, console=console, speed_estimate_period=LOOKS_BACK) as display:
        task = display.add_task(title, total=total)
        yield lambda done=None, note="": display.update(
            task, completed=done, description=f"{title}, {note}" if note else title
        )
