"""What docs/how_to.md says holds: its script reads the matrices of another code and finds the same motion."""

from __future__ import annotations

import re
import tomllib
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import scipy.io
import scipy.sparse
from small_models import dovetail
from small_scenes import read_demo
from sparse_matrices import to_scipy

from ewr_fenicsx import ContactLaws, ContactProblem, Scene, evolve_wear, integrate, load_scene, solve
from ewr_fenicsx.errors import SceneError
from ewr_fenicsx.structure.chain import build_chain, pose_problem

ROOT = Path(__file__).parents[2]
PAGE = (ROOT / "docs" / "how_to.md").read_text(encoding="utf-8")
SCRIPT, READER, ELEMENTS, MESHES, RING, MISTUNED, PRESSED, LOADS, WORN, DOWN, ACCURACY, TRANSIENT, WATCH = re.findall(
    r"^```python\n(.*?)^```", PAGE, flags=re.MULTILINE | re.DOTALL
)
SOLIDS, HALF, CYCLIC = re.findall(r"^```toml\n(.*?)^```", PAGE, flags=re.MULTILINE | re.DOTALL)


@pytest.fixture(scope="module", params=["force", "rotation"])
def blocks(request, tmp_path_factory):
    """Two blocks, with the damping of the page's script; pressed at the top, or by a load on every node."""
    press = 'boundary = "top"\nforce = [0.0, -1000.0]'
    spin = 'kind = "rotation"\nspeed = 300.0\ncentre = [0.0, 10.0]'
    path = tmp_path_factory.mktemp("blocks") / "blocks.toml"
    text = read_demo("two_blocks") + '\n[damping]\nkind = "rayleigh"\nalpha = 5.0\nbeta = 1e-7\n'
    assert press in text
    path.write_text(text.replace(press, spin) if request.param == "rotation" else text, encoding="utf-8")
    return build_chain(load_scene(path))


@pytest.fixture
def exported(blocks, tmp_path, monkeypatch):
    """The blocks' matrices, pairs and loads in the files that the script reads, as another code would write them."""
    monkeypatch.chdir(tmp_path)
    structure, interface = blocks.structure, blocks.interface
    free = np.setdiff1d(np.arange(structure.mass.getSize()[0]), structure.fixed_dofs)
    row_of = {int(dof): row for row, dof in enumerate(free)}
    matrices = {"M.mtx": structure.mass, "K.mtx": structure.stiffness}
    for name, matrix in matrices.items():
        scipy.io.mmwrite(name, to_scipy(matrix)[free][:, free])
    nodes = zip(interface.nodes_a, interface.nodes_b, strict=True)
    joined = [[row_of[2 * int(a)], row_of[2 * int(b)]] for a, b in nodes]
    np.savetxt("pairs.csv", np.column_stack([joined, interface.normal, interface.area]), delimiter=",", header="a")
    loads = {load.harmonic: load.amplitude.real * load.vector.array[free] for load in structure.loads}
    columns = [loads[0], loads[1], structure.outputs["top"].array[free]]
    np.savetxt("loads.csv", np.column_stack(columns), delimiter=",", header="static, shaking, followed")
    return free


def test_elements_behind_springs_move_as_in_time(capsys):
    """The slider slips and the stop is hit."""
    names: dict = {}
    exec(compile(ELEMENTS, "docs/how_to.md", "exec"), names)
    solution = names["solution"]
    assert "estimated error" in capsys.readouterr().out and not solution.short
    assert solution.estimated_error < 0.01
    assert solution.history("normal_force", 256)[:, 1].max() > 100.0 and solution.merit["friction_dissipation"] > 0.1
    steady = integrate(solution.problem, "rest", 3200, 200, tolerance=1e-7)
    assert steady.converged
    assert abs(solution.output("x")[1] - steady.output("x")[1]) < 0.01 * abs(steady.output("x")[1])


def test_a_sector_of_a_ring_moves_as_all_of_them_in_time(capsys):
    names: dict = {}
    exec(compile(RING, "docs/how_to.md", "exec"), names)
    solution, in_time = names["solution"], names["in_time"]
    assert "no deviation grows much" in capsys.readouterr().out and solution.ring_growth.factor < 1.0
    assert solution.merit["friction_dissipation"] > 0.01
    assert in_time.converged and solution.estimated_error < 1e-3
    amplitudes = np.array([in_time.output(f"blade_{j}")[1] for j in range(12)])
    expected = solution.output("blade")[1] * np.exp(-2j * np.pi * 3 / 12 * np.arange(12))
    np.testing.assert_allclose(amplitudes, expected, atol=2e-3 * abs(expected[0]))


