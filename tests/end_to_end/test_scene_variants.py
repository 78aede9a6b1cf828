"""Other scenes than the default one: laws, elements, loads and sources of geometry, each through files."""

from __future__ import annotations

import json
import re
import subprocess
import sys
from dataclasses import dataclass, replace
from pathlib import Path
from types import SimpleNamespace

import gmsh
import h5py
import numpy as np
import pytest
from checked_solutions import find_turns
from matplotlib.figure import Figure
from scene_runs import read_table, run_scene
from small_scenes import BLOCKS, read_demo, write_blocks

from ewr_fenicsx import load_scene, solve
from ewr_fenicsx.cli import main
from ewr_fenicsx.errors import OutputError
from ewr_fenicsx.laws import law_kinds
from ewr_fenicsx.laws.law_kinds import LawKind
from ewr_fenicsx.output.output import check_own_fields
from ewr_fenicsx.response import frequency_sweep, response_curve
from ewr_fenicsx.response.following import Jump
from ewr_fenicsx.runs import study
from ewr_fenicsx.structure.chain import build_chain, pose_problem

ROOT = Path(__file__).parents[2]
ALL_FIELDS = {"contact_pressure", "friction_traction", "gap", "slip", "contact_state"}


@pytest.fixture
def run(tmp_path):
    """Solve a variant of the blocks' scene; returns its summary and the names of its files."""

    def solve_variant(addition: str = "", source: Path = BLOCKS) -> tuple[dict, set[str]]:
        (tmp_path / "scene.toml").write_text(write_blocks(addition, source=source))
        assert main(["run", str(tmp_path / "scene.toml"), "--out", str(tmp_path / "results"), "--overwrite"]) == 0
        summary = json.loads((tmp_path / "results" / "summary.json").read_text())
        assert sorted(path.name for path in (tmp_path / "results").iterdir()) == summary["files"]
        return summary, {Path(name).stem for name in summary["files"] if name.endswith(".xdmf")} - {
            "displacement",
            "mesh_tags",
        }

    return solve_variant


def tip_amplitude(summary: dict, harmonic: int = 1) -> complex:
    return next(a["real"] + 1j * a["imag"] for a in summary["solution"]["outputs"]["tip"] if a["harmonic"] == harmonic)


@pytest.mark.parametrize(
    ("laws", "missing", "linear"),
    [
        ("", set(), False),
        ("normal = 'bonded'\ntangential = 'bonded'", {"gap", "slip", "contact_state"}, True),
        ("normal = 'unilateral'\ntangential = 'bonded'", {"slip"}, False),
        ("normal = 'bonded'\ntangential = 'coulomb'", {"gap"}, False),
        ("initial_gap = 1e-7", set(), False),
    ],
)
def test_laws_decide_which_fields_there_are(run, laws, missing, linear):
    summary, fields = run("[contact]\n" + laws)
    assert fields == ALL_FIELDS - missing
    assert (summary["solution"]["unknowns"] == 0) == linear
    figures = set(summary["solution"]["merit"])
    assert ("penetration" in figures) == ("gap" not in missing) == ("J_N" in figures)
    assert ("friction_dissipation" in figures) == ("slip" not in missing) == ("J_T" in figures)
    assert abs(tip_amplitude(summary)) > 0


def test_quadratic_elements_are_softer_by_little(run):
    linear, _ = run("[contact]\nnormal = 'bonded'\ntangential = 'bonded'")
    quadratic, fields = run("[elasticity]\ndegree = 2\n[contact]\nnormal = 'bonded'\ntangential = 'bonded'")
    assert quadratic["model"]["nodes"] > 3 * linear["model"]["nodes"]
    assert quadratic["model"]["pairs"] == 2 * linear["model"]["pairs"] - 1
    assert 1 < abs(tip_amplitude(quadratic) / tip_amplitude(linear)) < 1.2
    assert fields == ALL_FIELDS - {"gap", "slip", "contact_state"}


