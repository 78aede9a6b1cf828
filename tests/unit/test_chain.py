"""The chain: what it refuses at once, and its stopwatch (stages in stages, compilation apart from where it happens)."""

from __future__ import annotations

import re
from dataclasses import make_dataclass

import dolfinx
import numpy as np
import pytest
import ufl
from mpi4py import MPI
from small_scenes import BLOCKS, write_blocks

from ewr_fenicsx import load_scene
from ewr_fenicsx.errors import InterfaceError, ModesError, SceneError
from ewr_fenicsx.laws import law_kinds
from ewr_fenicsx.structure import _compat, chain
from ewr_fenicsx.structure.chain import Stopwatch, add_times
from ewr_fenicsx.structure.elasticity import CentrifugalForce


@pytest.fixture
def clock(monkeypatch):
    """A clock that only the test moves: seconds, and how many of them were compilation."""

    class Clock:
        now = compiled = 0.0

        def spend(self, seconds: float, compiling: float = 0.0) -> None:
            self.now += seconds + compiling
            self.compiled += compiling

    clock = Clock()
    monkeypatch.setattr(chain.time, "perf_counter", lambda: clock.now)
    monkeypatch.setattr(chain, "measure_compilation", lambda: clock.compiled)
    return clock


def test_every_second_counts_for_one_stage(clock):
    told = []
    watch = Stopwatch(lambda *said: told.append(said))
    with watch.stage("solve"):
        clock.spend(1.0, compiling=0.25)
        with watch.stage("more modes"):
            clock.spend(2.0, compiling=0.5)
        with watch.stage("more modes"):
            clock.spend(4.0)
        clock.spend(8.0)
    with watch.stage("write"):
        clock.spend(16.0, compiling=0.002)
    assert watch.seconds == pytest.approx({"solve": 9.0, "more modes": 6.0, "JIT": 0.752, "write": 16.0})
    assert sum(watch.seconds.values()) == pytest.approx(clock.now)
    done = [(stage, seconds) for stage, seconds in told if seconds is not None]
    assert done == [
        ("more modes", 2.0),
        ("JIT", 0.5),
        ("more modes", 4.0),
        ("solve", pytest.approx(9.0)),
        ("JIT", 0.25),
        ("write", pytest.approx(16.0)),
    ]
    assert [stage for stage, seconds in told if seconds is None].count("JIT") == 2, "each line is begun and ended"


def test_times_add_up_by_stage():
    assert add_times({"mesh": 1.0, "JIT": 2.0}, {"solve": 4.0, "JIT": 8.0}) == {"mesh": 1.0, "JIT": 10.0, "solve": 4.0}


@pytest.mark.parametrize("build", [chain.build_chain, chain.build_reduced_model])
def test_a_path_is_no_scene(build):
    with pytest.raises(SceneError, match=r"scene = 'blade.toml'; give a scene as load_scene\(path\) returns it"):
        build("blade.toml")


def test_compilation_is_measured_on_every_form():
    """A form that is compiled, or found in the cache, takes time of its own: the clock runs then, and not after."""
    mesh = dolfinx.mesh.create_unit_interval(MPI.COMM_SELF, 3)
    before = _compat.measure_compilation()
    space = _compat.function_space(mesh, "Lagrange", 1)
    after_space = _compat.measure_compilation()
    form = _compat.compile_form(ufl.TestFunction(space) * ufl.dx, "a test form")
    after_form = _compat.measure_compilation()
    _compat.assemble_vector(form)
    assert before < after_space < after_form
    assert _compat.measure_compilation() == after_form


@pytest.mark.parametrize(
    ("entries", "where"),
    [('[contact]\ntangential = "mine"', "contact: "), ('[flanks.seat]\ntangential = "mine"', "flanks.seat: ")],
)
def test_a_law_that_lacks_a_parameter_is_told_before_there_is_a_mesh(tmp_path, monkeypatch, entries, where):
    kind = make_dataclass("Mine", [("spring", float)], bases=(law_kinds.LawKind,), frozen=True)
    monkeypatch.setitem(law_kinds._KINDS, ("tangential", "mine"), kind)
    monkeypatch.setattr(chain, "build_mesh", lambda *given: pytest.fail("a mesh was made"))
    (tmp_path / "scene.toml").write_text(write_blocks(entries))
    with pytest.raises(SceneError, match=f"scene.toml: {where}.*missing .* 'spring'; give it in parameters="):
        chain.build_chain(load_scene(tmp_path / "scene.toml"))


