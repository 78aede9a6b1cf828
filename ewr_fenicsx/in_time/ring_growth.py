"""Whether motions of a ring of sectors leave the wave in which all move alike, one after the other.

A deviation may travel round as a wave of its own: one that grows by ``exp(s t)``, its part at harmonic h in wave
``h E + k``, k any number of nodal diameters. Every sector then sees the laws' derivatives as late as its motion comes,
and each k has a Hill's matrix of its own (``hill.py``), of one sector, with the modes of these waves. Together they
have the exponents of the whole ring; those of -k are the conjugate ones.

No motion of one sector in time tells where to look, so that it is looked around some points of the imaginary axis; nor
is growth borne out by one: truncated, pairs that lift off may call a wave unstable that motions in time hardly leave.
``integrate`` on the whole ring decides.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ewr_fenicsx.balance.periodic_motion import PeriodicMotion
from ewr_fenicsx.in_time.deviations import Slopes, differentiate_laws
from ewr_fenicsx.in_time.floquet import FEWEST, GROWTH, SAMPLES, find_fastest
from ewr_fenicsx.in_time.followed_modes import Followed, follow_waves
from ewr_fenicsx.in_time.hill import FOLLOWS, Hill, measure_edges
from ewr_fenicsx.problem.contact_system import ContactSystem

MOST_WORK = 2.5e10  # multiplications: some seconds
# Of these, over the cube of its size, a matrix's eigenvectors, and a complex inverse; and at each point, at least.
EIGENVECTORS, INVERSE, EACH = 10, 4, 3e7
# Points of the imaginary axis, over the frequency, around which exponents are looked for, how far beside it, and how
# many at each: exponents and waves repeat with the frequency.
ALONG, BESIDE, FEW = (-0.375, -0.125, 0.125, 0.375), 0.01, 6
EDGE = 0.1  # share of a deviation at the outermost harmonics, from which on it is cut off there


class RingGrowth(NamedTuple):
    """The deviation of a ring that grows most: by how much over a period, and its nodal diameters."""

    factor: float
    diameters: int


def find_ring_growth(motion: PeriodicMotion) -> RingGrowth | None:
    """The deviation from a wave round a ring of sectors that grows most, or falls least; of a sector's solution.

    Returns:
        None where it is not looked at: it takes long, a law remembers, the stiffness is not positive, or redundant
        pairs share their forces in any way; and where all that is found is cut off at the highest harmonics.
    """
    system = motion.problem.system
    if not len(system.rows):
        return _find_linear_growth(system)
    slopes = differentiate_laws(motion, max(system.basis.samples, SAMPLES))
    if slopes is None:
        return None
    if not slopes.changing.size:
        slopes = slopes.treat_all_as_changing()
    top, sectors = max(system.basis.orders[-1], FEWEST), system.model.cyclic.sectors
    offsets = range(sectors // 2 + 1)
    points = len(offsets) * len(ALONG)
    work = points * (EACH + ((2 * top + 1) * slopes.changing.size) ** 3)
    work += EIGENVECTORS * sectors * system.model.size**3
    if work > MOST_WORK:
        return None
    try:
        modes = follow_waves(system, FOLLOWS * top * system.compliance.omega, range(sectors))
        if work + INVERSE * points * (2 * top + 1) * modes.count**3 > MOST_WORK:
            return None
        found = [growth for offset in offsets for growth in _look_along(system, slopes, modes, top, offset)]
    except np.linalg.LinAlgError:
        return None
    return max(found, default=None)


def _find_linear_growth(system: ContactSystem) -> RingGrowth | None:
    """The same of a joint without unknown forces, by the free vibrations of each wave."""
    omega, sectors = system.compliance.omega, system.model.cyclic.sectors
    if EIGENVECTORS * sectors * system.model.size**3 > MOST_WORK:
        return None
    diameters = range(sectors // 2 + 1)
    try:
        modes = follow_waves(system, FOLLOWS * system.basis.orders[-1] * omega, diameters)
    except np.linalg.LinAlgError:
        return None
    exponents = [find_fastest(modes.pick(k), omega) for k in diameters]
    return max(RingGrowth(float(np.exp(2 * np.pi * exponents[k].real)), k) for k in diameters)


def leaves(growth: RingGrowth | None) -> bool:
    """Whether a deviation grows by more than truncation errs."""
    return growth is not None and growth.factor > GROWTH


def _look_along(system: ContactSystem, slopes: Slopes, modes: Followed, top: int, offset: int) -> list[RingGrowth]:
    """What is found around points of the imaginary axis, of deviations in waves that are ``offset`` from the motion's.

    Args:
        system: What was solved.
        slopes: The laws' derivatives.
        modes: The modes that follow, in all waves.
        top: Highest harmonic.
        offset: k.
    """
    ring, omega = system.model.cyclic, system.compliance.omega
    waves = (np.arange(-top, top + 1) * ring.engine_order + offset) % ring.sectors
    here, found = modes.pick(waves), []
    for place in ALONG:
        exponents, motions = Hill(system, slopes, (BESIDE + 1j * place) * omega, top, here).find_nearest(FEW)
        whole = measure_edges(motions) < EDGE
        for exponent, motion in zip(exponents[whole], motions[whole], strict=True):
            factor = float(np.exp(2 * np.pi * exponent.real / omega))
            wave = waves[np.argmax(np.sum(np.abs(motion) ** 2, axis=1))]
            found.append(RingGrowth(factor, ring.count_diameters(int(wave))))
    return found
