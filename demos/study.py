"""What the demos of the paper's studies share: how they compare with the paper, and where they leave their results."""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np

RESULTS = Path(__file__).parent / "results"
AGREES, DIFFERS, OPEN = "agrees", "differs", "can't be told"


@dataclass(frozen=True)
class Verdict:
    """A statement of the paper, how our fir tree compares with it, and what says so.

    Attributes:
        statement: What the paper says.
        verdict: ``AGREES``, ``DIFFERS`` or ``OPEN``.
        because: Our figures, and why they differ where they do.
    """

    statement: str
    verdict: str
    because: str


def judge(statement: str, holds: bool | None, because: str) -> Verdict:
    """A verdict from what was found: the statement holds, does not, or cannot be told (None)."""
    return Verdict(statement, OPEN if holds is None else AGREES if holds else DIFFERS, because)


@contextmanager
def timed(figures: dict) -> Iterator[None]:
    """Notes the wall time of a block as ``figures["seconds"]``."""
    begin = time.perf_counter()
    yield
    figures["seconds"] = round(time.perf_counter() - begin, 1)


def report(name: str, figures: dict, verdicts: Sequence[Verdict], draw: Callable[[Path], None], folder: Path) -> None:
    """Prints figures and verdicts and writes them, with the picture, to ``folder``."""
    folder.mkdir(parents=True, exist_ok=True)
    draw(folder / f"{name}.png")
    content = {"figures": figures, "verdicts": [asdict(v) for v in verdicts]}
    (folder / f"{name}.json").write_text(json.dumps(content, indent=1, default=_plain) + "\n", encoding="utf-8")
    for key, value in figures.items():
        print(f"{key}: {value}")
    for v in verdicts:
        print(f"\n[{v.verdict}] {v.statement}\n    {v.because}")
    print(f"\nwrote {folder / name}.png and .json")


def _plain(value: object) -> object:
    if isinstance(value, np.generic | np.ndarray):
        return value.tolist()
    raise TypeError(f"{type(value).__name__} cannot be written as JSON")
