"""``mpirun -n 2 ewr run``: the figures of one rank, and one message when anything fails."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from scene_runs import read_table
from small_scenes import read_demo

from ewr_fenicsx import load_scene
from ewr_fenicsx.output.result_folder import hold_target
from ewr_fenicsx.runs.study import run_study
from ewr_fenicsx.structure.chain import build_chain

ROOT = Path(__file__).parents[2]
SCENE = ROOT / "demos" / "blade_root.toml"
pytestmark = pytest.mark.parallel


def read_pairs(folder: Path) -> dict[str, np.ndarray]:
    rows = read_table(folder / "pairs.csv")
    return {key: np.array([row[key] for row in rows]) for key in rows[0]}


def test_two_ranks_give_the_figures_of_one(mpirun, tmp_path):
    for ranks in (1, 2):
        done = mpirun(ranks, "ewr", "run", SCENE, "--out", tmp_path / str(ranks))
        assert done.returncode == 0, done.stderr
        assert done.stdout.count("converged") == 1, "only rank 0 speaks"
        assert done.stderr.count("reduction ") == 1
    one, two = (json.loads((tmp_path / str(ranks) / "summary.json").read_text()) for ranks in (1, 2))
    assert (one["ranks"], two["ranks"]) == (1, 2)
    assert len(two["peak_memory_MB"]) == 2
    assert one["files"] == two["files"]
    for key in ("nodes", "cells", "pairs", "coordinates", "smallest_scaled_jacobian"):
        assert one["model"][key] == two["model"][key]
    for key in ("full_stick_frequencies_Hz", "fixed_interface_frequencies_Hz"):
        np.testing.assert_allclose(two["model"][key], one["model"][key], rtol=1e-8)
    amplitudes = [[complex(a["real"], a["imag"]) for a in s["solution"]["outputs"]["tip"]] for s in (one, two)]
    np.testing.assert_allclose(amplitudes[1], amplitudes[0], atol=1e-8 * np.abs(amplitudes[0]).max())
    for name in (
        "excitation_work",
        "viscous_dissipation",
        "friction_dissipation",
        "J_T",
        "J_N",
        "rms_tip",
        "largest_normal_force",
    ):
        assert two["solution"]["merit"][name] == pytest.approx(one["solution"]["merit"][name], rel=1e-8), name
    compare_pairs(*(read_pairs(tmp_path / str(ranks)) for ranks in (1, 2)))


def compare_pairs(one: dict[str, np.ndarray], two: dict[str, np.ndarray]) -> None:
    assert list(one) == list(two)
    assert one["flank"].tolist() == two["flank"].tolist()
    kinds = {
        kind: max(np.abs(v).max() for k, v in one.items() if k.startswith(kind))
        for kind in ("normal_force", "friction_force", "gap", "slip")
    }
    for key in one.keys() - {"flank"}:
        if key.endswith("_share"):  # counts of samples: one sample may fall on the other side of a switch
            np.testing.assert_allclose(two[key], one[key], atol=1.5 / 1024, err_msg=key)
        else:
            scale = next((size for kind, size in kinds.items() if key.startswith(kind)), np.abs(one[key]).max())
            np.testing.assert_allclose(two[key], one[key], atol=1e-8 * scale, err_msg=key)


def test_mistake_that_all_ranks_meet_is_told_once(mpirun, tmp_path):
    (tmp_path / "scene.toml").write_text("titel = 'x'")
    done = mpirun(2, "ewr", "run", "scene.toml", timeout=60)
    assert done.returncode == 2
    assert done.stderr.count('did you mean "title"?') == 1
    assert "Traceback" not in done.stderr


def test_mistake_that_one_rank_meets_stops_all(mpirun, tmp_path):
    """Rank 1 fails while rank 0 waits for it: this must end, with one message and the error's exit code."""
    for failing in (0, 1):
        (tmp_path / "script.py").write_text(
            "import sys\n"
            "from mpi4py import MPI\n"
            "from ewr_fenicsx.cli import stop_together\n"
            "from ewr_fenicsx.errors import MeshError\n"
            "def work():\n"
            f"    if MPI.COMM_WORLD.rank == {failing}:\n"
            "        raise MeshError('the mesh is torn')\n"
            "    MPI.COMM_WORLD.barrier()\n"
            "    return 0\n"
            "sys.exit(stop_together(MPI.COMM_WORLD, work))\n"
        )
        done = mpirun(2, "python", "script.py", timeout=60)
        assert done.returncode == 2, done.stderr
        assert done.stderr.count("ewr: the mesh is torn") == 1
        assert "Traceback" not in done.stderr


