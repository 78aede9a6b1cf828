"""Builders and mesh files become named, checked, distributed meshes; what is wrong is refused."""

from __future__ import annotations

import subprocess
import sys
import textwrap
from pathlib import Path
from types import ModuleType

import gmsh
import pytest
from mesh_counts import count
from mpi4py import MPI

from ewr_fenicsx.errors import MeshError
from ewr_fenicsx.structure._compat import gmsh_is_running
from ewr_fenicsx.structure.boundaries import doubt_cracks
from ewr_fenicsx.structure.mesh import JointMesh, build_mesh, measure_extent

GEOMETRY = Path(__file__).parents[2] / "geometry"

# Two unit squares, "a" and "b", side by side and apart, with "wall" on both.
SQUARES = """
import gmsh


def build(*, cells: int = 4, width: float = 1.0, label: str = "wall", coarse: bool = False) -> None:
    geo = gmsh.model.geo
    curves, surfaces = [], []
    for left in (0.0, 1.5):
        points = [geo.addPoint(left + x * width, y, 0.0) for x, y in ((0, 0), (1, 0), (1, 1), (0, 1))]
        curves.append([geo.addLine(points[k], points[(k + 1) % 4]) for k in range(4)])
        surfaces.append(geo.addPlaneSurface([geo.addCurveLoop(curves[-1])]))
        for curve in curves[-1]:
            geo.mesh.setTransfiniteCurve(curve, cells + 1)
        geo.mesh.setTransfiniteSurface(surfaces[-1])
        geo.mesh.setRecombine(2, surfaces[-1])
    geo.synchronize()
    groups = [(2, [surfaces[0]], "a"), (2, [surfaces[1]], "b"), (1, [curves[0][1], curves[1][3]], label)]
    {extra}
    for dimension, members, name in groups:
        gmsh.model.setPhysicalName(dimension, gmsh.model.addPhysicalGroup(dimension, members), name)
    gmsh.model.mesh.generate(2)
    {after}
"""


@pytest.fixture
def squares(tmp_path):
    """Writes a builder of two squares, with lines of its own, and returns its path."""

    def write(extra: str = "pass", after: str = "pass") -> Path:
        path = tmp_path / "squares.py"
        path.write_text(
            SQUARES.format(extra=textwrap.indent(extra, "    ").strip(), after=textwrap.indent(after, "    ").strip())
        )
        return path

    return write


def build(path: Path, **parameters) -> JointMesh:
    return build_mesh(path, parameters, MPI.COMM_WORLD)


def test_default_fir_tree():
    mesh = build(GEOMETRY / "fir_tree.py")
    found = count(mesh)
    assert 2050 <= found["nodes"] <= 2150
    assert sum(found["bodies"].values()) == found["cells"]
    assert {
        name: found["boundaries"][name] for name in ("top_left", "top_right", "bottom_left", "bottom_right")
    } == dict.fromkeys(("top_left", "top_right", "bottom_left", "bottom_right"), 2 * 9)
    assert set(mesh.bodies) == {"blade", "disk"} and {"clamp", "tip"} < set(mesh.boundaries)
    assert mesh.domain.geometry.dim == 2
    assert 0.45 < mesh.smallest_scaled_jacobian <= 1.0
    assert not gmsh_is_running()


def test_dovetail_has_the_same_names_but_one_lobe():
    mesh = build(GEOMETRY / "dovetail.py", pairs=6)
    assert set(mesh.bodies) == {"blade", "disk"} and set(mesh.boundaries) == {"left", "right", "clamp", "tip"}
    assert count(mesh)["boundaries"]["left"] == 2 * 5


def test_parameters_reach_the_builder(squares):
    found = count(build(squares(), cells=3, width=0.5, label="side", coarse=True))
    assert found == {"nodes": 32, "cells": 18, "bodies": {"a": 9, "b": 9}, "boundaries": {"side": 6}}
    assert count(build(squares(), width=1))["cells"] == 32, "a whole number is a number"


