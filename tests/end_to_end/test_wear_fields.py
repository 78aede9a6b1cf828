"""Wear of the blade root as fields over the cycles: what the files say is what the history says."""

from __future__ import annotations

import shutil
import subprocess
from pathlib import Path

import h5py
import meshio
import numpy as np
import pytest
from matplotlib.image import imread

from ewr_fenicsx import Tolerance, evolve_wear, load_scene
from ewr_fenicsx.output.wear_fields import WEAR_FIELDS, tabulate_wear_fields, write_wear_fields
from ewr_fenicsx.structure.chain import build_chain, pose_problem

DEMOS = Path(__file__).parents[2] / "demos"
SCENE = DEMOS / "blade_root.toml"


@pytest.fixture(scope="module")
def worn(tmp_path_factory):
    folder = tmp_path_factory.mktemp("wear")
    chain = build_chain(load_scene(SCENE))
    history = evolve_wear(pose_problem(chain.scene, chain.reduction.model), 40, 1e-11, Tolerance(share=0.02))
    write_wear_fields(folder, chain, history)
    return folder, chain, history


def read_series(path: Path):
    with meshio.xdmf.TimeSeriesReader(path) as reader:
        points, _ = reader.read_points_cells()
        steps = [reader.read_data(k) for k in range(reader.num_steps)]
    return points, np.array([time for time, _, _ in steps]), np.array([fields[path.stem] for _, fields, _ in steps])


@pytest.mark.parametrize("name", WEAR_FIELDS)
def test_fields_hold_the_history_at_the_flanks_and_nothing_elsewhere(worn, name):
    folder, chain, history = worn
    points, times, fields = read_series(folder / f"{name}.xdmf")
    np.testing.assert_array_equal(times, history.cycles)
    values, place = tabulate_wear_fields(history)[name], chain.interface.position
    distance = np.linalg.norm(points[:, None, :2] - place[None], axis=2)
    pair, here = distance.argmin(axis=1), distance.min(axis=1) < 1e-9
    assert here.sum() == 2 * len(place), "a node of either body"
    np.testing.assert_allclose(fields[:, here].reshape(len(times), -1), values[:, pair[here]], rtol=1e-12)
    # interpolation to degree 1 leaves rounding at the nodes next to the flanks
    np.testing.assert_allclose(fields[:, ~here], 0.0, atol=1e-12 * np.abs(values).max())


def test_fields_mean_what_they_say(worn):
    _, _, history = worn
    fields = tabulate_wear_fields(history)
    np.testing.assert_array_equal(fields["worn_gap"], history.depth)
    np.testing.assert_allclose(fields["J_T"][:, 0], history.figure("J_T"), rtol=1e-12)
    assert history.depth[-1].min() > 0
    assert np.all(np.diff(history.depth, axis=0) >= 0)


def test_mean_pressure_is_the_mean_force_over_the_area_where_a_pair_never_parts(worn):
    _, _, history = worn
    for pressure, solution in zip(tabulate_wear_fields(history)["mean_pressure"], history.solutions, strict=True):
        closed = solution.history("normal_force", 4096).min(axis=0) >= 0
        force = pressure * solution.problem.model.areas
        assert closed.any()
        np.testing.assert_allclose(force[closed], solution.pair_forces["normal"][0].real[closed], rtol=1e-12)


def test_the_sliding_distances_of_all_pairs_have_the_mean_that_the_history_tells(worn):
    _, _, history = worn
    sliding = tabulate_wear_fields(history)["sliding_distance"]
    np.testing.assert_allclose(sliding.mean(axis=1), history.figure("J_T"), rtol=1e-12)


def test_the_surface_recedes_into_the_blade_by_the_worn_depth(worn):
    folder, chain, history = worn
    points, _, fields = read_series(folder / "worn_surface.xdmf")
    place = chain.interface.position
    last = fields[-1][:, :2]
    moved = np.flatnonzero(np.linalg.norm(last, axis=1) > 1e-9 * history.depth[-1].max())
    pair = np.linalg.norm(points[moved][:, None, :2] - place[None], axis=2).argmin(axis=1)
    assert sorted(pair) == list(range(len(place))), "each pair's node on the blade, and no other"
    np.testing.assert_allclose(
        last[moved], -chain.interface.normal[pair] * history.depth[-1][pair, None], rtol=1e-9, atol=1e-20
    )


def test_files_are_plain_hdf5(worn):
    folder, _, history = worn
    for name in (*WEAR_FIELDS, "worn_surface"):
        with h5py.File(folder / f"{name}.h5") as file:
            assert len(file[f"Function/{name}"]) == len(history.cycles)


@pytest.mark.slow
def test_paraview_draws_the_flanks_wearing(worn, tmp_path, headless):
    """The script of the demos, without a display: a frame for each step, the last with the flanks apart."""
    folder, _, history = worn
    for program in ("xvfb-run", "pvbatch"):
        assert shutil.which(program), f"the full run needs {program}: tools/setup.sh full installs it"
    draw = ["pvbatch", "--force-offscreen-rendering", DEMOS / "wear_in_paraview.py", folder, tmp_path]
    done = subprocess.run([*headless, *draw], capture_output=True, text=True, timeout=300, check=False)
    assert done.returncode == 0, done.stderr
    assert "Error" not in done.stderr and "ERR|" not in done.stderr, done.stderr
    assert len(list(tmp_path.glob("wear_*.png"))) == len(history.cycles)
    first, last = imread(tmp_path / "wear_0000.png")[..., :3], imread(tmp_path / "wear.png")[..., :3]
    changed = np.abs(first - last).max(axis=2) > 0.1
    assert 0.002 < changed.mean() < 0.2, "flanks take on colour, and nothing else does"
