"""ParaView itself opens every XDMF file of the default scene and finds every step and array."""

from __future__ import annotations

import json
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

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


@pytest.fixture(scope="module")
def opened(tmp_path_factory):
    """What ParaView found, and the run's own summary."""
    pvbatch = shutil.which("pvbatch")
    assert pvbatch, "the full run needs ParaView: apt-get install --no-install-recommends paraview python3-paraview"
    folder = tmp_path_factory.mktemp("paraview")
    run = [sys.executable, "-m", "ewr_fenicsx", "run", ROOT / "demos" / "blade_root.toml", "--out", folder / "results"]
    subprocess.run(run, check=True, capture_output=True)
    (folder / "inspect.py").write_text(INSPECT)
    done = subprocess.run(
        [pvbatch, folder / "inspect.py", folder / "results", folder / "found.json"],
        capture_output=True,
        text=True,
        timeout=300,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    assert "ERR|" not in done.stderr, done.stderr
    assert "Error" not in done.stderr, done.stderr
    return json.loads((folder / "found.json").read_text()), json.loads(
        (folder / "results" / "summary.json").read_text()
    )


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
