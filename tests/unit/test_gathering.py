"""How thin a body is: by its smallest width, whichever way the scene is turned."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from small_scenes import write_blocks

from ewr_fenicsx import load_scene
from ewr_fenicsx.output.gathering import measure_thinnest_body, measure_width
from ewr_fenicsx.structure.chain import build_chain


@pytest.mark.parametrize("inclination", [0.0, 45.0, 63.7])
def test_the_thinnest_body_is_as_thin_however_the_scene_is_turned(tmp_path, inclination):
    """Blocks of 40 mm by 30 and 6 mm; a box along the axes was 33 mm wide at 45 degrees."""
    turned = f"inclination = {inclination}, disk_height = 0.006"
    (tmp_path / "scene.toml").write_text(write_blocks(parameters=turned))
    chain = build_chain(load_scene(tmp_path / "scene.toml", warn=False))
    assert measure_thinnest_body(chain) == pytest.approx(0.006, rel=1e-9)


@given(st.floats(0, 360), st.floats(0.01, 1.0), st.integers(0, 100))
def test_the_width_is_the_smallest_extent_of_all_directions(degrees, aspect, seed):
    """Of points in a rectangle none is smaller, and one direction has it."""
    turn = np.radians(degrees)
    axes = np.array([[np.cos(turn), np.sin(turn)], [-np.sin(turn), np.cos(turn)]])
    points = (np.random.default_rng(seed).random((30, 2)) * [1.0, aspect]) @ axes
    angle = np.radians(np.linspace(0, 180, 3601))
    extents = np.ptp(points @ np.array([np.cos(angle), np.sin(angle)]), axis=0)
    width = measure_width(points)
    assert width <= extents.min() * (1 + 1e-12)
    assert width == pytest.approx(extents.min(), abs=np.radians(0.025) * 2)