def test_mesh_file_gives_the_builder_s_mesh(squares, tmp_path):
    """Also with node numbers that start late and have gaps, which dolfinx does not accept by itself."""
    path = tmp_path / "squares.msh"
    lines = f"gmsh.model.mesh.renumberNodes()\ngmsh.write({str(path)!r})"
    built = build(squares(after=lines))
    read = build(path)
    assert count(read) == count(built)
    assert read.bodies == built.bodies and read.boundaries == built.boundaries
    assert read.smallest_scaled_jacobian == pytest.approx(built.smallest_scaled_jacobian, rel=1e-12)
    gapped = tmp_path / "gapped.msh"
    gapped.write_text(shift_node_numbers(path.read_text()))
    assert count(build(gapped)) == count(built)


def shift_node_numbers(text: str) -> str:
    """Rename node k of an ASCII msh 4.1 file to 2 k + 100."""
    lines, out, k = text.splitlines(), [], 0
    while k < len(lines):
        section = lines[k]
        out.append(section)
        k += 1
        if section not in ("$Nodes", "$Elements"):
            continue
        blocks, total, low, high = map(int, lines[k].split())
        out.append(f"{blocks} {total} {2 * low + 100} {2 * high + 100}" if section == "$Nodes" else lines[k])
        k += 1
        for _ in range(blocks):
            out.append(lines[k])
            size = int(lines[k].split()[3])
            body = lines[k + 1 : k + 1 + size]
            if section == "$Nodes":
                out += [str(2 * int(number) + 100) for number in body] + lines[k + 1 + size : k + 1 + 2 * size]
                k += 1 + 2 * size
            else:
                cells = ([int(number) for number in line.split()] for line in body)
                out += [" ".join(map(str, [cell[0], *(2 * node + 100 for node in cell[1:])])) for cell in cells]
                k += 1 + size
    return "\n".join(out) + "\n"


TRIANGLES = """
import gmsh


def build() -> None:
    for left, name in ((0.0, "a"), (1.5, "b")):
        square = gmsh.model.occ.addRectangle(left, 0.0, 0.0, 1.0, 1.0)
        gmsh.model.occ.synchronize()
        gmsh.model.setPhysicalName(2, gmsh.model.addPhysicalGroup(2, [square]), name)
        if name in {recombined}:
            gmsh.model.mesh.setTransfiniteSurface(square)
            gmsh.model.mesh.setRecombine(2, square)
    gmsh.option.setNumber("Mesh.CharacteristicLengthMax", 0.25)
    gmsh.model.mesh.generate(2)
"""


def test_all_triangles_are_welcome(tmp_path):
    path = tmp_path / "triangles.py"
    path.write_text(TRIANGLES.format(recombined=()))
    mesh = build(path)
    assert set(mesh.bodies) == {"a", "b"} and not mesh.boundaries
    assert mesh.domain.topology.cell_name() == "triangle"
    assert 0.5 < mesh.smallest_scaled_jacobian < 1.0


def test_an_endless_mesh_is_refused_before_it_is_made(monkeypatch):
    """Lengths in mm: both that decide on the cells are named. gmsh is as it was afterwards."""
    generate, made = gmsh.model.mesh.generate, []
    monkeypatch.setattr(gmsh.model.mesh, "generate", staticmethod(lambda *_: made.append(True)))
    in_mm = {"width": 60, "lower_width": 80, "height": 40, "lower_height": 30}
    with pytest.raises(MeshError, match=r"two_blocks\.py: 80 m x 70 m with mesh_size = 0\.005 m .*were mm meant\?"):
        build(GEOMETRY / "two_blocks.py", **in_mm)
    assert not made
    monkeypatch.undo()
    assert build(GEOMETRY / "two_blocks.py", mesh_size=20e-3).smallest_scaled_jacobian > 0
    assert gmsh.model.mesh.generate is generate


CENTRE = "groups.append((0, [geo.addPoint(5.0, 0.0, 0.0){}], 'centre'))\ngeo.synchronize()"
AXIS = "geo.addLine(*(geo.addPoint(0.0, 0.0, z) for z in (-1.0, 1.0)))\ngeo.synchronize()"
SAVE_ALL = "\ngmsh.option.setNumber('Mesh.SaveAll', 1)"


