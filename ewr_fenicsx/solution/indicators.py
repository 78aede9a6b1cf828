"""What is read off a periodic solution: sliding, separation, energies, and how far truncation violates the laws."""

from __future__ import annotations

import numpy as np

from ewr_fenicsx.given import ComplexArray, RealArray


def measure_sliding(speed: RealArray, period: float) -> RealArray:
    """Distance slid a cycle at each pair, ``(K,)`` [m], from speeds ``(n_t, K)`` [m/s].

    Their mean over pairs is the paper's J_T (Eq. 17).
    """
    return period * np.mean(speed, axis=0)


def measure_separation(gap: RealArray) -> RealArray:
    """Mean gap over a cycle at each pair, ``(K,)`` [m], from gaps ``(n_t, K)``.

    Their mean over pairs is the paper's J_N (Eq. 18).
    """
    return np.mean(gap, axis=0)


def measure_rms(amplitudes: ComplexArray, orders: tuple[int, ...]) -> float:
    """Root mean square of the oscillating part of a signal with one-sided amplitudes ``(n_h,)``."""
    oscillating = np.array(orders) > 0
    return float(np.sqrt(0.5 * np.sum(np.abs(amplitudes[oscillating]) ** 2)))


def measure_work(force: ComplexArray, motion: ComplexArray, orders: tuple[int, ...]) -> float:
    """Work over a period of forces on motions, both ``(n_h, n)`` amplitudes [J]."""
    return float(np.pi * np.sum(np.array(orders)[:, None] * np.real(np.conj(force) * 1j * motion)))


def measure_cone_violation(friction_force: RealArray, normal_force: RealArray, friction: RealArray) -> float:
    """How far the friction force leaves the cone, over the largest limit; forces ``(n_t, K)``, friction ``(K,)``.

    With two tangents the friction force is the size of both components.
    """
    limit = friction * np.maximum(0.0, normal_force)
    largest = limit.max(initial=0.0)
    return float((np.abs(friction_force) - limit).max(initial=0.0) / largest) if largest > 0 else 0.0