def test_mesh_file_gives_the_result_of_its_builder(run, tmp_path):
    built, _ = run()
    gmsh.initialize([], False)
    gmsh.option.setNumber("General.Terminal", 0)
    namespace: dict = {}
    exec(compile(BLOCKS.read_text(), BLOCKS, "exec"), namespace)
    namespace["build"]()
    gmsh.write(str(tmp_path / "blocks.msh"))
    gmsh.finalize()
    read, _ = run(source=tmp_path / "blocks.msh")
    assert tip_amplitude(read) == pytest.approx(tip_amplitude(built), rel=1e-8)


def test_a_mesh_of_second_order_has_values_at_all_its_nodes(run, tmp_path, capsys):
    """What contact does at the nodes between the corners is in the files: every node of the joint is pressed."""
    source = tmp_path / "quadratic.py"
    source.write_text(
        BLOCKS.read_text().replace("mesh.generate(2)", "mesh.generate(2)\n    gmsh.model.mesh.setOrder(2)")
    )
    bonded = "[elasticity]\ndegree = 2\n[contact]\nnormal = 'bonded'\ntangential = 'bonded'"
    straight, _ = run(bonded)
    summary, _ = run(bonded, source)
    assert tip_amplitude(summary) == pytest.approx(tip_amplitude(straight), rel=1e-8)
    with h5py.File(tmp_path / "results" / "contact_pressure.h5") as file:
        place, pressure = file["Mesh/mesh/geometry"][:], file["Function/contact_pressure/0"][:, 0]
    joint = np.isclose(place[:, 1], 0.03)
    assert joint.sum() == 2 * summary["model"]["pairs"] == 2 * 13
    table = read_table(tmp_path / "results" / "pairs.csv")
    x, area = (np.array([row[name] for row in table]) for name in ("x [m]", "area [m^2]"))
    at_pair = np.interp(x, *(values[joint][np.argsort(place[joint, 0])][::2] for values in (place[:, 0], pressure)))
    assert (at_pair * area).sum() == pytest.approx(1000.0, rel=1e-6), "bonds carry the load"

    (tmp_path / "linear.toml").write_text(write_blocks(source=source))
    assert main(["info", str(tmp_path / "linear.toml")]) == 2
    assert "cells of order 2 and the elements are of degree 1" in capsys.readouterr().err


def test_dovetail_knows_nothing_of_fir_trees(tmp_path):
    (tmp_path / "scene.toml").write_text(read_demo("blade_root").replace("fir_tree.py", "dovetail.py"))
    chain = build_chain(load_scene(tmp_path / "scene.toml"))
    assert chain.interface.flanks == ("left", "right")
    assert chain.reduction.full_stick.frequency[0] > 100


def test_rotation_takes_the_place_of_the_axial_pull(tmp_path):
    """The centrifugal force grows with the square of the speed and pulls outwards, along +y."""
    head, tail = read_demo("blade_root").split("[loads.axial_pull]")
    resultants = []
    for speed in (5000, 10000):
        text = (
            head
            + f"[loads.axial_pull]\nkind = 'rotation'\nspeed = {speed}\ncentre = [0.0, 0.0]\n\n[loads.tip_shake]"
            + tail.split("[loads.tip_shake]")[1]
        )
        (tmp_path / "scene.toml").write_text(text)
        scene = load_scene(tmp_path / "scene.toml")
        chain = build_chain(scene)
        solution = solve(pose_problem(scene, chain.reduction.model))
        normal, friction = (solution.history(name, 64).mean(axis=0) for name in ("normal_force", "friction_force"))
        resultants.append(friction @ chain.interface.tangent - normal @ chain.interface.normal)
    assert all(resultant[1] < -1000 for resultant in resultants), "the disk holds the blade back"
    np.testing.assert_allclose(resultants[1][1], 4 * resultants[0][1], rtol=1e-6)


