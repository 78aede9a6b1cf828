"""The default scene through ``ewr run``: figures, files, and that the files say what the solution says."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import h5py
import meshio
import numpy as np
import pytest
from scene_runs import read_table
from scipy.integrate import trapezoid
from small_scenes import read_demo, write_blocks

from ewr_fenicsx import ReducedModel, load_scene, solve
from ewr_fenicsx.accuracy.estimates import measure_distance
from ewr_fenicsx.cli import main
from ewr_fenicsx.structure.chain import build_chain, pose_problem

ROOT = Path(__file__).parents[2]
SCENE = ROOT / "demos" / "blade_root.toml"
STEPS = 32
CONTACT_FIELDS = ("contact_pressure", "friction_traction", "gap", "slip", "contact_state")


def run_ewr(*arguments: str | Path) -> subprocess.CompletedProcess[str]:
    return run_python("-m", "ewr_fenicsx", *arguments)


def run_python(*arguments: str | Path) -> subprocess.CompletedProcess[str]:
    """A Python of its own; not with the C environment, where this process's MPI has left its own address."""
    command = [sys.executable, *map(str, arguments)]
    return subprocess.run(command, env=dict(os.environ), capture_output=True, text=True, check=False)


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    """One run of the default scene: the finished process and its result folder."""
    folder = tmp_path_factory.mktemp("blade_root") / "results"
    return run_ewr("run", SCENE, "--out", folder), folder


@pytest.fixture(scope="module")
def summary(run):
    return json.loads((run[1] / "summary.json").read_text())


@pytest.fixture(scope="module")
def pairs(run):
    rows = read_table(run[1] / "pairs.csv")
    return {key: np.array([row[key] for row in rows]) for key in rows[0]}


def read_series(path: Path) -> tuple[np.ndarray, list[tuple[float, np.ndarray]]]:
    with meshio.xdmf.TimeSeriesReader(path) as reader:
        points, _ = reader.read_points_cells()
        steps = []
        for k in range(reader.num_steps):
            time, fields, _ = reader.read_data(k)
            assert list(fields) == [path.stem], "one field a file, named like its file"
            steps.append((time, fields[path.stem]))
    return points, steps


def largest(steps: list[tuple[float, np.ndarray]]) -> float:
    return max(float(np.abs(field).max()) for _, field in steps)


def test_run_names_the_files_and_pictures_that_it_wrote(run):
    done, folder = run
    assert done.returncode == 0, done.stderr
    assert "converged" in done.stdout
    assert "Traceback" not in done.stderr
    named = [Path(line.strip()) for line in done.stdout.splitlines() if line.startswith("  /")]
    assert {path.name for path in named if path.suffix == ".png"} == {
        "mesh.png",
        "full_stick_mode.png",
        "pair_histories.png",
        "contact_sets.png",
    }
    assert all(path.is_file() and path.parent == folder for path in named)
    assert {"displacement.xdmf", "pairs.csv", "reduced_model.h5", "summary.json"} <= {path.name for path in named}
    assert [path.name for path in folder.parent.iterdir()] == ["results"], "no temporary folder is left"


def test_progress_names_every_stage(run):
    stages = [line.split()[0] for line in run[0].stderr.splitlines() if line.endswith(" s")]
    stages = [stage for stage in stages if stage != "JIT"]  # where it takes a while: not with everything in the cache
    assert stages == ["mesh", "matrices", "interface", "reduction", "solve", "stability", "estimate", "write"]


def test_summary_tells_where_the_figures_come_from(summary, run):
    assert summary["scene"]["contact"]["friction"] == 0.2
    assert Path(summary["scene"]["geometry"]["source"]).is_file()
    assert {"python", "dolfinx", "petsc4py", "slepc4py", "numpy", "ewr_fenicsx"} <= set(summary["versions"])
    assert set(summary["seconds"]) == {
        "mesh",
        "matrices",
        "JIT",
        "interface",
        "reduction",
        "solve",
        "stability",
        "estimate",
        "write",
    }
    assert sorted(path.name for path in run[1].iterdir()) == summary["files"]
    assert summary["solution"]["converged"] is True
    assert summary["ranks"] == 1


