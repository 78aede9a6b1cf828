"""Every scene of the gallery through `ewr run`, what it claims asserted; its page and pictures; the literate demo."""

from __future__ import annotations

import importlib
import json
import os
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import gmsh
import numpy as np
import pytest
from matplotlib.collections import PolyCollection
from matplotlib.figure import Figure
from scene_runs import read_table

from ewr_fenicsx import load_scene, solve
from ewr_fenicsx.cli import main
from ewr_fenicsx.structure.chain import build_chain, pose_problem
from ewr_fenicsx.structure.mesh import load_builder

ROOT = Path(__file__).parents[2]
SCENES = (
    "friction_damped_beam",
    "two_blocks",
    "dovetail",
    "blade_root",
    "platform_damper",
    "bolted_lap",
    "tapping_rod",
    "broached_dovetail",
    "twisted_blade",
    "bladed_disk",
    "damped_ring",
    "shrouded_ring",
)


@pytest.fixture
def run(tmp_path):
    """Run a scene of the gallery; returns its summary, the rows of its pairs and its folder."""

    def run_scene(name: str) -> tuple[dict, list[dict], Path]:
        folder = tmp_path / name
        assert main(["run", str(ROOT / "demos" / f"{name}.toml"), "--out", str(folder)]) == 0
        summary = json.loads((folder / "summary.json").read_text())
        assert summary["solution"]["converged"] and summary["doubts_of_small_motion"] == []
        return summary, read_table(folder / "pairs.csv"), folder

    return run_scene


def column(rows: list[dict], name: str) -> np.ndarray:
    return np.array([row[name] for row in rows])


def test_friction_damped_beam(run):
    """Friction takes most of the energy at the peak and pulls it down; even harmonics are not even kept."""
    summary, pairs, folder = run("friction_damped_beam")
    solution = summary["solution"]
    assert solution["harmonics"] == [0, 1, 3, 5] and solution["unknowns"] == len(pairs) * 7
    merit = solution["merit"]
    assert merit["friction_dissipation"] > merit["viscous_dissipation"]
    assert abs(merit["energy_error"]) < 1e-6
    assert not (folder / "gap.xdmf").exists(), "a given normal force knows no gap"
    scene = load_scene(ROOT / "demos" / "friction_damped_beam.toml")
    chain = build_chain(scene)
    problem = pose_problem(scene, chain.reduction.model, chain.interface)
    free = [
        solve(replace(problem, frequency=f, laws=replace(problem.laws, tangential="frictionless"))).merit["rms_tip"]
        for f in scene.frequencies
    ]
    assert max(column(read_table(folder / "frequency_response.csv"), "rms_tip")) < 0.5 * max(free)


def test_two_blocks(run):
    """It rocks: both heels lift off in a period, never the whole seat; and the seat carries the press."""
    summary, pairs, _ = run("two_blocks")
    ends = [pairs[0], pairs[-1]]
    assert all(0.05 < row["open_share"] < 0.95 for row in ends)
    assert max(column(pairs, "slip_share")) > 0.1
    assert column(pairs, "normal_force_mean [N]").sum() == pytest.approx(1000.0, rel=1e-9)
    assert abs(summary["solution"]["merit"]["energy_error"]) < 1e-3


def test_dovetail(run):
    """The coated flank slips more and wears less; the spin is carried."""
    summary, pairs, folder = run("dovetail")
    flank, depth = column(pairs, "flank"), column(pairs, "worn_depth [m]")
    sliding = column(pairs, "sliding_distance [m/cycle]")
    assert sliding[flank == "left"].mean() > sliding[flank == "right"].mean() > 1e-6
    assert depth[flank == "right"].mean() > 1.5 * depth[flank == "left"].mean() > 0
    history = read_table(folder / "wear.csv")
    assert history[-1]["cycles"] == 2000 and len(history) < 100, "cycles were jumped"
    pull = column(pairs, "normal_force_mean [N]") @ column(pairs, "normal_y")
    pull -= column(pairs, "friction_force_mean [N]") @ column(pairs, "normal_x")
    assert pull > 1000.0, "the blade pulls outwards"
    assert {"spin", "shake"} == set(summary["scene"]["loads"])


