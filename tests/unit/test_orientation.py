"""Modes come out alike however the eigenvalue solver mixes those of one frequency, and whatever their signs."""

from __future__ import annotations

import numpy as np
import pytest
from petsc4py import PETSc
from scipy.stats import ortho_group

from ewr_fenicsx.structure.modes import group_equal, orient_modes

CONTACTS, MODES, ROWS = 4, 6, 20


@pytest.fixture
def mass():
    spread = np.random.default_rng(1).normal(size=(ROWS, ROWS))
    matrix = PETSc.Mat().createAIJ((ROWS, ROWS), nnz=ROWS, comm=PETSc.COMM_SELF)
    matrix.setValues(range(ROWS), range(ROWS), spread @ spread.T)
    matrix.assemble()
    return matrix


def orient(basis: np.ndarray, groups: list[np.ndarray], mass: PETSc.Mat) -> np.ndarray:
    turned = np.asfortranarray(basis)
    orient_modes(turned, CONTACTS, groups, mass)
    return turned


def test_mixtures_and_signs_are_undone(mass):
    basis = np.random.default_rng(2).normal(size=(ROWS, CONTACTS + MODES))
    frequency = np.array([100.0, 200.0, 200.0 + 1e-11, 300.0, 300.0, 300.0])
    groups = group_equal(frequency)
    assert [group.tolist() for group in groups] == [[1, 2], [3, 4, 5]]
    once = orient(basis, groups, mass)
    np.testing.assert_array_equal(once[:, :CONTACTS], basis[:, :CONTACTS])
    for group in ([0], *groups):  # the same motions
        one, two = (b[:, CONTACTS + np.array(group)] for b in (once, basis))
        np.testing.assert_allclose(one @ one.T, two @ two.T, atol=1e-12 * np.abs(basis).max() ** 2 * ROWS)
    mixed = basis.copy()
    mixed[:, CONTACTS] *= -1
    for group in groups:
        mixed[:, CONTACTS + group] = mixed[:, CONTACTS + group] @ ortho_group.rvs(len(group), random_state=3)
    np.testing.assert_allclose(orient(mixed, groups, mass), once, atol=1e-12 * np.abs(once).max())
    np.testing.assert_allclose(orient(once, groups, mass), once, atol=1e-12 * np.abs(once).max())


def test_modes_that_there_were_are_not_mixed_with_new_ones():
    known = np.array([True, True, False, False, True, False])
    groups = group_equal(np.array([100.0, 200.0, 200.0, 200.0, 300.0, 300.0]), known)
    assert [group.tolist() for group in groups] == [[2, 3]]
    assert group_equal(np.array([])) == [] and group_equal(np.array([1.0])) == []