@pytest.mark.parametrize(
    "extra",
    [
        CENTRE.format(""),
        CENTRE.format(", points[0]"),
        CENTRE.format("") + SAVE_ALL,
        AXIS + SAVE_ALL,
    ],
    ids=["a group of a centre", "a group of a centre and a corner", "a centre and all saved", "an axis and all saved"],
)
def test_points_and_curves_on_no_body_are_left_out(squares, tmp_path, extra):
    """Whether they are in a group or not, and from files as from builders; dolfinx crashes on their nodes."""
    versions = (4.1,) if SAVE_ALL in extra else (4.1, 2.2)  # of format 2.2, files of all have no groups
    paths = [tmp_path / f"version_{version}.msh" for version in versions]
    write = "gmsh.option.setNumber('Mesh.MshFileVersion', {})\ngmsh.write({!r})\n"
    after = "".join(write.format(version, str(path)) for version, path in zip(versions, paths, strict=True))
    usual = build(squares())
    for mesh in (build(squares(extra, after)), *map(build, paths)):
        assert count(mesh) == count(usual)
        assert measure_extent(mesh) == measure_extent(usual) == 2.5
        assert mesh.smallest_scaled_jacobian == pytest.approx(1.0)


def test_an_axis_drawn_beside_a_solid_is_left_out(tmp_path):
    path = tmp_path / "box.py"
    path.write_text(
        "import gmsh\n\n\ndef build(*, axis: bool) -> None:\n"
        "    line = gmsh.model.occ.addLine(*(gmsh.model.occ.addPoint(0.0, y, -5.0) for y in (0.0, 0.1)))\n"
        "    groups = [(3, gmsh.model.occ.addBox(0.0, 0.0, 0.0, 1.0, 1.0, 1.0), 'a'), (1, line, 'axis')]\n"
        "    gmsh.model.occ.synchronize()\n"
        "    for dimension, member, name in groups[: 1 + axis]:\n"
        "        gmsh.model.setPhysicalName(dimension, gmsh.model.addPhysicalGroup(dimension, [member]), name)\n"
        "    gmsh.model.mesh.generate(3)\n"
    )
    usual, mesh = (build(path, axis=axis) for axis in (False, True))
    assert count(mesh) == count(usual) and measure_extent(mesh) == 1.0


@pytest.mark.parametrize("triangles", [False, True])
def test_complete_cells_of_second_order_are_welcome(squares, tmp_path, triangles):
    path = squares(after="gmsh.model.mesh.setOrder(2)")
    if triangles:
        path = tmp_path / "triangles.py"
        path.write_text(TRIANGLES.format(recombined=()) + "    gmsh.model.mesh.setOrder(2)\n")
    assert build(path).domain.geometry.cmap.degree == 2


def test_mixed_cell_types_are_refused_before_dolfinx_crashes(tmp_path):
    path = tmp_path / "mixed.py"
    path.write_text(TRIANGLES.format(recombined=("b",)))
    with pytest.raises(MeshError, match=r'mixed\.py: cells of 2 types: .*[Tt]riangle.* in "a".*[Qq]uad.* in "b"'):
        build(path)


@pytest.mark.parametrize(
    "parameters, words",
    [
        ({"cels": 3}, r'unknown parameter "cels" = 3; did you mean "cells"\?'),
        ({"viscosity": 3}, r'unknown parameter "viscosity" = 3; known are cells, width, label, coarse'),
        ({"cells": 3.5}, "parameter cells = 3.5: expected a whole number"),
        ({"cells": True}, "parameter cells = True: expected a whole number"),
        ({"width": "wide"}, "parameter width = 'wide': expected a finite number"),
        ({"width": float("nan")}, "parameter width = nan: expected a finite number"),
        ({"label": 7}, "parameter label = 7: expected text"),
        ({"coarse": 1}, "parameter coarse = 1: expected true or false"),
    ],
)
def test_wrong_parameters_are_named(squares, parameters, words):
    with pytest.raises(MeshError, match=words):
        build(squares(), **parameters)


