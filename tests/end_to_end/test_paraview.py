"""ParaView itself opens every XDMF file of the default scene, finds every step and array, and draws the motion."""

from __future__ import annotations

import json
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from matplotlib.image import imread

ROOT = Path(__file__).parents[2]
STEPS = 32
CONTACT_FIELDS = ("contact_pressure", "friction_traction", "gap", "slip", "contact_state")

# Runs inside pvbatch, which has a Python of its own.
INSPECT = """
import json, sys
from pathlib import Path
from paraview.simple import WarpByVector, XDMFReader, Xdmf3ReaderS

found = {}
for path in sorted(Path(sys.argv[1]).glob("*.xdmf")):
    reader = Xdmf3ReaderS(FileName=[str(path)])
    reader.UpdatePipelineInformation()
    times = list(reader.TimestepValues)
    entry = found[path.stem] = {"times": times, "ranges": []}
    for time in times or [0.0]:
        reader.UpdatePipeline(time)
        data = reader.GetDataInformation()
        arrays = reader.PointData
        entry["arrays"] = {a.Name: a.GetNumberOfComponents() for a in arrays}
        entry["cell_arrays"] = sorted(a.Name for a in reader.CellData)
        entry["points"], entry["cells"] = data.GetNumberOfPoints(), data.GetNumberOfCells()
        entry["ranges"].append({a.Name: a.GetRange(0) for a in arrays})
    older = XDMFReader(FileNames=[str(path)])  # the other reader that ParaView offers for these files
    older.UpdatePipelineInformation()
    entry["times_of_older_reader"] = list(older.TimestepValues)
    if path.stem == "displacement":
        warp = WarpByVector(Input=reader, Vectors=["POINTS", "displacement"], ScaleFactor=100.0)
        entry["warped"] = []
        for time in times:
            warp.UpdatePipeline(time)
            entry["warped"].append(warp.GetDataInformation().GetBounds())
Path(sys.argv[2]).write_text(json.dumps(found))
"""

# A quarter of the period apart, and coloured by size: what a newcomer sees after Warp By Vector.
RENDER = """
import sys
from pathlib import Path
from paraview.simple import (
    ColorBy, CreateRenderView, GetAnimationScene, Render, SaveScreenshot, Show, WarpByVector, Xdmf3ReaderS
)

folder, pictures = map(Path, sys.argv[1:3])
reader = Xdmf3ReaderS(FileName=[str(folder / "displacement.xdmf")])
reader.UpdatePipelineInformation()
view = CreateRenderView(ViewSize=[900, 1000])
view.OrientationAxesVisibility = 0
view.Background = [1.0, 1.0, 1.0]
view.UseColorPaletteForBackground = 0
warp = WarpByVector(Input=reader, Vectors=["POINTS", "displacement"], ScaleFactor=20.0)
shown = Show(warp, view)
shown.SetRepresentationType("Surface With Edges")
scene = GetAnimationScene()
scene.UpdateAnimationUsingDataTimeSteps()
times = list(reader.TimestepValues)
for name, time in (("first", times[0]), ("later", times[len(times) // 2])):
    scene.AnimationTime = time
    ColorBy(shown, ("POINTS", "displacement", "Magnitude"))
    shown.RescaleTransferFunctionToDataRange(False, True)
    view.ResetCamera()
    Render(view)
    SaveScreenshot(str(pictures / f"{name}.png"), view)
"""


@pytest.fixture(scope="module")
def results(tmp_path_factory):
    """The result folder of the default scene."""
    folder = tmp_path_factory.mktemp("paraview") / "results"
    run = [sys.executable, "-m", "ewr_fenicsx", "run", ROOT / "demos" / "blade_root.toml", "--out", folder]
    subprocess.run(run, check=True, capture_output=True)
    return folder


@pytest.fixture(scope="module")
def opened(results, tmp_path_factory):
    """What ParaView found, and the run's own summary."""
    folder = tmp_path_factory.mktemp("inspect")
    (folder / "open_files.py").write_text(INSPECT)
    call_paraview("pvbatch", folder / "open_files.py", results, folder / "found.json")
    return json.loads((folder / "found.json").read_text()), json.loads((results / "summary.json").read_text())


def call_paraview(*command: str | Path) -> None:
    for program in (word for word in ("xvfb-run", "pvbatch") if word in command):
        assert shutil.which(program), f"the full run needs {program}: tools/setup.sh full installs it"
    done = subprocess.run(command, capture_output=True, text=True, timeout=300, check=False)
    assert done.returncode == 0, done.stderr
    assert "ERR|" not in done.stderr, done.stderr
    assert "Error" not in done.stderr, done.stderr


@pytest.mark.slow
def test_paraview_finds_every_file_step_and_array(opened):
    found, summary = opened
    assert set(found) == {"displacement", "mesh_tags", *CONTACT_FIELDS}
    for name in ("displacement", *CONTACT_FIELDS):
        assert found[name]["times"] == pytest.approx([k / STEPS / 1000.0 for k in range(STEPS)]), name
        assert found[name]["times_of_older_reader"] == pytest.approx(found[name]["times"])
        assert found[name]["arrays"] == {name: 3 if name == "displacement" else 1}
        assert found[name]["points"] == summary["model"]["nodes"]
        assert found[name]["cells"] == summary["model"]["cells"]
        first = found[name]["ranges"][0][name]
        if name == "contact_state":  # from away from contact to slip, at all times
            assert first == [-1.0, 2.0]
            continue
        assert any(ranges[name] != first for ranges in found[name]["ranges"]), f"{name} does not change over the period"
    assert {"bodies", "boundaries"} <= set(found["mesh_tags"]["cell_arrays"])


@pytest.mark.slow
def test_paraview_warps_the_mesh_by_the_displacement(opened):
    found, summary = opened
    tip = next(abs(complex(a["real"], a["imag"])) for a in summary["solution"]["outputs"]["tip"] if a["harmonic"] == 1)
    swing = max(abs(limit) for ranges in found["displacement"]["ranges"] for limit in ranges["displacement"])
    assert swing == pytest.approx(tip, rel=0.1)
    bounds = found["displacement"]["warped"]
    # a hundredfold, the tip swings far beyond the disk on either side, and no other node goes further
    assert max(box[1] for box in bounds) == pytest.approx(100 * swing, rel=0.1)
    assert min(box[0] for box in bounds) == pytest.approx(-100 * swing, rel=0.1)


@pytest.mark.slow
def test_paraview_draws_the_moving_blade(results, tmp_path, headless):
    """With no display. Blue to red on white; the blade bends to one side, and half a period later to the other."""
    (tmp_path / "render.py").write_text(RENDER)
    call_paraview(*headless, "pvbatch", "--force-offscreen-rendering", tmp_path / "render.py", results, tmp_path)
    middles = []
    for name in ("first", "later"):
        picture = imread(tmp_path / f"{name}.png")[..., :3]
        drawn = (picture < 0.97).any(axis=2)
        assert 0.05 < drawn.mean() < 0.9
        assert picture[drawn].std(axis=0).min() > 0.05, "coloured by the displacement's size"
        rows = np.flatnonzero(drawn.any(axis=1))
        middles.append([np.flatnonzero(drawn[row]).mean() for row in rows[[len(rows) // 20, -len(rows) // 20]]])
    lean = [top - bottom for top, bottom in middles]
    assert lean[0] * lean[1] < 0
    assert min(map(abs, lean)) > 20, "pixels"
