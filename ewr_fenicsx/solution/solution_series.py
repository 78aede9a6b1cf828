"""Periodic solutions in a row, and what is read off all of them."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property

import numpy as np

from ewr_fenicsx.errors import ModelError, nearest
from ewr_fenicsx.given import ComplexArray, RealArray
from ewr_fenicsx.solution.solution import PeriodicSolution


class SolutionSeries:
    """Periodic solutions in a row, ``n`` of them: along a curve, or over cycles."""

    solutions: Sequence[PeriodicSolution]

    @cached_property
    def orders(self) -> tuple[int, ...]:
        """Harmonics that any of the solutions has, ``n_h`` of them."""
        return tuple(sorted({h for s in self.solutions for h in s.orders}))

    def output(self, name: str) -> ComplexArray:
        """One-sided complex amplitudes ``(n, n_h)`` of a named output at ``orders``; zero where a solution has none.

        Raises:
            ModelError: The model has no such output, or there is no solution.
        """
        self._check_solved()
        # each harmonic in one piece: of strided numbers the size may differ in the last bit from one call to the next
        amplitudes = np.zeros((len(self.solutions), len(self.orders)), dtype=complex, order="F")
        for i, s in enumerate(self.solutions):
            amplitudes[i, np.searchsorted(self.orders, s.orders)] = s.output(name)
        return amplitudes

    def figure(self, name: str) -> RealArray:
        """``(n,)`` a figure of merit of every solution, such as ``"J_T"``, ``"J_N"`` or ``"rms_tip"``.

        Raises:
            ModelError: There is no such figure, or no solution.
        """
        self._check_solved()
        known = self.solutions[0].merit
        if name not in known:
            raise ModelError(f'no figure "{name}"; there are {", ".join(known)}{nearest(name, known)}')
        return np.array([s.merit[name] for s in self.solutions])

    def _check_solved(self) -> None:
        """Refuses a series without a solution, where there may be such."""