@pytest.mark.parametrize("damping", ["kind = 'rayleigh'\nalpha = 30.0\nbeta = 1e-7", "kind = 'modal'\nratio = 0.01"])
def test_each_form_of_damping_dissipates(run, damping):
    summary, _ = run(f"[contact]\nnormal = 'bonded'\ntangential = 'bonded'\n[damping]\n{damping}")
    merit = summary["solution"]["merit"]
    assert merit["viscous_dissipation"] > 0
    assert merit["excitation_work"] == pytest.approx(merit["viscous_dissipation"], rel=1e-6)


def test_each_flank_has_its_own_laws(tmp_path):
    """A dovetail bonded on its left flank and rubbing on its right one, through files."""
    text = read_demo("blade_root").replace("fir_tree.py", "dovetail.py")
    text += "\n[flanks.left]\nnormal = 'bonded'\ntangential = 'bonded'\n[flanks.right]\nfriction = 0.35\n"
    summary, rows = run_scene(tmp_path, text), read_table(tmp_path / "results" / "pairs.csv")
    flank = {name: [row for row in rows if row["flank"] == name] for name in ("left", "right")}
    assert summary["solution"]["unknowns"] == 2 * len(flank["right"]) * 11, "bonds hold the blade: nothing floats"
    assert {row["stick_share"] for row in flank["left"]} == {1.0}
    assert max(row["sliding_distance [m/cycle]"] for row in flank["left"]) < 1e-15
    assert max(row["sliding_distance [m/cycle]"] for row in flank["right"]) > 1e-8
    assert min(row["normal_force_min [N]"] for row in flank["left"]) < 0, "a bond pulls"


def test_a_static_scene_is_solved_at_rest(tmp_path):
    summary = run_scene(tmp_path, write_blocks().split("[loads.shake]")[0])
    pairs = summary["model"]["pairs"]
    assert summary["solution"]["harmonics"] == [0]
    assert summary["solution"]["unknowns"] == 2 * pairs + 3
    with h5py.File(tmp_path / "results" / "displacement.h5") as file:
        assert len(file["Function"]["displacement"]) == 1
    forces = [row["normal_force_mean [N]"] for row in read_table(tmp_path / "results" / "pairs.csv")]
    assert sum(forces) == pytest.approx(1000.0, rel=1e-9)


def test_a_sweep_writes_its_curve_and_the_fields_at_its_peak(tmp_path, capsys):
    summary = run_scene(tmp_path, write_blocks(frequency="{ from = 2000, to = 6000, points = 5 }"))
    rows = read_table(tmp_path / "results" / "frequency_response.csv")
    assert [row["frequency [Hz]"] for row in rows] == [2000, 3000, 4000, 5000, 6000]
    assert {"frequency_response.csv", "frequency_response.png", "displacement.xdmf"} <= set(summary["files"])
    assert "sweep" in summary["seconds"] and "solve" not in summary["seconds"]
    peak = max(rows, key=lambda row: row["rms_tip"])
    assert summary["solution"]["frequency_Hz"] == peak["frequency [Hz]"]
    assert abs(tip_amplitude(summary)) == pytest.approx(peak["|tip| harmonic 1"], rel=1e-12)
    capsys.readouterr()
    assert main(["info", str(tmp_path / "scene.toml"), "--out", str(tmp_path / "results")]) == 0
    told = next(line for line in capsys.readouterr().out.splitlines() if line.startswith("frequency sweep "))
    spent = summary["seconds"]["sweep"] + summary["seconds"]["stability"]  # which a curve is looked at for
    assert float(told.split()[-1].rstrip("%")) == pytest.approx(100 * spent / sum(summary["seconds"].values()), abs=0.1)