def test_who_asked_for_no_accuracy_is_told_of_the_error(summary, run):
    """Against forty harmonics of the same reduced model; and how to have less of it."""
    told = next(line for line in run[0].stdout.splitlines() if "estimated error of the response" in line)
    assert "solver.accuracy = 0.01" in told and "accuracy" not in summary
    scene = load_scene(ROOT / "demos" / "blade_root.toml")
    chain = build_chain(scene)
    problem = pose_problem(scene, chain.reduction.model, chain.interface)
    coarse, truth = solve(problem), solve(replace(problem, harmonics=40, closure="spring"))
    true = measure_distance(coarse, truth)
    assert true / 3 < summary["estimate"]["total"] < 3 * true
    assert 0 < summary["estimate"]["modes"] < summary["estimate"]["harmonics"]


def test_figures_of_the_default_scene(summary, pairs):
    assert summary["model"]["pairs"] == 40
    assert 1900 < summary["model"]["nodes"] < 2300
    assert summary["model"]["full_stick_frequencies_Hz"][0] == pytest.approx(1090, rel=0.01)
    assert summary["model"]["smallest_scaled_jacobian"] > 0.3
    merit = summary["solution"]["merit"]
    assert abs(merit["energy_error"]) < 1e-3
    assert merit["friction_dissipation"] > 0
    sliding = pairs["sliding_distance [m/cycle]"]
    assert 1e-6 < sliding.max() < 50e-6, "default loads rub in the range of fretting"
    assert merit["J_T"] == pytest.approx(sliding.mean(), rel=1e-12)
    assert (pairs["open_share"] > 0).any(), "some pairs lift off"
    assert (pairs["open_share"] < 1).all(), "and none for good"
    shares = pairs["open_share"] + pairs["stick_share"] + pairs["slip_share"]
    np.testing.assert_allclose(shares, 1.0, rtol=1e-12)


def test_mean_contact_forces_carry_the_static_load(summary, pairs):
    normal = np.column_stack([pairs["normal_x"], pairs["normal_y"]])
    tangent = np.column_stack([-normal[:, 1], normal[:, 0]])
    on_blade = pairs["friction_force_mean [N]"] @ tangent - pairs["normal_force_mean [N]"] @ normal
    pull = np.array(summary["scene"]["loads"]["axial_pull"]["force"])
    assert np.linalg.norm(on_blade + pull) < 1e-9 * np.linalg.norm(pull)


def test_displacement_is_one_period_of_the_tip_s_motion(run, summary):
    points, steps = read_series(run[1] / "displacement.xdmf")
    times = np.array([time for time, _ in steps])
    np.testing.assert_allclose(times, np.arange(STEPS) / STEPS / 1000.0, rtol=1e-12)
    assert steps[0][1].shape == (summary["model"]["nodes"], 3), "three components: Warp By Vector wants them"
    tip = points[:, 1] > points[:, 1].max() - 1e-9
    order = np.argsort(points[tip, 0])  # along the straight edge, on which degree-1 elements are exactly trapezoidal
    x = points[tip, 0][order]
    motion = np.array([trapezoid(u[tip, 0][order], x) for _, u in steps]) / (x[-1] - x[0])
    amplitudes = {a["harmonic"]: a["real"] + 1j * a["imag"] for a in summary["solution"]["outputs"]["tip"]}
    tau = 2 * np.pi * np.arange(STEPS) / STEPS
    expected = sum((a * np.exp(1j * h * tau)).real for h, a in amplitudes.items())
    np.testing.assert_allclose(motion, expected, atol=1e-9 * np.abs(expected).max())
    assert 0.1e-3 < np.abs(amplitudes[1]) < 5e-3
    clamped = np.hypot(points[:, 0], points[:, 1]) < np.hypot(points[:, 0], points[:, 1]).min() + 1e-9
    assert max(np.abs(u[clamped]).max() for _, u in steps) < 1e-12 * largest(steps)


