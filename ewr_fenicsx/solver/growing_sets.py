"""Other sets of harmonics, or of samples: what is found with few starts a solve, or a splitting, with more."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import partial
from itertools import count, takewhile

import numpy as np

from ewr_fenicsx.balance.balance import HarmonicBalance
from ewr_fenicsx.given import ComplexArray, RealArray
from ewr_fenicsx.problem.contact_problem import ContactProblem
from ewr_fenicsx.problem.harmonics import round_up, select_basis
from ewr_fenicsx.solver.splitting import Splitting, come_near, resample

SPLIT_LEVELS = (5, 15, 31)  # highest harmonics of the sets that a splitting goes through
# Samples a period to begin with, at least, and times the highest harmonic: with fewer, solutions are other ones
FEW_SAMPLES, FEW_A_HARMONIC = 16, 3


def grow_sets(balance: HarmonicBalance, levels: tuple[int, ...]) -> Iterator[HarmonicBalance]:
    """The balance with its harmonics up to each of ``levels``, all with the loaded ones, and at last itself."""
    system, orders = balance.system, balance.basis.orders
    lowest = max((h for h, f in system.load.items() if h and np.any(f)), default=1)
    sets = [tuple(h for h in orders if h <= top) for top in levels if lowest <= top and 1.6 * top < orders[-1]]
    for fewer in dict.fromkeys(sets):
        if fewer and fewer != (0,):
            yield HarmonicBalance(system.restrict(fewer), balance.force_unit)
    yield balance


def add_harmonics(problem: ContactProblem, times: int) -> ContactProblem:
    """The problem with harmonics up to so many times the highest one, and dashpots for those left out.

    They are as far apart as its last two; where one is all that symmetry has left, odd.

    Raises:
        ModelError: The problem has none of such harmonics.
    """
    orders = problem.basis.orders
    stride = 1 if isinstance(problem.harmonics, (int, np.integer)) else 2
    if len(orders) > 1 and orders[-2] > 0:
        stride = orders[-1] - orders[-2]
    top = max(times * orders[-1], orders[-1] + stride)
    more = (*orders, *range(orders[-1] + stride, top + 1, stride))
    samples = max(problem.basis.samples, select_basis(more).samples)
    return replace(problem, harmonics=more, samples=samples, closure="dashpot")


def embed(found: tuple[ComplexArray, RealArray], below: HarmonicBalance, level: HarmonicBalance):
    """Forces and rigid coordinates with harmonics added at zero."""
    forces = np.zeros((len(level.basis.orders), level.rows), dtype=complex)
    for j, h in enumerate(below.basis.orders):
        forces[level.basis.orders.index(h)] = found[0][j]
    return forces, found[1]


def choose_samples(balance: HarmonicBalance) -> list[int]:
    """Growing numbers of samples a period, from the few that harmonics need to those of the balance."""
    highest, most = max(balance.basis.orders[-1], balance.system.highest_given), balance.basis.samples
    few = max(FEW_SAMPLES, round_up(FEW_A_HARMONIC * highest))
    return [*takewhile(lambda n: n < most, (few << doublings for doublings in count())), most]


def sample_anew(balance: HarmonicBalance, samples: int) -> HarmonicBalance:
    """The balance, of the same unknowns, with its laws seen at so many samples a period."""
    return HarmonicBalance(balance.system.sample(samples), balance.force_unit)


def come_near_through_sets(balance: HarmonicBalance, begin: Callable[[Splitting], RealArray]) -> Iterator[RealArray]:
    """Unknowns ever nearer a solution, where splittings on ever more harmonics lead that begin as ``begin`` says.

    High harmonics drive bodies far above their modes, where a splitting may not end: what was found with fewer then is
    the only one.
    """
    start = None
    for level in grow_sets(balance, SPLIT_LEVELS):
        looks = come_near(level, begin)
        if (found := next(looks, None)) is None:
            break
        state, unknowns = found
        begin, start = partial(resample, state), embed(level.unpack(unknowns), level, balance)
    if start is not None:
        yield balance.pack(*start)
        if level is balance:
            yield from (unknowns for _, unknowns in looks)