@pytest.mark.parametrize("highest, beyond", [(6000, False), (2500, True)])
def test_a_sweep_that_is_strongest_at_its_end_says_that_the_peak_may_lie_beyond(highest, beyond, tmp_path, capsys):
    run_scene(tmp_path, write_blocks(frequency=f"{{ from = 2000, to = {highest}, points = 5 }}"))
    told = next(line for line in capsys.readouterr().out.splitlines() if line.startswith("strongest"))
    assert (f"at an end of the sweep, beyond which the peak may lie: at {highest} Hz" in told) == beyond


@pytest.fixture
def drawn(monkeypatch):
    """Lines of the pictures drawn: style and ``(n,)`` points along the abscissa, but for bare points."""
    lines: list[tuple[str, list[float]]] = []
    save = Figure.savefig

    def keep(figure, path, **more):
        for line in (line for axes in figure.axes for line in axes.get_lines() if line.get_marker() == "None"):
            lines.append((line.get_linestyle(), list(line.get_xdata())))
        save(figure, path, **more)

    monkeypatch.setattr(Figure, "savefig", keep)
    return lines


def test_a_summary_holds_what_decides_on_the_trust_in_a_curve(tmp_path, monkeypatch, drawn):
    """Missing points and jumps, at which the picture's line ends as well."""
    jump = Jump((3000.0, 4000.0), "no branch led on")

    sweep = frequency_sweep.frequency_response
    broken = lambda *given, **named: replace(sweep(*given, **named), missing=(4500.0,), jumps=(jump,))  # noqa: E731
    monkeypatch.setattr(frequency_sweep, "frequency_response", broken)
    facts = run_scene(tmp_path, write_blocks(frequency="{ from = 2000, to = 6000, points = 5 }"))["sweep"]
    assert facts["missing_Hz"] == [4500.0] and facts["solutions"] == 5
    assert facts["jumps"] == [{"from_Hz": 3000.0, "to_Hz": 4000.0, "why": "no branch led on"}]
    assert ("-", [2000, 3000]) in drawn and ("-", [4000, 5000, 6000]) in drawn
    assert not any({3000, 4000} <= set(points) for _, points in drawn)


@pytest.mark.parametrize("solver", ["harmonics = 1", "accuracy = 0.2"])
def test_the_stability_of_a_sweep_is_looked_at_once(tmp_path, monkeypatch, solver):
    """Most of its time: of what is written in the end, by all ranks and with a bar, not of what is thrown away."""
    looked, find = [], response_curve.FrequencyResponse._find_unstable

    def count(curve, *shared):
        looked.append((len(curve.solutions), bool(curve.accurate), len(shared)))
        return find(curve, *shared)

    monkeypatch.setattr(response_curve.FrequencyResponse, "_find_unstable", count)
    run_scene(tmp_path, write_blocks(frequency="{ from = 2000, to = 6000, points = 3 }", solver=solver))
    assert looked == [(3, solver.startswith("accuracy"), 3)]


def test_a_curve_that_folds_shows_what_is_unstable(tmp_path, drawn):
    """In the table, the summary and the picture; the fields are those of the largest motion that can be seen.

    Past the folds motions in time leave the lower branch as well, at the highest frequencies for good.
    """
    text = read_demo("tapping_rod")
    range_ = "frequency = { from = 6400, to = 6800, points = 5 }"
    summary = run_scene(tmp_path, text.replace("frequency = 6000.0", range_))
    rows = read_table(tmp_path / "results" / "frequency_response.csv")
    frequency, height = (np.array([row[name] for row in rows]) for name in ("frequency [Hz]", "rms_tip"))
    unstable = np.array([row["unstable"] == 1 for row in rows])
    turns = find_turns(frequency)
    assert len(turns) == 2 and unstable[turns[0] + 1 : turns[1]].all()
    assert not unstable[: turns[0] - 1].any() and unstable[-2:].all()
    assert summary["sweep"]["unstable"] == unstable.sum()
    assert summary["solution"]["frequency_Hz"] == frequency[np.where(unstable, 0, height).argmax()]
    dashed = [points for style, points in drawn if style == "--"]
    first = int(unstable.argmax())
    assert first <= turns[0] + 1
    near = np.append(False, unstable) | np.append(unstable, False)  # pieces with an unstable end
    solid = np.flatnonzero(~near[first:])
    last = first + int(solid[0]) - 1 if solid.size else len(rows) - 1  # of those that hang together
    assert last >= turns[1] and dashed[0] == list(frequency[first - 1 : last + 1])