@pytest.mark.parametrize("name", CONTACT_FIELDS)
def test_contact_field_lives_on_both_sides_of_the_joint(run, pairs, name):
    points, steps = read_series(run[1] / f"{name}.xdmf")
    assert len(steps) == STEPS
    place = np.column_stack([pairs["x [m]"], pairs["y [m]"]])
    distance = np.linalg.norm(points[:, None, :2] - place[None], axis=2)
    nodes = np.argwhere(distance < 1e-8)  # (node, pair)
    assert np.bincount(nodes[:, 1]).tolist() == [2] * 40
    away = np.setdiff1d(np.arange(len(points)), nodes[:, 0])
    first, second = (nodes[np.argsort(nodes[:, 1], kind="stable"), 0][k::2] for k in (0, 1))
    rounding = 1e-12 * largest(steps)  # dolfinx 0.5 interpolates once more as it writes
    for _, field in steps:
        field = field.reshape(-1)
        np.testing.assert_allclose(field[away], -1 if name == "contact_state" else 0, atol=rounding)
        np.testing.assert_allclose(field[first], field[second], atol=rounding)
    assert largest(steps) > 0


def test_contact_fields_agree_with_the_table_of_pairs(run, pairs):
    values = {}
    for name in CONTACT_FIELDS:
        points, steps = read_series(run[1] / f"{name}.xdmf")
        nearest = [
            int(np.argmin(np.hypot(points[:, 0] - x, points[:, 1] - y)))
            for x, y in zip(pairs["x [m]"], pairs["y [m]"], strict=True)
        ]
        values[name] = np.array([field.reshape(-1)[nearest] for _, field in steps])
    state = values["contact_state"]
    # 32 samples integrate harmonics 0 to 5 exactly
    pressure = pairs["normal_force_mean [N]"] / pairs["area [m^2]"]
    np.testing.assert_allclose(values["contact_pressure"].mean(axis=0), pressure, rtol=1e-9)
    traction = pairs["friction_force_mean [N]"] / pairs["area [m^2]"]
    np.testing.assert_allclose(values["friction_traction"].mean(axis=0), traction, atol=1e-9 * np.abs(pressure).max())
    for name in ("gap", "slip"):
        expected = pairs[f"{name}_mean [m]"]
        np.testing.assert_allclose(values[name].mean(axis=0), expected, atol=1e-9 * np.abs(expected).max())
        assert np.all(values[name] <= pairs[f"{name}_max [m]"] + 1e-15)
        assert np.all(values[name] >= pairs[f"{name}_min [m]"] - 1e-15)
    assert set(np.unique(state)) == {0, 1, 2}
    for code, share in enumerate(("open_share", "stick_share", "slip_share")):
        np.testing.assert_allclose((state == code).mean(axis=0), pairs[share], atol=3 / STEPS)
    open_now = state == 0
    assert values["gap"][open_now].max() > 1e-8
    assert np.abs(values["contact_pressure"][open_now]).max() < 0.1 * values["contact_pressure"].max()


def test_contact_states_are_whole_numbers(run):
    """``state == 2`` finds what slips: dolfinx 0.5 would write 1.99999999999996."""
    _, steps = read_series(run[1] / "contact_state.xdmf")
    assert set(np.unique([field for _, field in steps])) == {-1.0, 0.0, 1.0, 2.0}


@pytest.mark.parametrize("name", ["displacement", "mesh_tags", *CONTACT_FIELDS])
def test_xdmf_names_xinclude_as_the_standard_does(run, name):
    """ParaView's Xdmf2 reader crashes on dolfinx 0.9's own spelling, with https."""
    assert 'xmlns:xi="http://www.w3.org/2001/XInclude"' in (run[1] / f"{name}.xdmf").read_text()


def test_tags_have_a_file_of_their_own(run, summary):
    with h5py.File(run[1] / "mesh_tags.h5") as file:
        grids = file["MeshTags"]
        assert set(grids) == {"bodies", "boundaries"}
        assert len(grids["bodies"]["Values"]) == summary["model"]["cells"]
        assert len(np.unique(grids["bodies"]["Values"])) == 2
        assert len(np.unique(grids["boundaries"]["Values"])) == 6  # four flanks, clamp, tip
        for kind in grids:
            assert set(np.ravel(grids[kind]["Values"])) == set(summary["model"][kind].values())
        points, tip = file["Mesh/mesh/geometry"][:], summary["model"]["boundaries"]["tip"]
        edges = grids["boundaries"]["topology"][:][np.ravel(grids["boundaries"]["Values"]) == tip]
        np.testing.assert_allclose(points[edges, 1], points[:, 1].max())
    with h5py.File(run[1] / "displacement.h5") as file:
        assert len(file["Function"]["displacement"]) == STEPS