def test_a_law_of_flanks_that_only_the_mesh_knows_is_told_before_the_reduction(tmp_path, monkeypatch):
    """What [contact] says holds on no flank that the scene names, but on one of the joint."""
    kind = make_dataclass("Mine", [("spring", float)], bases=(law_kinds.LawKind,), frozen=True)
    monkeypatch.setitem(law_kinds._KINDS, ("tangential", "mine"), kind)
    monkeypatch.setattr(chain, "reduce_structure", lambda *given, **named: pytest.fail("it was reduced"))
    tables = '[contact]\ntangential = "mine"', '[flanks.left]\ntangential = "coulomb"'
    (tmp_path / "scene.toml").write_text(write_blocks(*tables, source=BLOCKS.parents[2] / "geometry" / "dovetail.py"))
    with pytest.raises(SceneError, match=r"scene.toml: contact: .*missing .* 'spring'; give it in parameters="):
        chain.build_chain(load_scene(tmp_path / "scene.toml"))


def test_a_speed_in_turns_a_minute_is_an_angular_velocity(tmp_path):
    rotation = '[loads.spin]\nkind = "rotation"\nspeed = 3000.0\ncentre = [0.0, -0.5]'
    (tmp_path / "scene.toml").write_text(write_blocks(rotation))
    loads = [chain._load(name, load) for name, load in load_scene(tmp_path / "scene.toml").loads.items()]
    (spin,) = (load for load in loads if isinstance(load, CentrifugalForce))
    assert spin.omega == pytest.approx(2 * np.pi * 50.0) and tuple(spin.centre) == (0.0, -0.5)


def test_a_phase_in_degrees_leads(tmp_path):
    """``force cos(omega t + phase)`` has the amplitude ``i force`` at 90 degrees."""
    push = '[loads.lead]\nboundary = "tip"\nforce = [3.0, 0.0]\nharmonic = 1\nphase = 90.0'
    (tmp_path / "scene.toml").write_text(write_blocks(push))
    loads = chain.build_chain(load_scene(tmp_path / "scene.toml")).structure.loads
    (load,) = (load for load in loads if load.name == "lead")
    assert load.amplitude == pytest.approx(1j)


def test_a_joint_to_a_third_body_is_told(tmp_path):
    pile = str(BLOCKS.with_name("pile.py"))
    (tmp_path / "scene.toml").write_text(write_blocks(source=pile))
    (doubt,) = chain.build_chain(load_scene(tmp_path / "scene.toml")).doubts
    assert 'boundary "lid" lies on' in doubt and "a joint is between blade and disk, on joint;" in doubt


@pytest.mark.parametrize(("shift", "told"), [(1e-5, "1e-05 m apart"), (-2e-5, "2e-05 m into one another")])
def test_sides_drawn_apart_are_told_where_the_tolerance_lets_them(tmp_path, shift, told):
    """The model had them touch, without a word."""
    tolerant = "[contact]\npair_tolerance = 1e-3"
    (tmp_path / "scene.toml").write_text(write_blocks(tolerant, parameters=f"shift = {shift}"))
    (doubt,) = chain.build_chain(load_scene(tmp_path / "scene.toml")).doubts
    assert f'flank "joint": its sides are drawn up to {told}, which' in doubt and "initial_gap alone says" in doubt


def test_triangles_of_first_order_are_told(tmp_path):
    """In bending they are as stiff as tetrahedra."""
    frequency, doubts = {}, {}
    for degree in (1, 2):
        text = write_blocks(f"[elasticity]\ndegree = {degree}", parameters="quadrilaterals = false, columns = 2")
        (tmp_path / "scene.toml").write_text(text)
        made = chain.build_chain(load_scene(tmp_path / "scene.toml"))
        frequency[degree], doubts[degree] = made.reduction.full_stick.frequency[0], made.doubts
    assert frequency[1] > 1.15 * frequency[2] and not doubts[2]
    assert "triangles of first order are far too stiff in bending; take elasticity.degree = 2, or quad" in doubts[1][0]


def test_a_body_without_a_material_beside_one_that_has_one_is_told(tmp_path):
    (tmp_path / "scene.toml").write_text(write_blocks("[materials.disk]\nyoung = 210e9\ndensity = 7800.0"))
    (doubt,) = chain.build_chain(load_scene(tmp_path / "scene.toml")).doubts
    assert doubt.startswith("materials: disk has one, blade has none and will be of Ti-6Al-4V, the default; give each")