def test_a_bonded_scene_loads_and_runs_nothing_that_it_does_not_call_for(tmp_path):
    """Through files: no sweep, no wear, no ladder that climbs, no SNES."""
    (tmp_path / "scene.toml").write_text(write_blocks("[contact]\nnormal = 'bonded'\ntangential = 'bonded'"))
    script = (
        "import sys; import ewr_fenicsx.solver.snes as snes, ewr_fenicsx.solver.newton as newton\n"
        "def fail(*_, **__): raise AssertionError('a linear scene needs no Newton')\n"
        "snes.run_newton = newton.run_newton = newton.climb = fail\n"
        "from ewr_fenicsx.cli import main\n"
        f"code = main(['run', {str(tmp_path / 'scene.toml')!r}, '--out', {str(tmp_path / 'results')!r}])\n"
        "print(code, *sorted(name for name in sys.modules if name.startswith('ewr_fenicsx.')))"
    )
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=False, cwd=ROOT)
    assert done.returncode == 0, done.stderr
    code, *loaded = done.stdout.splitlines()[-1].split()
    loaded = {name.split(".")[-1] for name in loaded}
    assert code == "0" and "output" in loaded
    assert not loaded & {"wear", "wear_store", "archard", "frequency_sweep", "following", "time_integration", "effects"}


def test_a_law_of_the_user_s_own_through_files(run, tmp_path, capsys):
    """The recipe of docs/adding_a_law.md beside a scene: its fields are written, its cost is told."""
    recipe = (ROOT / "docs" / "adding_a_law.md").read_text(encoding="utf-8")
    code = re.search(r"```python\n(.*?)```", recipe, re.DOTALL).group(1)
    (tmp_path / "slider.py").write_text(code.replace('"jenkins"', '"spring_slider"'))
    law = "law_files = ['slider.py']\ntangential = 'spring_slider'\nparameters = { spring = 1e7, limit = 3.0 }\n"
    summary, fields = run("[contact]\n" + law)
    assert fields == ALL_FIELDS | {"slider_velocity"}
    pairs = summary["model"]["pairs"]
    assert summary["solution"]["unknowns"] == 2 * pairs * 7 + 3
    rows = read_table(tmp_path / "results" / "pairs.csv")
    assert max(abs(row["friction_force_max [N]"]) for row in rows) < 3.0 * 1.5
    assert max(row["slider_velocity_max"] for row in rows) > 0
    capsys.readouterr()
    assert main(["info", str(tmp_path / "scene.toml"), "--out", str(tmp_path / "results")]) == 0
    lines = {line.split("  ")[0]: line for line in capsys.readouterr().out.splitlines()}
    assert "a law registered outside the package" in lines["Jenkins"] and str(7 * pairs) in lines["Jenkins"]
    shares = [float(line.split()[-1].rstrip("%")) for line in lines.values() if line.rstrip().endswith("%")]
    assert len(shares) == 3, "separation, the law and the floating body share the solve"
    solve_share = summary["seconds"]["solve"] / sum(summary["seconds"].values())
    assert sum(shares) == pytest.approx(100 * solve_share, abs=0.2)