def test_blades_that_are_not_alike_move_more_and_less_so_with_friction(capsys):
    """Without friction, against the chain of springs and masses written out."""
    names: dict = {}
    exec(compile(RING.split("laws =")[0] + MISTUNED, "docs/how_to.md", "exec"), names)
    frictionless, rubbed = (float(line.split("moves ")[1].split()[0]) for line in capsys.readouterr().out.splitlines())
    blades = 1e5 * (1 + np.random.default_rng(1).normal(0.0, 0.02, 12))
    dampers = np.full(12, 2e-5 * 1e5)
    peaks = [largest_blade(np.full(12, 1e5), dampers), largest_blade(blades, dampers)]
    assert frictionless == pytest.approx(peaks[1] / peaks[0], abs=0.006)
    assert frictionless > 1.2 and 1.0 < rubbed < frictionless - 0.05


def largest_blade(stiffness: np.ndarray, damping: np.ndarray) -> float:
    """Largest amplitude of twelve blades from 105 to 125 Hz [m], on rims joined by both cuts' springs in series."""
    count, rim, between, largest = 12, 2e6, 4e6 / 2, 0.0
    turn = np.roll(np.eye(count), 1, axis=1)
    joined = 2 * np.eye(count) - turn - turn.T
    for frequency in np.linspace(105.0, 125.0, 41):
        w = 2 * np.pi * frequency
        blade, ground, neighbour = stiffness + 1j * w * damping, rim * (1 + 2e-5j * w), between * (1 + 2e-5j * w)
        impedance = np.block(
            [
                [np.diag(blade - 0.2 * w**2), -np.diag(blade)],
                [-np.diag(blade), np.diag(blade + ground - 2.0 * w**2) + neighbour * joined],
            ]
        )
        load = np.concatenate([40.0 * np.exp(-2j * np.pi * 3 / count * np.arange(count)), np.zeros(count)])
        largest = max(largest, abs(np.linalg.solve(impedance, load)[:count]).max())
    return largest


def test_the_page_shows_the_rings_of_the_demos():
    shown, dampers = (load_scene(ROOT / "demos" / f"{name}.toml").cyclic for name in ("bladed_disk", "damped_ring"))
    assert tomllib.loads(CYCLIC)["cyclic"] == {key: getattr(shown, key) for key in tomllib.loads(CYCLIC)["cyclic"]}
    ((name, both),) = dampers.flanks.items()
    assert f'flanks = {{ {name} = ["{both[0]}", "{both[1]}"] }}' in PAGE


def test_interference_is_enough_or_too_little(capsys):
    exec(compile(PRESSED, "docs/how_to.md", "exec"), {})
    enough, too_little = (float(line.split("by ")[1].split()[0]) for line in capsys.readouterr().out.splitlines())
    assert too_little > 100 * enough > 0


def test_a_scene_is_changed_in_python_as_its_file_would_be(tmp_path, capsys):
    names: dict = {}
    exec(compile(MESHES, "docs/how_to.md", "exec"), names)
    coarse, fine, curved = (float(line.split(": ")[1].split()[0]) for line in capsys.readouterr().out.splitlines())
    assert coarse < fine < curved
    changed = 'lap_joint.py"\nparameters.mesh_size = 4e-3\n[elasticity]\ndegree = 2\n'
    path = tmp_path / "lap.toml"
    path.write_text(read_demo("bolted_lap").replace('lap_joint.py"\n', changed), encoding="utf-8")
    assert names["changed"].model_dump() == load_scene(path).model_dump()
    with pytest.raises(SceneError, match="mesh_sise"):
        Scene(**names["scene"] | {"geometry": {"source": "a.py", "mesh_sise": 1}})


def test_a_worn_joint_is_swept_and_worn_on(capsys):
    """Softer than the new one; it moves as the last cycle of its wear did, and wears on from the same depth."""
    names: dict = {}
    exec(compile(WORN, "docs/how_to.md", "exec"), names)
    assert "µm, then" in capsys.readouterr().out
    new, worn = (names["curves"][name] for name in ("new", "worn"))
    assert worn.figure("rms_tip")[0] > 1.1 * new.figure("rms_tip")[0]
    again = solve(replace(names["joint"], wear=names["worn"]))
    assert worn.figure("rms_tip")[2] == pytest.approx(again.merit["rms_tip"], rel=1e-6)
    assert np.array_equal(names["later"].depth[0], names["worn"])
    assert names["later"].depth[-1].max() > 1.2 * names["worn"].max()


def test_a_cycle_wears_away_the_coefficient_times_the_work_of_friction_over_its_own():
    problem = ContactProblem(dovetail(), ContactLaws(friction=0.2), 300.0, harmonics=15)
    worn = evolve_wear(problem, cycles=1, coefficient=2e-14, progress=False).depth[-1] @ problem.model.pair_area
    assert worn == pytest.approx(2e-14 * solve(problem).merit["friction_dissipation"] / 0.2, rel=0.02)


