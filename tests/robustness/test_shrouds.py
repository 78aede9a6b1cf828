"""A joint that mostly sticks: pairs begin to slip one after the other while next to nothing of the residual is left."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from mpi4py import MPI

from ewr_fenicsx import ContactProblem, solve
from ewr_fenicsx.scene.scene import load_scene
from ewr_fenicsx.solution.contact_state import OPEN, STICK, classify_contact
from ewr_fenicsx.structure.chain import build_chain, pose_problem

SCENE = f"""
title = "two shrouded blades"
geometry.source = "{Path(__file__).parents[1] / "geometry" / "shrouds.py"}"
elasticity = {{ thickness = 0.03, degree = 2 }}
materials.right = {{ young = 200e9, poisson = 0.3, density = 7800 }}
damping = {{ kind = "modal", ratio = 0.003 }}
supports.clamp = ["root_left", "root_right"]
loads.press_left = {{ boundary = "top_left", force = [600, 0] }}
loads.press_right = {{ boundary = "top_right", force = [-500, -20] }}
loads.shake_left = {{ boundary = "top_left", force = [40, 10], harmonic = 1 }}
loads.shake_right = {{ boundary = "top_right", force = [0, 60], harmonic = 1, phase = 90 }}
loads.third = {{ boundary = "top_right", force = [15, 0], harmonic = 3, phase = -45 }}
outputs.left = {{ boundary = "top_left", direction = [1, 0] }}
contact = {{ body_a = "right", body_b = "left", friction = 0.3 }}
excitation.frequency = 330
"""


@pytest.fixture(scope="module")
def shrouds(tmp_path_factory) -> ContactProblem:
    path = tmp_path_factory.mktemp("shrouds") / "shrouds.toml"
    path.write_text(SCENE, encoding="utf-8")
    chain = build_chain(load_scene(path), MPI.COMM_SELF)
    return pose_problem(chain.scene, chain.reduction.model, chain.interface)


@pytest.mark.parametrize("harmonics", [4, 7, 9, 11, 13, 15])
def test_a_joint_that_mostly_sticks_is_solved(shrouds, harmonics):
    """The oscillation is one, whatever the harmonics; where in its family the mean lies hangs on them."""
    found = solve(replace(shrouds, harmonics=harmonics))
    assert found.converged and found.residual < 1e-8
    assert found.fallbacks == () or harmonics > 11
    assert abs(found.output("left")[1]) == pytest.approx(1.3555e-5, rel=2e-3)
    state = classify_contact(found, 256)
    assert np.mean(state[state != OPEN] == STICK) > 0.9


@pytest.fixture(scope="module")
def ring() -> ContactProblem:
    chain = build_chain(load_scene(Path(__file__).parents[2] / "demos" / "shrouded_ring.toml"), MPI.COMM_SELF)
    return pose_problem(chain.scene, chain.reduction.model, chain.interface)


@pytest.mark.parametrize("frequency", [450.0, 900.0, 1500.0])
def test_shrouds_that_flap_are_found_by_a_long_splitting(ring, frequency):
    """Of one sector for all, where a cold start fails: from full stick, at next to no Newton steps."""
    loose = replace(ring, laws=replace(ring.laws, initial_gap=-1e-6), frequency=frequency, harmonics=5)
    assert not solve(loose, fallbacks=False, raise_on_failure=False).converged
    found = solve(loose)
    assert [tried.split(":")[0] for tried in found.fallbacks] == ["cold start", "long splitting"]
    assert found.iterations < 40 and found.history("gap").max() > 5e-6