@pytest.mark.parametrize(
    "name, why",
    [
        ("displacement", "result folders have a file of that name; give another"),
        ("contact_pressure", "result folders have a file of that name; give another"),
        ("worn_gap", "result folders have a file of that name; give another"),
        ("slider/velocity", "no file can have that name; give another"),
        ("", "no file can have that name; give another"),
    ],
)
def test_what_a_law_reports_takes_no_other_file_s_place(name, why, tmp_path, capsys, monkeypatch):
    """The displacement of all nodes was replaced by what some pairs report, without a word."""
    monkeypatch.setattr(study, "solve", None)  # it is told before any work
    monkeypatch.setattr(law_kinds, "_KINDS", dict(law_kinds._KINDS))  # to be forgotten again
    recipe = (ROOT / "docs" / "adding_a_law.md").read_text(encoding="utf-8")
    code = re.search(r"```python\n(.*?)```", recipe, re.DOTALL).group(1).replace("slider_velocity", name)
    (tmp_path / "slider.py").write_text(code.replace('"jenkins"', '"named_slider"'))
    laws = "law_files = ['slider.py']\ntangential = 'named_slider'\nparameters = { spring = 1e7, limit = 3.0 }\n"
    wears = "[wear]\n" if name == "worn_gap" else ""  # no other folder has that
    (tmp_path / "scene.toml").write_text(write_blocks(f"{wears}[contact]\n{laws}"))
    assert main(["run", str(tmp_path / "scene.toml"), "--out", str(tmp_path / "results")]) == 2
    assert f'Jenkins.histories: "{name}": {why}' in capsys.readouterr().err
    assert not (tmp_path / "results").exists()


def test_what_a_law_does_not_report_is_told_before_any_solve(tmp_path, capsys, monkeypatch):
    """A slip of the pen in its kind's histories was told when the results were written, and the solution lost."""
    monkeypatch.setattr(study, "solve", None)
    monkeypatch.setattr(law_kinds, "_KINDS", dict(law_kinds._KINDS))  # to be forgotten again
    recipe = (ROOT / "docs" / "adding_a_law.md").read_text(encoding="utf-8")
    code = re.search(r"```python\n(.*?)```", recipe, re.DOTALL).group(1).replace('"slider_velocity"', '"slider"', 1)
    (tmp_path / "slider.py").write_text(code.replace('"jenkins"', '"silent_slider"'))
    laws = "law_files = ['slider.py']\ntangential = 'silent_slider'\nparameters = { spring = 1e7, limit = 3.0 }\n"
    (tmp_path / "scene.toml").write_text(write_blocks(f"[contact]\n{laws}"))
    assert main(["run", str(tmp_path / "scene.toml"), "--out", str(tmp_path / "results")]) == 2
    assert 'a kind names "slider" in its histories, and no law of it reports that' in capsys.readouterr().err


def test_fields_of_wear_leave_their_names_free_where_nothing_wears():
    """A law's own were refused all the same."""

    @dataclass(frozen=True)
    class Reporting(LawKind):
        histories = ("J_T", "second_mean_pressure")

    problem = SimpleNamespace(groups=[(None, SimpleNamespace(kinds=(Reporting(),)))], wear=None)
    check_own_fields(problem, wears=False)
    for worn, wears in ((problem, True), (SimpleNamespace(groups=problem.groups, wear=np.zeros(1)), False)):
        with pytest.raises(OutputError, match=r'Reporting\.histories: "J_T": result folders have a file'):
            check_own_fields(worn, wears=wears)


def test_a_phase_is_in_degrees(tmp_path):
    """A quarter of a period later, and everything else is the same."""
    outputs = []
    for phase in (0.0, 90.0):
        text = write_blocks().replace("harmonic = 1\n", f"harmonic = 1\nphase = {phase}\n")
        (tmp_path / "scene.toml").write_text(text)
        scene = load_scene(tmp_path / "scene.toml")
        problem = pose_problem(scene, build_chain(scene).reduction.model)
        outputs.append(solve(problem, tolerance=1e-12).output("tip"))
    assert abs(outputs[0][1]) > 0
    np.testing.assert_allclose(outputs[1], 1j ** np.arange(4) * outputs[0], atol=1e-8 * abs(outputs[0][1]))


