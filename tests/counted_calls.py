"""Calls of a function that are counted, and interrupted where there have been enough."""

from __future__ import annotations

import pytest


def count_calls(patch: pytest.MonkeyPatch, owner: object, name: str, most: int = 10**6) -> list[str]:
    """Stands in for a function of a module or a class.

    Args:
        patch: Puts the function back.
        owner: Of the function.
        name: Of the function.
        most: Calls that are let through; the one beyond them is where Ctrl-C comes.

    Returns:
        A list that grows by the name with every call.
    """
    calls, work = [], getattr(owner, name)

    def count(*given, **named):
        if len(calls) == most:
            raise KeyboardInterrupt
        calls.append(name)
        return work(*given, **named)

    patch.setattr(owner, name, count)
    return calls
