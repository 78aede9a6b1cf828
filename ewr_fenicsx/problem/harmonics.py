"""Fourier basis: from one-sided complex amplitudes to samples over a period and back, and products of signals."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import scipy.fft

from ewr_fenicsx.errors import ModelError
from ewr_fenicsx.given import ComplexArray, RealArray, is_whole

HIGHEST = 10_000  # harmonic up to which all may be asked for: its transform alone takes more memory than there is


@dataclass(frozen=True)
class FourierBasis:
    """The harmonics kept, and the samples a period at which the contact laws are evaluated.

    Amplitude arrays are ``(n_h, ...)`` complex, one row a harmonic. Coefficient arrays are the same in real numbers,
    ``(n_c, ...)``: for each harmonic its real part, then, from harmonic 1 on, its imaginary part.

    Args:
        orders: Harmonics kept, ascending.
        samples: Samples a period, more than twice the highest harmonic.
    """

    orders: tuple[int, ...]
    samples: int

    @property
    def coefficients(self) -> int:
        """Real coefficients an unknown, ``n_c``."""
        return sum(1 if h == 0 else 2 for h in self.orders)

    @cached_property
    def has_mean(self) -> bool:
        """Whether harmonic 0 is kept; it then comes first."""
        return self.orders[0] == 0

    @cached_property
    def slot(self) -> np.ndarray:
        """``(n_c,)`` index of the harmonic that each real coefficient belongs to."""
        return np.repeat(np.arange(len(self.orders)), [1 if h == 0 else 2 for h in self.orders])

    @cached_property
    def is_real_part(self) -> np.ndarray:
        """``(n_c,)`` True where the coefficient is a real part."""
        return np.concatenate([[True] if h == 0 else [True, False] for h in self.orders])

    @cached_property
    def synthesis(self) -> RealArray:
        """``(n_t, n_c)`` samples of a signal by its coefficients."""
        phase = 2 * np.pi * np.outer(np.arange(self.samples), self.orders) / self.samples
        return np.where(self.is_real_part, np.cos(phase)[:, self.slot], -np.sin(phase)[:, self.slot])

    @cached_property
    def analysis(self) -> RealArray:
        """``(n_c, n_t)`` coefficients of a signal by its samples."""
        weight = np.where(np.array(self.orders)[self.slot] == 0, 1.0, 2.0) / self.samples
        return np.ascontiguousarray((self.synthesis * weight).T)

    def to_coefficients(self, amplitudes: ComplexArray) -> RealArray:
        """``(n_h, ...)`` complex amplitudes as ``(n_c, ...)`` real coefficients."""
        selected = amplitudes[self.slot]
        shape = (-1,) + (1,) * (amplitudes.ndim - 1)
        return np.where(self.is_real_part.reshape(shape), selected.real, selected.imag)

    def to_amplitudes(self, coefficients: RealArray) -> ComplexArray:
        """``(n_c, ...)`` real coefficients as ``(n_h, ...)`` complex amplitudes."""
        amplitudes = coefficients[self.is_real_part].astype(complex)
        amplitudes[1 if self.has_mean else 0 :] += 1j * coefficients[~self.is_real_part]
        return amplitudes

    def synthesise(self, amplitudes: ComplexArray) -> RealArray:
        """Samples ``(n_t, m)`` over one period of signals with amplitudes ``(n_h, m)``."""
        return self.synthesis @ self.to_coefficients(amplitudes)

    def project(self, samples: RealArray) -> RealArray:
        """Real coefficients ``(n_c, m)`` of signals sampled over one period, ``(n_t, m)``."""
        return self.analysis @ samples

    def multiplication(self, weights: RealArray) -> RealArray:
        """Matrices of "multiply by a weight in time, then project", from the weights' Fourier coefficients.

        Toeplitz plus Hankel in the harmonics: one FFT a signal, no products of sample size.

        Args:
            weights: ``(n_t, m)`` samples of the weights.

        Returns:
            ``(m, n_c, n_c)`` real matrices on real coefficients.
        """
        spectrum = scipy.fft.fft(weights.T, axis=1) / self.samples
        orders = np.array(self.orders)
        difference = spectrum[:, np.subtract.outer(orders, orders) % self.samples]
        total = spectrum[:, np.add.outer(orders, orders) % self.samples]
        if self.has_mean:  # the mean is a plain average; a harmonic's amplitude is twice its average with exp(-i h tau)
            difference[:, 0] *= 0.5
            total[:, 0] *= 0.5
        plus, minus = total + difference, difference - total
        real, imaginary = np.flatnonzero(self.is_real_part), np.flatnonzero(~self.is_real_part)
        oscillates = slice(1 if self.has_mean else 0, None)
        matrices = np.empty((weights.shape[1], self.coefficients, self.coefficients))
        matrices[:, real[:, None], real] = plus.real
        matrices[:, real[:, None], imaginary] = -minus.imag[:, :, oscillates]
        matrices[:, imaginary[:, None], real] = plus.imag[:, oscillates]
        matrices[:, imaginary[:, None], imaginary] = minus.real[:, oscillates, oscillates]
        return matrices

    def recollection(self, weights: RealArray, since: np.ndarray) -> RealArray:
        """Matrices of "multiply by a weight in time, hold what that was at an earlier sample, then project".

        What is held stays for a stretch of the period, so that each stretch is one product.

        Args:
            weights: ``(n_t, m)`` samples of the weights.
            since: ``(n_t, m)`` sample whose product is held at each, -1 where none is.

        Returns:
            ``(m, n_c, n_c)`` real matrices on real coefficients.
        """
        changes = np.vstack([np.ones((1, since.shape[1]), dtype=bool), since[1:] != since[:-1]]).T
        column, first = np.nonzero(changes)
        last = np.append(first[1:], 0)
        last[np.append(column[1:], -1) != column] = self.samples  # a stretch ends with the period
        taken = since[first, column]
        column, first, last, taken = (part[taken >= 0] for part in (column, first, last, taken))
        held = self._running_analysis[last] - self._running_analysis[first]
        read = self.synthesis[taken] * weights[taken, column][:, None]
        count = np.bincount(column, minlength=since.shape[1])
        place = np.arange(column.size) - np.repeat(np.cumsum(count) - count, count)
        stretches = np.zeros((2, since.shape[1], count.max(initial=0), self.coefficients))
        stretches[:, column, place] = held, read
        return np.matmul(stretches[0].transpose(0, 2, 1), stretches[1])

    def accumulation(self, weights: RealArray, kept: RealArray) -> RealArray:
        """Matrices of "multiply by a weight in time, gather momentum by that, project its change and its mean".

        The momentum is ``u_i = kept_i u_(i-1) + weight_i x_i``, periodic; where nothing is ever lost, it begins with
        none. What is projected is ``u_i - u_(i-1)``, and the mean of ``u`` times the angle between samples.

        Args:
            weights: ``(n_t, m)``.
            kept: ``(n_t, m)`` from 0 to 1.

        Returns:
            ``(m, n_c, n_c)`` real matrices on real coefficients.
        """
        gathered, share, reach = weights.T[:, :, None] * self.synthesis, kept.T[:, :, None].copy(), 1
        while reach < self.samples:  # by all samples of the period up to each
            gathered[:, reach:] += share[:, reach:] * gathered[:, :-reach]
            share[:, reach:] = share[:, reach:] * share[:, :-reach]
            reach *= 2
        left = 1.0 - share[:, -1]
        start = gathered[:, -1] / np.where(left > 0, left, np.inf)
        gathered += share * start[:, None]
        change = (
            gathered - np.roll(gathered, 1, axis=1) + 2 * np.pi / self.samples * gathered.mean(axis=1, keepdims=True)
        )
        return self.analysis @ change

    @cached_property
    def _running_analysis(self) -> RealArray:
        """Sums of the rows of the analysis up to each sample, ``(n_t + 1, n_c)``."""
        return np.vstack([np.zeros(self.coefficients), np.cumsum(self.analysis.T, axis=0)])

    def differentiate_columns(self, matrices: RealArray, omega: float) -> RealArray:
        """Matrices ``(..., n_c)`` that act on velocities, as matrices that act on displacements."""
        rate = omega * np.array(self.orders)[self.slot]
        real = np.flatnonzero(self.is_real_part & (rate > 0))
        result = np.zeros_like(matrices)
        result[..., real] = rate[real] * matrices[..., real + 1]
        result[..., real + 1] = -rate[real] * matrices[..., real]
        return result


def sample_amplitudes(amplitudes: Mapping[int, ComplexArray], columns: np.ndarray, samples: int) -> RealArray:
    """Samples ``(samples, K)`` of given signals, harmonic -> ``(m,)`` amplitudes, at some columns ``(K,)``."""
    phase = 2j * np.pi * np.arange(samples) / samples
    signal = np.zeros((samples, columns.size))
    for h, amplitude in amplitudes.items():
        signal += (np.exp(h * phase)[:, None] * amplitude[columns]).real
    return signal


def round_up(samples: int) -> int:
    """The next power of two from a positive number of samples."""
    return 1 << (samples - 1).bit_length()


def select_basis(harmonics: int | Sequence[int], samples: int | None = None) -> FourierBasis:
    """Basis of harmonics ``0..N`` or of those listed.

    Args:
        harmonics: ``N`` or a sequence such as ``(1, 3, 5)``.
        samples: Samples a period; by default a power of two of at least 32 a highest harmonic, from 128.

    Raises:
        ModelError: No harmonic, too many, a repeated or negative one, or too few samples to tell them apart.
    """
    if isinstance(harmonics, (int, np.integer)):
        if not 0 <= harmonics <= HIGHEST:
            raise ModelError(f"harmonics = {harmonics}; give the highest one, from 0 to {HIGHEST}, or a list of them")
        orders = tuple(range(int(harmonics) + 1))
    elif np.ndim(harmonics) != 1 or np.asarray(harmonics).dtype.kind not in "iuf" or np.ma.is_masked(harmonics):
        raise ModelError(f"harmonics = {harmonics!r}; give the highest harmonic, a whole number, or a list of them")
    else:
        orders = tuple(sorted(harmonics))
    if not orders or orders[0] < 0 or len(set(orders)) != len(orders) or not all(is_whole(h) for h in orders):
        raise ModelError(f"harmonics = {harmonics!r}; give distinct whole numbers from 0")
    orders = tuple(int(h) for h in orders)  # the double of one of few bits may be another number
    if orders[-1] > HIGHEST:
        raise ModelError(f"harmonics up to {orders[-1]:g}; give none above {HIGHEST}")
    if samples is None:
        samples = max(128, round_up(32 * orders[-1])) if orders[-1] else 1
    if not isinstance(samples, (int, np.integer)):
        raise ModelError(f"samples = {samples!r}; give a whole number of samples a period, or None")
    if samples <= 2 * orders[-1]:
        raise ModelError(
            f"samples = {samples} cannot resolve harmonic {orders[-1]}; give at least {2 * orders[-1] + 1}"
        )
    return FourierBasis(orders, int(samples))
