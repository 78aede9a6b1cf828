"""Progress of long runs on the terminal: how much is done, and how long the rest will take."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager

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
    from ewr_fenicsx.display import add_line, share_display  # only for those who watch

    with share_display() as display:
        line = add_line(display, title, total)
        yield lambda done=None, note="": display.update(
            line, completed=done, description=f"{title}, {note}" if note else title
        )
