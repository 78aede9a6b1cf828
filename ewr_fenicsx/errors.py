"""Everything the package raises on purpose.

Each message names the thing, its value, what was expected and what to do. The command line prints it alone,
without a traceback, and exits with ``exit_code``.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from difflib import get_close_matches
from pathlib import Path
from traceback import walk_tb

FEW = 5  # values that are listed one by one


class EwrError(Exception):
    """Base of all errors that a user can mend."""

    exit_code = 2


class SceneError(EwrError):
    """A scene file or one of its values makes no sense."""


class SceneWarning(UserWarning):
    """A scene that can be solved, but that was probably not meant so."""


class MeshError(EwrError):
    """A geometry builder or mesh file does not give what the scene asks of it."""


class InterfaceError(EwrError):
    """The two sides of a flank cannot be paired node to node."""


class ModesError(EwrError):
    """An eigenvalue solve did not deliver the modes asked for, or not accurately."""


class ModelError(EwrError, ValueError):
    """A reduced model, a law or a problem is inconsistent: shapes, signs, symmetry, missing rows."""


class UnknownSignal(ModelError, KeyError):
    """A law asks for what it cannot see at its pairs."""

    __str__ = Exception.__str__  # a KeyError's is quoted


class UnheldBody(EwrError):
    """A floating body that contact cannot hold under the static load.

    Attributes:
        pairs: Numbers of the pairs that open most when it moves, as far as they are known.
    """

    def __init__(self, message: str, pairs: Iterable[int] = ()):
        super().__init__(message)
        self.pairs = tuple(pairs)


class OutputError(EwrError):
    """Results cannot be written where they were asked for."""


class UnwritableFile(OutputError):
    """The system refuses to write a file, as on a full disk."""


class OptionError(EwrError):
    """PETSc refuses an option that it was given."""


class NotConverged(EwrError):
    """The contact solve found no periodic solution.

    Attributes:
        best: The ``PeriodicSolution`` with the smallest residual met on the way; its ``reason`` and
            ``fallbacks`` say what was tried.
    """

    exit_code = 3

    def __init__(self, message: str, best=None):
        super().__init__(message)
        self.best = best


def nearest(name: str, known: Iterable[str]) -> str:
    """A hint at the known name closest to an unknown one, e.g. ``'; did you mean "friction"?'``, or ``''``."""
    in_small = {str(k).lower(): k for k in known}  # "CLAMP" is meant by "clamp", and not "lap"
    found = get_close_matches(str(name).lower(), in_small, n=1, cutoff=0.5)
    return f'; did you mean "{in_small[found[0]]}"?' if found else ""


def tell_mistake(file: Path, error: BaseException) -> str:
    """What a user's Python file raised, and from which of its lines."""
    lines = [line for frame, line in walk_tb(error.__traceback__) if frame.f_code.co_filename == str(file.absolute())]
    return f"{type(error).__name__}: {error}" + (f" (line {lines[-1]})" if lines else "")


def name_pairs(pairs: Sequence[float]) -> str:
    """Pairs by their numbers, the first three of them: ``"pairs 0, 1, 2 and 5 more"``."""
    few, more = ", ".join(f"{pair:g}" for pair in pairs[:3]), len(pairs) - 3
    return f"pair{'s' * (len(pairs) > 1)} {few}" + (f" and {more} more" if more > 0 else "")


def list_few(values: Sequence[float], what: str) -> str:
    """Values in ascending order; of many, how many there are and between which."""
    if len(values) > FEW:
        return f"{len(values)} {what} from {min(values):g} to {max(values):g}"
    return ", ".join(f"{value:g}" for value in sorted(values))