@pytest.mark.parametrize(
    "extra, after, words",
    [
        ("groups = groups[2:]", "pass", "no named body; give each body a physical group of dimension 2"),
        (
            "groups[1] = (2, [surfaces[1]], '')",
            "pass",
            r"physical group 2 of dimension 2 has no name of its own; .*Physical Surface\(",
        ),
        (
            "groups[2] = (1, [curves[0][1]], '')",
            "pass",
            r"physical group 3 of dimension 1 has no name of its own; .*Physical Curve\(",
        ),
        (
            "groups[1] = (2, [surfaces[1]], 'a')",
            "pass",  # gmsh 4.8 keeps the first of two equal names, others keep both
            'two physical groups of dimension 2 are called "a", 1 and 2|group 2 of dimension 2 has no name of its own',
        ),
        ("groups.pop(1)", "pass", r"16 cells of entity 2 belong to no body \(a\)"),
        ("groups[1] = (2, surfaces, 'b')", "pass", 'entity 1 of dimension 2 is in "a" and in "b"'),
        ("groups.append((1, [curves[0][1]], 'edge'))", "pass", 'entity 2 of dimension 1 is in "wall" and in "edge"'),
        (
            "groups[2] = (1, 2 * [curves[0][1]], 'wall')",
            "pass",
            r'"wall" holds entity 2 of dimension 1 twice; .* which glues them, keep two',
        ),
        ("pass", "gmsh.model.mesh.clear([(2, 2)])", 'body "b" has no cells in entity 2'),
        ("pass", "gmsh.model.mesh.clear()", "the model has no mesh of surfaces"),
        (
            "pass",
            "gmsh.model.mesh.setNode(gmsh.model.mesh.getNodes(2, 1)[0][0], [0.9, 0.9, 0.0], [])",
            r'body "a" has a quadrilateral with a scaled Jacobian of -0\.\d+ at \(0\.\d+, 0\.\d+\); expected more',
        ),
        (
            "pass",
            "gmsh.model.mesh.setNode(gmsh.model.mesh.getNodes(2, 1)[0][0], [0.3, 0.3, 0.1], [])",
            "z runs from 0.0 to 0.1",
        ),
        (
            "points = [geo.addPoint(5.0, y, 0.0) for y in (0.0, 1.0)]\n"
            "groups.append((1, [geo.addLine(*points)], 'loose'))\n"
            "geo.synchronize()",
            "pass",
            r'boundary "loose": (\d+) of \1 facets of entity \d+ belong to no cell',
        ),
        (
            "raise ValueError('width = -1: expected a positive number')",
            "pass",
            r"squares\.py: width = -1: expected a pos",
        ),
        (
            "pass",
            "gmsh.option.setNumber('Mesh.SecondOrderIncomplete', 1)\ngmsh.model.mesh.setOrder(2)",
            "cells are of type Quadrilateral 8; expected first order, or complete second order",
        ),
        ("pass", "gmsh.model.mesh.setOrder(3)", "cells are of type Quadrilateral 16; expected first order"),
        ("nonsense", "pass", r"squares\.py: NameError: name 'nonsense' is not defined \(line [0-9]+\)"),
        ("gmsh.model.getEntitiesForPhysicalGroup(2, 99)", "pass", r"squares\.py: Exception: "),
    ],
)
def test_meshes_that_make_no_sense_are_refused(squares, extra, after, words):
    with pytest.raises(MeshError, match=words):
        build(squares(extra, after))
    assert not gmsh_is_running(), "gmsh is stopped also after an error"


def test_a_parameter_in_millimetres_is_named_where_the_builder_blames_another():
    said = "disk_width = 0.04: expected more than .* flank_length = 10 is far above its default, .* were mm meant"
    with pytest.raises(MeshError, match=said):
        build_mesh(GEOMETRY / "dovetail.py", {"flank_length": 10.0}, MPI.COMM_WORLD)


EMPTY_MESH = "$MeshFormat\n2.2 0 8\n$EndMeshFormat\n$Nodes\n1\n1 0 0 0\n$EndNodes\n$Elements\n0\n$EndElements\n"


