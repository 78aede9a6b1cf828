"""The builder of a twisted blade: names, matching flanks, and what it refuses."""

from __future__ import annotations

from pathlib import Path

import gmsh
import numpy as np
import pytest

from ewr_fenicsx.structure.mesh import load_builder

SOURCE = Path(__file__).parents[2] / "geometry" / "twisted_blade.py"


@pytest.fixture
def model():
    gmsh.initialize(["", "-nopopup"], False)
    gmsh.option.setNumber("General.Terminal", 0)
    gmsh.model.add("blade")
    with load_builder(SOURCE) as builder:
        yield builder
    gmsh.finalize()


@pytest.mark.parametrize(
    "parameters", [{}, {"twist": -70.0, "flank_size": 3e-3}, {"flank_angle": 40.0, "height": 0.03}]
)
def test_flanks_match_and_groups_are_where_they_should_be(model, parameters):
    model.build(**parameters)
    groups = {
        gmsh.model.getPhysicalName(d, n): gmsh.model.getEntitiesForPhysicalGroup(d, n).tolist()
        for d, n in gmsh.model.getPhysicalGroups()
    }
    assert {name: len(members) for name, members in groups.items()} == {
        "blade": 2, "disk": 1, "left": 2, "right": 2, "stop": 1, "clamp": 1, "tip": 1,
    }  # fmt: skip
    for flank in ("left", "right"):
        sides = [gmsh.model.mesh.getNodes(2, face, includeBoundary=True) for face in groups[flank]]
        places = [np.unique(positions.reshape(-1, 3).round(9), axis=0) for _, positions, _ in sides]
        np.testing.assert_array_equal(*places)
        assert not set(sides[0][0]) & set(sides[1][0]), "the two bodies share a node"
    for name, axis, at in (("stop", 2, 0.0), ("clamp", 1, -0.018), ("tip", 1, parameters.get("height", 0.05))):
        positions = gmsh.model.mesh.getNodes(2, groups[name][0], includeBoundary=True)[1].reshape(-1, 3)
        np.testing.assert_allclose(positions[:, axis], at, atol=1e-9)


@pytest.mark.parametrize(
    "parameters, message",
    [
        ({"height": 0.0}, "height = 0.0: expected a positive number"),
        ({"twist": 85.0}, "twist = 85.0: expected degrees"),
        ({"flank_angle": 15.0}, "flank_angle = 15.0: expected 20 to 80"),
        ({"chord": 0.03}, "chord = 0.03: expected less than depth"),
        ({"thickness": 0.009}, "thickness = 0.009: expected less than neck_width"),
        ({"disk_width": 0.01}, "disk_width = 0.01: expected more than the foot's"),
        ({"disk_height": 0.007}, "disk_height = 0.007: expected more than 0.0075, the slot's depth"),
    ],
)
def test_what_does_not_fit_is_refused(model, parameters, message):
    with pytest.raises(ValueError, match=message):
        model.build(**parameters)