def test_reduced_model_file_is_the_model(run, summary):
    model = ReducedModel.load(run[1] / "reduced_model.h5")
    assert (model.pairs, model.size) == (40, summary["model"]["coordinates"])
    assert set(model.load) == {0, 1}
    assert model.rigid_modes.shape[1] == 3


def test_pictures_are_pictures(run):
    for name in ("mesh", "full_stick_mode", "pair_histories", "contact_sets"):
        picture = read_picture(run[1] / f"{name}.png")
        assert min(picture.shape[:2]) > 600
        assert picture[..., :3].std() > 0.02, "not blank"


def read_picture(path: Path) -> np.ndarray:
    from matplotlib.image import imread

    return imread(path)


def test_overwrite_replaces_an_earlier_run_and_petsc_options_reach_the_newton_solver(tmp_path):
    """Options that nothing takes are named, where PETSc passes them over."""
    scene, results = tmp_path / "scene.toml", tmp_path / "results"
    scene.write_text(write_blocks())
    assert main(["run", str(scene), "--out", str(results)]) == 0
    before = (results / "summary.json").stat().st_ino
    given = ("-ewr_snes_monitor", "-ewr_snes_monitr", "-ksp_view")
    done = run_ewr("run", scene, "--out", results, "--overwrite", *given)
    assert done.returncode == 0, done.stderr
    assert (results / "summary.json").stat().st_ino != before
    assert "0 SNES Function norm" in done.stdout
    told = [line for line in done.stderr.splitlines() if line.startswith("ewr: ")]
    assert told == [
        "ewr: nothing took -ewr_snes_monitr: is it spelt so? Linear scenes take none",
        "ewr: nothing took -ksp_view; was -ewr_ksp_view meant?",
    ]


def test_info_counts_without_solving(capsys, monkeypatch):
    import ewr_fenicsx.solver.newton

    monkeypatch.setattr(ewr_fenicsx.solver.newton, "solve", lambda *_, **__: pytest.fail("info must not solve"))
    assert main(["info", str(SCENE)]) == 0
    text = capsys.readouterr().out
    for line in (
        r"nodes",
        r"40 (bottom_left 10, bottom_right 10, top_left 10, top_right 10)",
        "30 fixed-interface modes",
        "0, 1, 2, 3, 4, 5 of 1000 Hz",
        "883 of the contact solve",
    ):
        assert line in text
    table = {
        line.split("  ")[0]: line.split()[-1] for line in text.splitlines() if "  on  " in line or "  off  " in line
    }
    assert {"separation", "friction", "static load", "harmonic load"} <= set(table)


def test_info_counts_no_unknowns_that_an_accuracy_chooses(tmp_path, capsys):
    (tmp_path / "scene.toml").write_text(f"{read_demo('blade_root')}\n[solver]\naccuracy = 0.01\n")
    assert main(["info", str(tmp_path / "scene.toml")]) == 0
    lines = capsys.readouterr().out.splitlines()
    row = lambda name: next(" ".join(line.split()[1:]) for line in lines if line.startswith(name))  # noqa: E731
    assert row("harmonics") == "chosen by the solver for accuracy = 0.01, at 1000 Hz"
    assert row("unknowns") == "chosen by the solver for accuracy = 0.01"
    assert row("modes").startswith("30 fixed-interface modes to begin with, up to")
    assert row("separation").endswith(" 40"), "rows; no unknowns"
    assert row("separation").split()[-2] == '"unilateral"'
    assert "883" not in "\n".join(lines) and "0, 1, 2, 3, 4, 5" not in "\n".join(lines)


def test_demo_runs_and_its_assertions_hold():
    done = run_python(ROOT / "demos" / "blade_root.py")
    assert done.returncode == 0, done.stderr
    assert "displacement.xdmf" in done.stdout
    assert (ROOT / "demos" / "results" / "blade_root" / "summary.json").is_file()