@pytest.mark.parametrize(
    "name, content, words",
    [
        ("absent.py", None, r"absent\.py: no such file"),
        ("absent.msh", None, r"absent\.msh: no such file"),
        ("blade.step", "", r'geometry ends in ".step"; expected a builder \(.py\) or a gmsh mesh \(.msh\)'),
        ("empty.py", "", r"empty\.py: no function `build`"),
        ("broken.py", "def build(:", r"broken\.py: SyntaxError"),
        ("demanding.py", "def build(*, size: float):\n    pass", r"demanding\.py: parameter size has no default"),
        ("rubbish.msh", "rubbish\n", r"rubbish\.msh: "),
        ("idle.py", "def build():\n    pass", r"idle\.py: the model has no mesh of surfaces; does the builder call"),
        (
            "leaving.py",
            "import sys\ndef build():\n    sys.exit('no licence')",
            r"leaving\.py: SystemExit: no licence \(line 3\)",
        ),
        ("stopping.py", "def build():\n    raise BaseException('no')", r"stopping\.py: BaseException: no \(line 2\)"),
        (
            "ended.py",
            "import gmsh\ndef build():\n    gmsh.finalize()",
            r"ended\.py: `build` ends gmsh.*leave",
        ),
        ("flat.msh", EMPTY_MESH, r"flat\.msh: the model has no mesh of surfaces; was it made by gmsh -2\?"),
    ],
)
def test_sources_that_cannot_be_read(tmp_path, name, content, words):
    if content is not None:
        (tmp_path / name).write_text(content)
    with pytest.raises(MeshError, match=words):
        build(tmp_path / name)
    assert not gmsh_is_running()


def test_builder_may_import_files_beside_it(squares, tmp_path, monkeypatch):
    """Each builder gets its own neighbours, even of one name; nothing stays loaded, no bytecode is written."""
    monkeypatch.setattr(sys, "dont_write_bytecode", False)
    path, loaded = list(sys.path), set(sys.modules)
    for folder, cells in (("coarse", 2), ("fine", 5)):
        (tmp_path / folder / "shared").mkdir(parents=True)
        (tmp_path / folder / "sizes.py").write_text("from shared.numbers import CELLS\n")
        (tmp_path / folder / "shared" / "__init__.py").touch()
        (tmp_path / folder / "shared" / "numbers.py").write_text(f"CELLS = {cells}\n")
        builder = tmp_path / folder / "squares.py"
        text = "import sizes\n" + squares().read_text().replace("build(*, cells: int = 4", "build(*, cells=sizes.CELLS")
        builder.write_text(text)
        files = set(tmp_path.rglob("*"))
        assert count(build(builder))["cells"] == 2 * cells**2
        assert set(tmp_path.rglob("*")) == files
    assert sys.path == path
    assert not {"sizes", "shared", "shared.numbers"} & (set(sys.modules) - loaded)
    assert sys.dont_write_bytecode is False


def test_a_builder_gets_its_neighbours_where_the_program_has_others_of_their_names(squares, tmp_path, monkeypatch):
    (tmp_path / "sizes.py").write_text("CELLS = 3\n")
    builder = squares()
    text = builder.read_text().replace("build(*, cells: int = 4", "build(*, cells=sizes.CELLS")
    builder.write_text("import sizes\n" + text)
    own = ModuleType("sizes")
    own.CELLS = 5
    monkeypatch.setitem(sys.modules, "sizes", own)
    assert count(build(builder))["cells"] == 2 * 3**2
    assert sys.modules["sizes"] is own


def test_mesh_file_takes_no_parameters(squares, tmp_path):
    path = tmp_path / "squares.msh"
    build(squares(after=f"gmsh.write({str(path)!r})"))
    with pytest.raises(MeshError, match="a mesh file takes no parameters, got cells"):
        build(path, cells=3)