def test_bolted_lap(run):
    """Partial slip: pairs that stick throughout, pairs that slip for a while, pairs that part."""
    summary, pairs, _ = run("bolted_lap")
    stick, slip, open_ = (column(pairs, f"{name}_share") for name in ("stick", "slip", "open"))
    middle = slice(len(pairs) // 2 - 2, len(pairs) // 2 + 2)
    assert (stick[middle] == 1).any() and (slip > 0.2).any() and (open_ > 0.5).any()
    assert abs(stick[middle].mean()) > stick.mean()
    normal = column(pairs, "normal_force_mean [N]").sum()
    assert normal == pytest.approx(5000.0, rel=0.1), "the bolt's force flows through the lap"
    assert summary["solution"]["unknowns"] == 2 * len(pairs) * 11


def test_tapping_rod(run):
    """It touches for a part of the period, hardly penetrates, and pushes."""
    summary, pairs, _ = run("tapping_rod")
    assert all(0.3 < row["open_share"] < 0.95 for row in pairs)
    assert all(row["gap_max [m]"] > 20e-6 for row in pairs), "it swings back beyond where it rests"
    assert summary["solution"]["merit"]["penetration"] < 0.1 * 20e-6
    assert column(pairs, "normal_force_mean [N]").sum() > 10
    assert summary["solution"]["unknowns"] == len(pairs) * 19, "no tangential unknown"


def test_broached_dovetail(run):
    """The spin is carried, nothing but friction acts along the slot, and pairs slip in the plane of their flank."""
    summary, pairs, folder = run("broached_dovetail")
    assert summary["solution"]["unknowns"] == 3 * len(pairs) * 11 + 6 and summary["solution"]["fallbacks"] == []
    merit = summary["solution"]["merit"]
    assert abs(merit["energy_error"]) < 1e-5 and merit["friction_dissipation"] > merit["viscous_dissipation"]
    assert max(column(pairs, "slip_share")) > 0.5
    along, across = (
        np.ptp([column(pairs, f"{name}_{end} [m]") for end in ("min", "max")], axis=0).max()
        for name in ("slip", "second_slip")
    )
    assert min(along, across) > 1e-6
    normals = np.array([column(pairs, f"normal_{axis}") for axis in "xyz"])
    slot = np.array([np.sin(np.radians(15.0)), 0.0, np.cos(np.radians(15.0))])
    np.testing.assert_allclose(slot @ normals, 0.0, atol=1e-9)
    assert (folder / "second_slip.xdmf").exists()


def test_twisted_blade(run):
    """The lock leaves three rigid motions of six, and takes what pushes along the slot; flanks carry the spin."""
    summary, pairs, folder = run("twisted_blade")
    assert summary["solution"]["unknowns"] == 3 * len(pairs) * 11 + 3 and summary["solution"]["fallbacks"] == []
    merit = summary["solution"]["merit"]
    assert abs(merit["energy_error"]) < 1e-5 and merit["friction_dissipation"] > 0
    assert np.mean(column(pairs, "slip_share")) > 0.05 and np.mean(column(pairs, "open_share")) > 0.05
    assert (folder / "second_friction_traction.xdmf").exists()
    chain = build_chain(load_scene(ROOT / "demos" / "twisted_blade.toml"))
    structure, joint = chain.structure, chain.interface
    assert structure.space.dofmap.dof_layout.num_dofs == 10, "tetrahedra of second order"
    on_blade = np.repeat(structure.part == structure.part[joint.nodes_a[0]], 3).reshape(-1, 3)
    pull = np.sum(structure.loads[0].vector.array.reshape(-1, 3) * on_blade, axis=0)
    forces = -column(pairs, "normal_force_mean [N]")[:, None] * joint.normal
    for k, name in enumerate(("friction_force", "second_friction_force")):
        forces = forces + column(pairs, f"{name}_mean [N]")[:, None] * joint.tangents[:, k]
    left = pull + forces.sum(axis=0)
    assert pull[1] > 1e3
    np.testing.assert_allclose(left[:2], 0.0, atol=1e-6 * pull[1])


def test_platform_damper(run):
    """The wedge takes away most of both peaks: that of the blades without it, and that with it stuck."""
    summary, pairs, folder = run("platform_damper")
    merit = summary["solution"]["merit"]
    assert merit["friction_dissipation"] > 10 * merit["viscous_dissipation"]
    scene = load_scene(ROOT / "demos" / "platform_damper.toml")
    chain = build_chain(scene)
    problem = pose_problem(scene, chain.reduction.model, chain.interface)
    laws = {
        "without": replace(problem.laws, tangential="frictionless"),
        "stuck": replace(problem.laws, normal="bonded", tangential="bonded"),
    }
    peaks = {  # the blades alone are costly to solve: of some points, whose peak is no higher than that of all
        name: max(
            solve(replace(problem, laws=law, frequency=f)).merit["rms_tip"]
            for f in scene.frequencies[:: 3 if name == "without" else 1]
        )
        for name, law in laws.items()
    }
    damped = max(column(read_table(folder / "frequency_response.csv"), "rms_tip"))
    assert damped < 0.3 * min(peaks.values()), (damped, peaks)
    flank, force = column(pairs, "flank"), column(pairs, "normal_force_mean [N]")
    lifted = -force * column(pairs, "normal_y") + column(pairs, "friction_force_mean [N]") * column(pairs, "normal_x")
    assert lifted.sum() == pytest.approx(300.0, rel=1e-6), "both flanks carry the wedge"
    assert force[flank == "left"].sum() == pytest.approx(force[flank == "right"].sum(), rel=1e-3)


def test_bladed_disk(run):
    """Flanks slip, one sector costs what it would alone, and all thirty are in the picture."""
    summary, pairs, folder = run("bladed_disk")
    solution = summary["solution"]
    assert solution["unknowns"] == 2 * len(pairs) * 11 + 3 and solution["fallbacks"] == []
    merit = solution["merit"]
    assert merit["friction_dissipation"] > 10 * merit["viscous_dissipation"] and abs(merit["energy_error"]) < 1e-5
    assert 1050.0 < summary["model"]["full_stick_frequencies_Hz"][0] < 1100.0
    assert "stability is not known: no deviation grows much" in solution["cautions"][0]
    assert (folder / "ring.png").stat().st_size > 50_000 and (folder / "nodal_diameters.png").exists()
    waves = read_table(folder / "nodal_diameters.csv")
    assert [row["nodal_diameters"] for row in waves] == list(range(16))
    assert waves[4]["mode_1 [Hz]"] == pytest.approx(summary["model"]["full_stick_frequencies_Hz"][0], rel=1e-6)
    assert summary["model"]["full_stick_nodal_diameters"] == 4


def test_damped_ring(run):
    """Each wedge slides on both of its blades, which carry its centrifugal force; it damps far more than the blades."""
    summary, pairs, _ = run("damped_ring")
    merit = summary["solution"]["merit"]
    assert merit["friction_dissipation"] > 10 * merit["viscous_dissipation"]
    flank, slip = column(pairs, "flank"), column(pairs, "sliding_distance [m/cycle]")
    assert {*flank} == {"near", "far"} and min(slip[flank == name].mean() for name in ("near", "far")) > 1e-5
    normal, tangent = ([column(pairs, f"{name}_{axis}") for axis in "xy"] for name in ("normal", "tangent"))
    force, friction = (column(pairs, f"{name}_force_mean [N]") for name in ("normal", "friction"))
    of_wedge = np.where(flank == "near", 1.0, -1.0)  # near: A is the blade, far: the wedge
    carried = np.array([(of_wedge * (force * n - friction * t)).sum() for n, t in zip(normal, tangent, strict=True)])
    outwards = np.array([-np.sin(np.pi / 30), np.cos(np.pi / 30)])
    area, speed = 8e-3 * (20e-3 - 8e-3 / np.tan(np.radians(53.0))), 5000 / 60 * 2 * np.pi
    assert -carried @ outwards == pytest.approx(4430 * 0.01 * area * speed**2 * 0.19342, rel=1e-4)
    assert carried @ [outwards[1], -outwards[0]] == pytest.approx(0.0, abs=1e-3 * np.linalg.norm(carried))


def test_shrouded_ring(run):
    """Interference alone presses the shrouds; with less of it they flap."""
    summary, pairs, _ = run("shrouded_ring")
    assert all(column(pairs, "flank") == "shroud") and column(pairs, "normal_force_mean [N]").sum() > 10.0
    scene = load_scene(ROOT / "demos" / "shrouded_ring.toml")
    problem = pose_problem(scene, build_chain(scene).reduction.model)
    looser = solve(replace(problem, laws=replace(problem.laws, initial_gap=-2e-5)))
    assert summary["solution"]["fallbacks"] == [] and looser.fallbacks
    assert looser.merit["rms_tip"] > 100 * summary["solution"]["merit"]["rms_tip"]


def test_the_page_shows_every_scene():
    page = (ROOT / "docs" / "gallery.md").read_text(encoding="utf-8")
    for name in SCENES:
        assert f"`ewr run demos/{name}.toml`" in page, "run: python demos/draw_gallery.py"
        picture = ROOT / "docs" / "pictures" / f"gallery_{name}.png"
        assert picture.is_file() and picture.stat().st_size < 100_000
        assert f"(pictures/{picture.name})" in page
        assert load_scene(ROOT / "demos" / f"{name}.toml").title in page


def test_bodies_with_a_gap_between_are_drawn_apart(monkeypatch):
    """Magnified like the motion; without it the rod's end was drawn in the stop. Pairs are where their nodes are."""
    monkeypatch.syspath_prepend(str(ROOT / "demos"))
    gallery = importlib.import_module("draw_gallery")
    scene = load_scene(ROOT / "demos" / "tapping_rod.toml")
    chain = build_chain(scene)
    solution = solve(pose_problem(scene, chain.reduction.model, chain.interface))
    axes = Figure().subplots()
    gallery.draw_motion(axes, chain, solution)
    bar, stop = (
        np.concatenate([path.vertices for path in body.get_paths()])
        for body in axes.collections
        if isinstance(body, PolyCollection)
    )
    assert bar[:, 0].max() < stop[:, 0].min()
    (dots,) = axes.get_lines()
    x = dots.get_xdata().reshape(2, -1)
    np.testing.assert_allclose([x[0].max(), x[1].min()], [bar[:, 0].max(), stop[:, 0].min()], atol=1e-9)


def test_the_gallery_knows_its_scenes():
    told = {}
    for given in ("--help", "nonsense"):
        command = [sys.executable, str(ROOT / "demos" / "draw_gallery.py"), given]
        environment = dict(os.environ) | {"PYTHONPATH": str(ROOT)}
        told[given] = subprocess.run(command, env=environment, capture_output=True, text=True, check=False)
    assert told["--help"].returncode == 0 and all(name in told["--help"].stdout for name in SCENES)
    assert told["nonsense"].returncode == 2 and "unknown scene: nonsense" in told["nonsense"].stderr


def test_choose_your_effects_runs_and_its_assertions_hold():
    done = subprocess.run(
        [sys.executable, str(ROOT / "demos" / "choose_your_effects.py")],
        env=dict(os.environ) | {"PYTHONPATH": str(ROOT)},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    effects, harmonics = (part.splitlines() for part in done.stdout[done.stdout.index("effects ") :].split("\n\n"))
    assert len(effects) == 11 and effects[1].split()[:2] == ["bonded", "0"]
    unknowns, errors = ([float(line.split()[at]) for line in harmonics[1:4]] for at in (-3, -1))
    assert unknowns[0] > unknowns[1] == unknowns[2] and all(0 < error < 1 for error in errors)


@pytest.mark.parametrize(
    "builder, parameters, message",
    [
        ("two_blocks", {"width": 0.1}, "lower_width = 0.08: expected more than width = 0.1"),
        ("two_blocks", {"pairs": 1}, "pairs = 1: expected at least 2"),
        ("two_blocks", {"height": -1.0}, "height = -1.0: expected a positive number"),
        ("end_contact", {"tip_length": 0.2}, "tip_length = 0.2: expected less than length = 0.2"),
        ("end_contact", {"pairs": 1}, "pairs = 1: expected at least 2"),
        ("lap_joint", {"overlap": 0.01}, "overlap = 0.01: expected between washer"),
        ("lap_joint", {"pairs": 3}, "pairs = 3: expected at least 4"),
        ("platform_damper", {"damper_height": 0.02}, "damper_height = 0.02: expected less than 0.01327, where"),
        ("platform_damper", {"flank_angle": 80.0}, "flank_angle = 80.0: expected degrees from the x direction"),
        ("platform_damper", {"airfoil_thickness": 0.02}, "airfoil_thickness = 0.02: expected less than the shank's"),
        ("platform_damper", {"pairs": 1}, "pairs = 1: expected at least 2"),
        ("damped_ring", {"sectors": 2}, "sectors = 2: expected 3 or more"),
        ("damped_ring", {"sectors": 50}, "hub_radius = 0.15: 50 shanks with 0.02 m between them are"),
        ("damped_ring", {"wedge_height": 0.02}, "wedge_height = 0.02: expected less than 0.01327, where"),
        ("shrouded_ring", {"sectors": 2}, "sectors = 2: expected 3 or more"),
        ("shrouded_ring", {"face_angle": 80.0}, "face_angle = 80.0: expected degrees from the x direction"),
        ("shrouded_ring", {"sectors": 150, "face_angle": 60.0}, "face_angle = 60.0: with 150 sectors"),
        ("shrouded_ring", {"pairs": 1}, "pairs = 1: expected at least 2"),
    ],
)
def test_builders_name_the_parameter_that_makes_no_sense(builder, parameters, message):
    gmsh.initialize(["", "-nopopup"], False)
    try:
        with load_builder(ROOT / "geometry" / f"{builder}.py") as module, pytest.raises(ValueError, match=message):
            module.build(**parameters)
    finally:
        gmsh.finalize()