def test_a_geometry_in_millimetres_is_told_of(tmp_path, capsys):
    in_mm = "width = 40.0, blade_height = 60.0, disk_height = 30.0"
    (tmp_path / "scene.toml").write_text(write_blocks(parameters=in_mm))
    assert main(["info", str(tmp_path / "scene.toml")]) == 0
    assert "ewr: warning: scene" in (told := capsys.readouterr().err)
    assert "geometry: the mesh is 90 m long; lengths are in m: were mm meant?" in told


def test_a_frequency_above_the_modes_kept_is_told_of(tmp_path, capsys):
    (tmp_path / "scene.toml").write_text(write_blocks("[reduction]\nmodes = 3", frequency=200_000.0))
    assert main(["info", str(tmp_path / "scene.toml")]) == 0
    assert "the load shake acts at 200000 Hz, above the highest of 3 modes kept" in capsys.readouterr().err


def test_a_frequency_in_kilohertz_is_told_of(tmp_path, capsys):
    (tmp_path / "scene.toml").write_text(write_blocks(frequency=3.5))
    assert main(["info", str(tmp_path / "scene.toml")]) == 0
    assert "excitation.frequency = 3.5 Hz is so far below the first full-stick mode" in capsys.readouterr().err


@pytest.mark.parametrize("solver", ["harmonics = 0", "accuracy = 0.01"])
def test_interference_needs_no_load(tmp_path, solver):
    """A block that cannot get wider, pressed on one that hardly gives: E w delta / h, over a thickness of one."""
    E, width, height, overlap = 100e9, 40e-3, 60e-3, 2e-6
    (tmp_path / "scene.toml").write_text(f"""
geometry = {{ source = "{ROOT / "geometry" / "two_blocks.py"}", parameters = {{ width = {width}, height = {height} }} }}
supports = {{ clamp = ["clamp", "top"] }}
contact = {{ body_a = "upper", body_b = "lower", tangential = "frictionless", initial_gap = {-overlap} }}
elasticity = {{ thickness = 1.0 }}
solver = {{ {solver} }}

[materials]
upper = {{ young = {E}, poisson = 0.0, density = 4000.0 }}
lower = {{ young = {1e6 * E}, poisson = 0.0, density = 4000.0 }}
""")
    chain = build_chain(load_scene(tmp_path / "scene.toml"))
    solution = solve(pose_problem(chain.scene, chain.reduction.model))
    pressure = solution.pair_forces["normal"][0].real
    assert pressure.sum() == pytest.approx(E * width * overlap / height, rel=1e-5)
    assert pressure.min() > 0
    assert main(["run", str(tmp_path / "scene.toml"), "--out", str(tmp_path / "results")]) == 0


@pytest.mark.parametrize("static_friction", ["resolved", "held"])
def test_interference_pushes_a_body_away_that_nothing_holds(tmp_path, capsys, static_friction):
    """No load is left to carry, so that nothing walks; and at rest nothing is truncated.

    Where friction holds pairs as they are pushed apart, it hangs on rounding whether the one or other is left touching.
    """
    (tmp_path / "scene.toml").write_text(f"""
geometry = {{ source = "{ROOT / "geometry" / "dovetail.py"}", parameters = {{ pairs = 4, mesh_size = 4e-3 }} }}
contact = {{ friction = 0.3, static_friction = "{static_friction}", initial_gap = -1e-5 }}
""")
    code = main(["run", str(tmp_path / "scene.toml"), "--out", str(tmp_path / "results")])
    told, why = capsys.readouterr()
    if code and static_friction == "held":
        assert code == 3 and "Nothing presses pairs 0, 1, 2 and 5 more" in why and "may lie anywhere" in why
        return
    assert code == 0 and "at rest: converged" in told and "truncation" not in told and "walk" not in told
    forces = np.array([row["normal_force_mean [N]"] for row in read_table(tmp_path / "results" / "pairs.csv")])
    assert np.abs(forces).max() < 1e-3