def test_a_clamp_that_nobody_wrote_is_told_to_be_the_default(tmp_path):
    """Where the mesh has none; the remedy builds the chain, and a name that somebody wrote is no default."""
    scene = f"""
geometry.source = "{BLOCKS.with_name("shrouds.py")}"
contact = {{ body_a = "left", body_b = "right" }}
supports.hold = {{ root_left = "y", root_right = "xy" }}
loads.push = {{ boundary = "top_left", force = [1, 0] }}
"""
    missing = (
        r'supports\.clamp\[0\] = "clamp": shrouds.py has no physical group of that name for a boundary, only face, '
    )
    default = "; that is the default: name what is clamped, or give supports.clamp = []"
    for written, hint in (("", default), ('supports.clamp = ["clamp"]', "")):
        (tmp_path / "scene.toml").write_text(scene + written)
        with pytest.raises(SceneError, match=f"{missing}.*, top_right{re.escape(hint)}$"):
            chain.build_chain(load_scene(tmp_path / "scene.toml"))
    (tmp_path / "scene.toml").write_text(scene + "supports.clamp = []")
    assert chain.build_chain(load_scene(tmp_path / "scene.toml")).interface.flanks == ("face",)


def test_a_crack_within_a_body_is_told(tmp_path):
    """Along a seam that was drawn twice and is on no boundary; where it is on one, that is told, and only that."""
    told = {}
    for lid in ("", "lid"):
        parameters = f'cover = "blade", lid = "{lid}"'
        (tmp_path / "scene.toml").write_text(write_blocks(source=BLOCKS.with_name("pile.py"), parameters=parameters))
        (told[lid],) = chain.build_chain(load_scene(tmp_path / "scene.toml")).doubts
    assert (
        'body "blade" has a crack: 10 of its edges lie face to face and share no nodes, as at (0.004, 0.04) m'
        in told[""]
    )
    assert 'boundary "lid" lies on two pieces of blade' in told["lid"]


@pytest.mark.parametrize("degree", [1, 2])
def test_bodies_that_share_a_node_beside_their_flank_are_told_of_it(tmp_path, degree):
    """They turn about it, as on a hinge: not where the blade is held against that, or has a node of its own."""
    elements = f"[elasticity]\ndegree = {degree}"

    def build(share: bool, *more: str) -> chain.Chain:
        text = write_blocks(
            elements, *more, source=BLOCKS.with_name("hinged.py"), parameters=f"share = {share}".lower()
        )
        (tmp_path / "scene.toml").write_text(text)
        return chain.build_chain(load_scene(tmp_path / "scene.toml"))

    with pytest.raises(ModesError, match=r'"blade" and "disk" share 1 node, as at \(0, 0\) m, about which they turn'):
        build(True)
    assert build(False).reduction.model.rigid_modes.shape[1] == 3
    assert build(True, "[supports]\nhold = { side = 'x' }").reduction.model.rigid_modes.shape[1] == 0


def test_pieces_that_share_no_whole_edge_are_told(tmp_path):
    """As where two meshes meet whose nodes coincide at the ends alone: they gape between, and nothing touches."""
    told = {}
    for how in ("glued", "pinned"):
        parameters = f'cover = "blade", lid = "", {how} = true'
        (tmp_path / "scene.toml").write_text(write_blocks(source=BLOCKS.with_name("pile.py"), parameters=parameters))
        told[how] = chain.build_chain(load_scene(tmp_path / "scene.toml")).doubts
    assert told["glued"] == ()
    crack, doubt = sorted(told["pinned"])
    assert crack.startswith('body "blade" has a crack: ')
    assert doubt.startswith('two pieces of "blade" share 2 nodes, as at (0, 0.04) m, and no edge of a cell: they hang')


def test_a_body_with_a_hinge_of_its_own_is_told_of_it(tmp_path):
    text = write_blocks(source=BLOCKS.with_name("hinged.py"), parameters="share = false, flap = true")
    (tmp_path / "scene.toml").write_text(text)
    with pytest.raises(ModesError, match=r'^two pieces of "blade" share 1 node, as at \(0, 0\) m, about which'):
        chain.build_chain(load_scene(tmp_path / "scene.toml"))


def test_one_group_may_hold_both_bodies_or_be_followed_on_both(tmp_path):
    scene = f"""
geometry.source = "{BLOCKS.with_name("flush_blocks.py")}"
supports.clamp = ["ends"]
outputs.side = {{ boundary = "sides", direction = [1, 0] }}
loads.push = {{ boundary = "clamp", force = [1, 0] }}
"""
    (tmp_path / "scene.toml").write_text(scene)
    assert chain.build_chain(load_scene(tmp_path / "scene.toml")).interface.flanks == ("joint",)


def test_what_fails_in_a_mesh_of_millimetres_tells_of_them(tmp_path):
    """The doubt about its length is told with the rest, which the failure would else keep back."""
    parameters = "width = 40.0, blade_height = 60.0, disk_height = 30.0, columns = 6, disk_columns = 5"
    (tmp_path / "scene.toml").write_text(write_blocks(parameters=parameters))
    with pytest.raises(
        InterfaceError, match=r"same transfinite count; geometry: the mesh is \d\S+ m long; .* mm meant"
    ):
        chain.build_chain(load_scene(tmp_path / "scene.toml"))