def test_a_solve_tells_what_it_is_about(caplog):
    caplog.set_level("INFO", "ewr_fenicsx")  # put back at the end
    exec(compile(WATCH, "docs/how_to.md", "exec"), {})
    solution = solve(ContactProblem(dovetail(), ContactLaws(), 300.0), accuracy=0.01)
    last = [message for message in caplog.messages if "estimated error" in message][-1]
    found = f"estimated error {solution.estimated_error:.1g} of 0.01 asked"
    assert last == f"harmonics up to {solution.orders[-1]}: {found}"


def test_up_and_down_find_two_motions(capsys):
    """The stiffening stop bends the peak to higher frequencies; beside the fold both sweeps find the same."""
    names: dict = {}
    exec(compile(DOWN, "docs/how_to.md", "exec"), names)
    both, size = names["both"], names["size"]
    assert "two motions at" in capsys.readouterr().out and len(both) > 3 and np.all(np.diff(both) == 1.0)
    for beside in (both[0] - 2, both[-1] + 2):
        assert size["up", beside] == pytest.approx(size["down", beside], rel=1e-5)


def test_matrices_of_another_code_give_the_motion_of_the_scene(exported, blocks, capsys):
    """To what either reduction, with modes and residual vectors of its own, leaves out."""
    names: dict = {}
    exec(compile(SCRIPT, "docs/how_to.md", "exec"), names)
    assert "converged" in capsys.readouterr().out and Path("model.h5").is_file()
    found, expected = names["solution"], solve(pose_problem(blocks.scene, blocks.reduction.model))
    assert found.orders == expected.orders
    np.testing.assert_allclose(
        found.output("followed"), expected.output("top"), atol=1e-3 * abs(expected.output("top")).max()
    )
    assert found.merit["largest_normal_force"] == pytest.approx(expected.merit["largest_normal_force"], rel=1e-2)