def test_bug_on_one_rank_stops_all_with_its_traceback(mpirun, tmp_path):
    (tmp_path / "script.py").write_text(
        "import sys\n"
        "from mpi4py import MPI\n"
        "from ewr_fenicsx.cli import stop_together\n"
        "def work():\n"
        "    if MPI.COMM_WORLD.rank == 1:\n"
        "        raise ZeroDivisionError('a bug')\n"
        "    MPI.COMM_WORLD.barrier()\n"
        "    return 0\n"
        "sys.exit(stop_together(MPI.COMM_WORLD, work))\n"
    )
    done = mpirun(2, "python", "script.py", timeout=60)
    assert done.returncode == 1
    assert done.stderr.count("ZeroDivisionError: a bug") == 1


def test_taken_folder_is_kept_by_all_ranks(mpirun, tmp_path):
    (tmp_path / "results").mkdir()
    (tmp_path / "results" / "notes.txt").write_text("mine")
    done = mpirun(2, "ewr", "run", SCENE, "--out", "results", timeout=60)
    assert done.returncode == 2
    assert done.stderr.count("--overwrite") == 1
    assert [path.name for path in tmp_path.iterdir()] == ["results"]
    assert (tmp_path / "results" / "notes.txt").read_text() == "mine"


def test_a_folder_that_another_run_writes_to_is_refused_by_all_ranks(mpirun, tmp_path):
    with hold_target(tmp_path / "results"):
        done = mpirun(2, "ewr", "run", SCENE, "--out", "results", timeout=60)
    assert done.returncode == 2
    assert done.stderr.count("ewr: another run writes to results; wait for it, or give another --out") == 1
    assert "Traceback" not in done.stderr
    assert list(tmp_path.iterdir()) == []


def test_an_interrupted_sweep_goes_on(mpirun, tmp_path):
    """Ranks that share the mesh round differently from run to run: the work goes on with the model it began with."""
    text = read_demo("dovetail")
    text = text.split("[wear]")[0].replace("wear = 1e-12", "").replace("force = [80.0", "force = [20.0")
    text = text.replace("frequency = 1400.0", "frequency = { from = 1200, to = 1500, points = 16 }")
    text += "[solver]\nharmonics = 1\n"
    (tmp_path / "scene.toml").write_text(text)
    (tmp_path / "script.py").write_text(
        "import sys\n"
        "from ewr_fenicsx.output import output\n"
        "from ewr_fenicsx.response import frequency_sweep\n"
        "from ewr_fenicsx.cli import main\n"
        "solve, last = frequency_sweep._solve_block, int(sys.argv[2])\n"
        "def stop(follower, block, store):\n"
        "    if block.number == last:\n"
        "        raise KeyboardInterrupt\n"
        "    return solve(follower, block, store)\n"
        "def write_curve(folder, chain, solution, write_more, **more):\n"
        "    folder.mkdir(exist_ok=True)\n"
        "    write_more(folder)\n"
        "    return ()\n"
        "frequency_sweep._solve_block, output.write_results = stop, write_curve\n"
        "sys.exit(main(['run', 'scene.toml', '--out', sys.argv[1]]))\n"
    )
    done = mpirun(2, "python", "script.py", "results", "2")
    partial = tmp_path / "results.partial"
    assert done.returncode == 130 and "the work so far is in results.partial" in done.stderr, done.stderr
    kept = {path.name for path in (partial / "blocks").glob("*.h5")}
    assert kept and "000_0002.h5" not in kept
    done = mpirun(2, "python", "script.py", "results", "-1")
    assert done.returncode == 0 and done.stderr.count("found interrupted work in results.partial") == 1, done.stderr
    assert not partial.exists()
    rows = read_table(tmp_path / "results" / "frequency_response.csv")
    table = [[row["frequency [Hz]"], row["rms_tip"]] for row in rows]
    assert len(table) == 16
    frequencies, alone = run_study(build_chain(load_scene(tmp_path / "scene.toml"))).curve
    np.testing.assert_allclose(np.transpose(table), [frequencies, alone], rtol=1e-6)