@pytest.mark.parametrize("fails", [False, True])
def test_a_running_gmsh_keeps_its_models_and_options(squares, fails):
    gmsh.initialize(["", "-nopopup"], False)
    try:
        gmsh.option.setNumber("General.Terminal", 1)
        gmsh.model.add("mine")
        gmsh.model.geo.addPoint(1.0, 2.0, 3.0, tag=17)
        gmsh.model.geo.synchronize()
        models = gmsh.model.list()
        if fails:
            with pytest.raises(MeshError):
                build(squares(), unknown=1)
        else:
            assert count(build(squares()))["cells"] == 32
        assert gmsh_is_running()
        assert gmsh.model.list() == models and gmsh.model.getCurrent() == "mine"
        assert gmsh.model.getEntities(0) == [(0, 17)]
        assert gmsh.option.getNumber("General.Terminal") == 1
        gmsh.option.setNumber("General.Terminal", 0)  # a stopped gmsh 4.8 would go on printing
    finally:
        gmsh.finalize()


def test_gmsh_is_known_to_run_without_asking_it():
    """Before its first start, gmsh 4.8 answers some questions by ending the process, as what is in memory has it."""
    program = (
        "import gmsh; from ewr_fenicsx.structure._compat import gmsh_is_running; gmsh.model.list = None; said = []\n"
        "for change in (lambda: None, lambda: gmsh.initialize([], False), gmsh.finalize) * 2:\n"
        "    change(); said.append(gmsh_is_running())\n"
        "print(said)"
    )
    run = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=False, timeout=60)
    assert run.stdout == f"{[False, True, False] * 2}\n", run.stderr


def test_gmsh_is_quiet():
    """In a process of its own, from its first start, and when started again; what MPI says at import is not ours."""
    program = (
        "import sys; from pathlib import Path; from mpi4py import MPI\n"
        "from ewr_fenicsx.structure.mesh import build_mesh\n"
        "for stream in (sys.stdout, sys.stderr): print('IMPORTED', file=stream, flush=True)\n"
        f"for _ in range(2): build_mesh(Path({str(GEOMETRY / 'fir_tree.py')!r}), {{}}, MPI.COMM_WORLD)"
    )
    run = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True, timeout=60)
    assert [text.partition("IMPORTED\n")[2] for text in (run.stdout, run.stderr)] == ["", ""]
    assert "IMPORTED" in run.stdout and "IMPORTED" in run.stderr


@pytest.mark.parametrize("width", [0.04, 40.0])
def test_the_extent_of_a_mesh_is_its_longest_side(squares, width):
    assert measure_extent(build_mesh(squares(), {"width": width}, MPI.COMM_SELF)) == pytest.approx(1.5 + width)


MERGED = "gmsh.model.mesh.removeDuplicateNodes()"


@pytest.mark.parametrize(
    "extra, after, width, cracks",
    [
        ("groups = [(2, surfaces, 'a')]", "pass", 1.5, 1),
        ("groups = [(2, surfaces, 'a'), (1, curves[0][1:2], 'wall')]", "pass", 1.5, 1),
        ("groups = [(2, surfaces, 'a'), groups[2]]", "pass", 1.5, 0),
        ("groups = groups[:2]", "pass", 1.5, 0),
        ("groups = [(2, surfaces, 'a')]", MERGED, 1.5, 0),
        ("groups = [(2, surfaces, 'a')]", "pass", 1.49, 0),
    ],
    ids=["on no boundary", "one side on a boundary", "both on one", "two bodies", "merged", "apart"],
)
def test_facets_of_a_body_that_lie_on_one_another_are_a_crack(squares, extra, after, width, cracks):
    doubts = list(doubt_cracks(build(squares(extra, after), width=width)))
    assert len(doubts) == cracks
    for doubt in doubts:
        assert 'body "a" has a crack: 8 of its edges lie face to face and share no nodes, as at (1.5, 0.125) m' in doubt
        assert "let the pieces share nodes" in doubt


@pytest.mark.parametrize("cells", [5, 9])
def test_a_seam_drawn_twice_with_unlike_counts_of_nodes_is_a_crack(squares, cells):
    extra = (
        f"groups = [(2, surfaces, 'a')]\nfor c in curves[1][1::2]: gmsh.model.mesh.setTransfiniteCurve(c, {cells + 1})"
    )
    (doubt,) = doubt_cracks(build(squares(extra), width=1.5))
    assert f'body "a" has a crack: {4 + cells} of its edges lie face to face' in doubt