@pytest.mark.parametrize("rows", [lambda row: row + 1, lambda row: row // 2], ids=["from 1", "nodes"])
def test_other_rows_than_those_of_u_x_are_refused(rows, exported):
    """As where rows are counted from 1, or are numbers of nodes: the joint would be another one."""
    pairs = np.loadtxt("pairs.csv", delimiter=",", skiprows=1)
    pairs[:, :2] = rows(pairs[:, :2])
    np.savetxt("pairs.csv", pairs, delimiter=",", header="a")
    with pytest.raises(AssertionError, match=r"pairs\.csv"):
        exec(compile(SCRIPT, "docs/how_to.md", "exec"), {})


def test_a_joint_of_one_pair_is_read(tmp_path, monkeypatch):
    """One row of a file is a table as well: two masses on springs, pressed together by 10 N."""
    monkeypatch.chdir(tmp_path)
    scipy.io.mmwrite("M.mtx", scipy.sparse.identity(80, format="coo"))
    scipy.io.mmwrite("K.mtx", scipy.sparse.diags(1e8 * (1 + np.arange(80))).tocoo())
    Path("pairs.csv").write_text("a, b, n_x, n_y, area\n0, 2, 0.0, -1.0, 1e-4\n")
    loads = np.zeros((80, 3))
    loads[1, 0], loads[0, 1], loads[0, 2] = -10.0, 1.0, 1.0
    np.savetxt("loads.csv", loads, delimiter=",", header="static, shaking, followed")
    names: dict = {}
    exec(compile(SCRIPT, "docs/how_to.md", "exec"), names)
    # the spring of the other mass, of 4e8 N/m, takes 4/6 of the push
    assert names["solution"].history("normal_force").mean() == pytest.approx(10 * 4 / 6, rel=1e-6)


@pytest.mark.parametrize("halves", ["one triangle", "both triangles"])
def test_abaqus_matrices_are_read(halves, tmp_path):
    rng = np.random.default_rng(1)
    matrix = rng.normal(size=(6, 6))
    matrix += matrix.T
    labels = [(node, dof) for node in (11, 7, 30) for dof in (1, 2)]
    lines = [(*labels[i], *labels[j], matrix[i, j]) for i in range(6) for j in range(6) if halves[0] == "b" or j <= i]
    np.savetxt(tmp_path / "JOB_STIF1.mtx", lines, delimiter=",", fmt=["%d", "%d", "%d", "%d", "%.17g"])
    free = [0, 1, 3, 5]
    row_of = {labels[i]: row for row, i in enumerate(free)}
    names = {"np": np}
    exec(compile(READER, "docs/how_to.md", "exec"), names)
    read = names["read_abaqus"](tmp_path / "JOB_STIF1.mtx", row_of).toarray()
    np.testing.assert_array_equal(read, matrix[np.ix_(free, free)])


def test_what_the_page_names_exists():
    for name in re.findall(r"\]\(([\w./]+)", PAGE):
        assert (ROOT / "docs" / name).is_file(), name
    for name in [*re.findall(r"`((?:geometry|demos)/[\w./]+)`", PAGE), "CITATION.cff"]:
        assert (ROOT / name).is_file(), name
    readme = (ROOT / "README.md").read_text(encoding="utf-8")
    headings = [re.sub(r"[^\w -]", "", h).lower().replace(" ", "-") for h in re.findall(r"^## (.+)$", PAGE, re.M)]
    linked = re.findall(r"how_to\.md#([\w-]+)", readme)
    assert linked == headings


def run_at_home(script: str, monkeypatch) -> dict:
    """Names that a script leaves, run where its scenes are."""
    monkeypatch.chdir(ROOT)
    names: dict = {}
    exec(compile(script, "docs/how_to.md", "exec"), names)
    return names


def test_a_damper_pressed_harder_than_best_damps_less(capsys, monkeypatch):
    run_at_home(LOADS.replace("800.0, 31)", "800.0, 7)"), monkeypatch)
    told = re.findall(r"^(\d+) N: peak ([.\d]+) mm at [.\d]+ Hz$", capsys.readouterr().out, flags=re.MULTILINE)
    assert [force for force, _ in told] == ["100", "300", "1000"]
    peaks = [float(peak) for _, peak in told]
    assert peaks == sorted(peaks) and peaks[-1] > 2 * peaks[0]


def test_an_accuracy_is_reached_and_told(capsys, monkeypatch):
    names = run_at_home(ACCURACY, monkeypatch)
    assert "estimated error 0.00" in capsys.readouterr().out
    assert names["solution"].estimated_error <= 0.01 and names["solution"].short == ""
    exact = abs(solve(replace(names["problem"], harmonics=31)).output("tip")[1])
    assert abs(names["solution"].output("tip")[1]) == pytest.approx(exact, rel=0.01)


def test_a_transient_overshoots_and_settles_where_the_harmonic_solution_is(capsys, monkeypatch):
    names = run_at_home(TRANSIENT, monkeypatch)
    tip, swing, periods = names["tip"], names["swing"], names["periods"]
    assert tip[0] == pytest.approx(tip[1], abs=1e-2 * swing.max()), "it begins at rest"
    assert names["seconds"][-1] == pytest.approx(periods / names["problem"].frequency)
    assert swing[0] < 0.3 * swing[-1] and swing.max() > 1.02 * swing[-1]
    steady = abs(solve(replace(names["problem"], harmonics=15)).output("tip")[1])
    assert swing[-1] == pytest.approx(steady, rel=0.02)
    told = rf"most: 0\.\d+ mm after {swing.argmax() + 1} periods; in the end 0\.\d+ mm"
    assert re.match(told, capsys.readouterr().out)


def solve_solids(text: str, folder: Path):
    assert 'source = "geometry/extruded.py"' in text
    path = folder / "solids.toml"
    path.write_text(text.replace("geometry/extruded.py", str(ROOT / "geometry" / "extruded.py")), encoding="utf-8")
    scene = load_scene(path)
    chain = build_chain(scene)
    return solve(pose_problem(scene, chain.reduction.model, chain.interface))


def test_the_scene_of_solids_is_solved(tmp_path):
    solution = solve_solids(SOLIDS, tmp_path)
    assert solution.converged and solution.problem.model.pairs == 30 and solution.problem.model.tangents == 2


def test_half_of_a_dovetail_moves_as_the_whole_with_half_of_the_unknowns(tmp_path):
    half = solve_solids(HALF, tmp_path)
    text = HALF
    for once, twice in (("10e-3", "20e-3"), ("layers = 3", "layers = 6"), ("4000", "8000"), ("75", "150")):
        text = text.replace(once, twice)
    whole = solve_solids(text[: text.index("[supports")] + text[text.index("[loads.pull") :], tmp_path)
    assert half.converged and whole.converged
    assert half.problem.model.pairs == 40 and whole.problem.model.pairs == 70
    assert half.unknowns < 0.55 * whole.unknowns
    assert half.output("tip")[1] == pytest.approx(whole.output("tip")[1], rel=2e-3)
    assert half.merit["friction_dissipation"] == pytest.approx(whole.merit["friction_dissipation"] / 2, rel=0.05)
    assert half.merit["largest_normal_force"] == pytest.approx(whole.merit["largest_normal_force"], rel=0.05)
