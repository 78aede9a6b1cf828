"""Tables of the pages that are written from results."""

from __future__ import annotations

from collections.abc import Sequence


def show(value: object, digits: int = 3) -> str:
    """A cell; empty where there is no value."""
    if isinstance(value, float):
        return "" if value != value else f"{value:.{digits}g}"
    return "" if value is None else str(value)


def percent(value: float | None) -> str | None:
    """A relative error as people read it."""
    return None if value is None else f"{100 * value:.2g} %"


def write_table(header: Sequence[str], rows: Sequence[Sequence[object]], digits: int = 3) -> str:
    """A Markdown table."""
    lines = ["| " + " | ".join(header) + " |", "|" + "---|" * len(header)]
    return "\n".join(lines + ["| " + " | ".join(show(cell, digits) for cell in row) + " |" for row in rows])
