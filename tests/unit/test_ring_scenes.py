"""Scenes with ``[cyclic]``: what is refused, and the geometry of pairs between a sector and the next one."""

from __future__ import annotations

from pathlib import Path

import h5py
import numpy as np
import pytest
from small_scenes import AT, HEAD, PULL, SHAKE, read_demo

from ewr_fenicsx import ContactLaws, ContactProblem, ReducedModel, close_ring, integrate, load_scene, solve, unroll_ring
from ewr_fenicsx.errors import InterfaceError, MeshError, SceneError
from ewr_fenicsx.output import ring_plots
from ewr_fenicsx.output.output import write_fields
from ewr_fenicsx.output.ring_plots import draw_diameters, find_waves, gather_ring, tell_ring
from ewr_fenicsx.structure.chain import build_chain, lay_laws
from ewr_fenicsx.structure.mesh import Ring, rotate_by_sector

ROOT = Path(__file__).parents[2]
DAMPED = read_demo("damped_ring")
DISK = read_demo("bladed_disk")
COARSE = "parameters = { sectors = 6, pairs = 3, mesh_size = 8e-3, hub_radius = 0.05, wedge_width = 24e-3 }"
SMALL = DAMPED.replace("parameters = { sectors = 30 }", COARSE).replace("sectors = 30\n", "sectors = 6\n")
SMALL = SMALL.replace("speed = 5000.0", "speed = 3000.0")


@pytest.fixture
def build(tmp_path):
    """The chain of a scene that is given as text."""

    def build_text(text: str):
        path = tmp_path / "ring.toml"
        path.write_text(text, encoding="utf-8")
        return build_chain(load_scene(path))

    return build_text


@pytest.mark.parametrize(
    "ring, told",
    [
        ("sectors = 1\nengine_order = 1\nlow = 'a'\nhigh = 'b'", "cyclic.sectors = 1: should be greater than or equal"),
        ("sectors = 6\nengine_order = 1.5\nlow = 'a'\nhigh = 'b'", "cyclic.engine_order = 1.5"),
        ("sectors = 6\nlow = 'a'\nhigh = 'b'", "cyclic.engine_order: missing"),
        ("sectors = 6\nengine_order = 1\nlow = 'a'", "a sector has two cuts: give low and high, or neither"),
        ("sectors = 6\nengine_order = 1", "nothing joins the sectors: give low and high, or flanks, or both"),
        ("sectors = 6\nengine_order = 1\nlow = 'a'\nhigh = 'a'", 'low and high are both "a"; a sector has two cuts'),
        ("sectors = 6\nengine_order = 1\nflanks = { x = ['a', 'a'] }", "x is on a and a: give two boundaries"),
        (
            "sectors = 6\nengine_order = 1\nlow = 'a'\nhigh = 'b'\nflanks = { x = ['a', 'c'] }",
            "x is on a and c: give two boundaries that are no cuts",
        ),
        ("sectors = 6\nengine_order = 1\nflanks = { x = ['a'] }", "cyclic.flanks.x"),
        ("sectors = 6\nengine_order = 1\nlow = 'a'\nhigh = 'b'\naxis = [0, 0, 0]", "should not be the zero vector"),
        ("sectors = 6\nengine_order = 1\nlow = 'clamp'\nhigh = 'b'", 'supports.clamp: "clamp" is an end of the sector'),
        (
            "sectors = 6\nengine_order = 1\nlow = 'tip'\nhigh = 'b'",
            'loads.pull.boundary: "tip" is an end of the sector',
        ),
    ],
)
def test_rings_that_make_no_sense_are_refused(read, ring, told):
    with pytest.raises(SceneError) as refused:
        read(f"{HEAD}[cyclic]\n{ring}\n{PULL}{SHAKE}{AT}")
    assert told in str(refused.value)


@pytest.mark.parametrize(
    "change, error, told",
    [
        (("low_cut", "low_cat"), SceneError, r'cyclic\.low = "low_cat": .* did you mean "low_cut"\?'),
        (("sectors = 30", "sectors = 24"), MeshError, r"24 sectors, of 15 degrees each: turned about the axis"),
        (('low = "low_cut"', 'low = "left"'), SceneError, r"no physical group of that name"),
        (("[loads.axial_pull]", "[supports]\nclamp = []\nhold = {tip='z'}\n[loads.axial_pull]"), SceneError, "tip"),
        (("[contact]", "[damping]\nkind = 'modal'\nratio = 0.01\n[contact]"), SceneError, "differ from wave to wave"),
        (("[cyclic]", "[cyclic]\naxis = [1.0, 0.0, 0.0]"), SceneError, "a plane turns about an axis normal to it"),
        (
            ("[cyclic]", "[cyclic]\ncentre = [0.0, 0.0, 0.0]"),
            SceneError,
            r"cyclic\.centre = \[0\.0, 0\.0, 0\.0\]: the mesh",
        ),
        (
            ("[loads.axial_pull]", "[supports]\nhold = { clamp = 'y' }\nclamp = []\n[loads.axial_pull]"),
            MeshError,
            "leave",
        ),
    ],
)
def test_sectors_that_close_no_ring_are_refused(build, change, error, told):
    assert change[0] in DISK
    with pytest.raises(error, match=told):
        build(DISK.replace(*change))


def test_cuts_that_meet_on_the_axis_are_refused(build):
    """With a bore, the same sector closes a ring."""
    pie = f'[geometry]\nsource = "{ROOT / "tests/geometry/pie.py"}"\nparameters = {{ bore = 0.0 }}\n{PULL}'
    pie += '[cyclic]\nsectors = 6\nengine_order = 1\nlow = "low"\nhigh = "high"\n'
    told = r"low and high share 1 node, as at \(0, 0\) m: on the axis a node would be one of all sectors; leave a bore"
    with pytest.raises(MeshError, match=told):
        build(pie)
    assert len(build(pie.replace("bore = 0.0", "bore = 5e-3")).reduction.cuts.low) == 2 * 6  # 6 of 7 nodes are free


@pytest.mark.parametrize("order", [1, 2])
def test_cuts_through_a_joint_are_refused_as_that(build, order):
    """Two nodes are at one place there, and either may be the nearest: cuts alike were "up to 6e-15 m" apart."""
    source = f'source = "{ROOT / "tests/geometry/shrunk_sector.py"}"\nparameters = {{ order = {order} }}'
    scene = f"[geometry]\n{source}\n[elasticity]\ndegree = {order}\n[contact]\ninitial_gap = -1e-6\n"
    with pytest.raises(MeshError, match="4 nodes of the cuts are in contact; cut the sector elsewhere"):
        build(scene + '[cyclic]\nsectors = 12\nengine_order = 0\nlow = "low"\nhigh = "high"\n')


@pytest.mark.parametrize(
    "change, error, told",
    [
        (('"far_wedge", "far_blade"', '"far_wedge", "near"'), InterfaceError, 'flank "far"'),
        (
            ('"far_wedge", "far_blade"', '"far_blade", "far_wedge"'),
            InterfaceError,
            "m away from the nearest next sector's .*; see sectors, centre, axis and which comes first in",
        ),
        (("far = [", "near = ["), InterfaceError, 'flank "near" is a boundary of both bodies, too'),
        (("[contact]", "[contact]\nflanks = ['near', 'far_wedge']"), SceneError, '"far_wedge" is an end of the sector'),
        (('"far_wedge", "far_blade"', '"far_wedge", "fur_blade"'), SceneError, 'did you mean "far_blade"'),
        (("[contact]", "[flanks.fur]\nfriction = 0.1\n[contact]"), SceneError, 'did you mean "far"'),
        (("[contact]", "[contact]\nflanks = ['near']\n[flanks.fur]\n"), SceneError, "there, or to cyclic.flanks"),
    ],
)
def test_flanks_between_sectors_that_do_not_fit_are_refused(build, change, error, told):
    text = SMALL.replace(*change)
    if "flanks = ['near']" in text:
        text = text.replace("[flanks.fur]\n", "").replace("[excitation]", "[flanks.fur]\nfriction = 0.1\n[excitation]")
    with pytest.raises(error, match=told):
        build(text)


def test_the_next_sector_lies_counter_clockwise():
    quarter = Ring(4, 1, "low", "high", (0.0, 0.0))
    np.testing.assert_allclose(rotate_by_sector(quarter, 2) @ [1.0, 0.0], [0.0, 1.0], atol=1e-15)
    about_x = Ring(4, 1, "low", "high", (0.0, 0.0, 0.0), (2.0, 0.0, 0.0))
    np.testing.assert_allclose(rotate_by_sector(about_x, 3) @ [5.0, 1.0, 0.0], [5.0, 0.0, 1.0], atol=1e-15)


def test_pairs_between_sectors_see_no_rigid_motion_of_the_whole_ring(build):
    """Each sector's displacements are in its own directions, turned with it."""
    chain = build(SMALL)
    interface, rotation = chain.interface, rotate_by_sector(chain.reduction.cuts.ring, 2)
    assert interface.flanks == ("near", "far") and interface.boundaries == ("near", "far_wedge")
    np.testing.assert_array_equal(interface.is_next, interface.flank_of_pair == 1)
    nodes = chain.structure.space.tabulate_dof_coordinates()[:, :2]
    here = nodes[interface.nodes_b[interface.is_next]] @ rotation.T
    np.testing.assert_allclose(here, interface.position[interface.is_next], atol=1e-12)
    for motion in ((1.0, 0.0), (0.0, 1.0)):
        own, following = (np.tile(np.array(motion) @ turn, len(nodes)) for turn in (np.eye(2), rotation))
        for rows, more in (
            (interface.normal_gap, interface.next_normal_gap),
            (interface.tangential_slip, interface.next_tangential_slip),
        ):
            np.testing.assert_allclose(rows @ own + more @ following, 0.0, atol=1e-14)
            assert np.abs((rows @ own)[interface.is_next]).min() > 0.05
    spun = (nodes @ [[0.0, 1.0], [-1.0, 0.0]]).ravel()
    np.testing.assert_allclose(interface.normal_gap @ spun + interface.next_normal_gap @ spun, 0.0, atol=1e-11)
    outwards = interface.normal[interface.is_next] @ rotation  # what opens the flank: the next sector moves away
    away = np.zeros(2 * len(nodes))
    away[2 * interface.nodes_b[interface.is_next]] = outwards[:, 0]
    away[2 * interface.nodes_b[interface.is_next] + 1] = outwards[:, 1]
    opened = interface.normal_gap @ away + interface.next_normal_gap @ away
    np.testing.assert_allclose(opened[interface.is_next], 1.0, atol=1e-14)


def test_waves_of_large_rings_are_some_and_that_of_the_load():
    mass = ReducedModel([[1.0]], [[0.0]], [[1e4]], normal=[[0.0]], tangential=[[0.0]])
    with_ties = close_ring(mass, [], [], sectors=1000, engine_order=703)
    waves = find_waves(with_ties)
    assert 297 in waves and min(waves) == 0 and max(waves) == 500 and len(waves) < 50
    np.testing.assert_allclose([*waves.values()], 100.0 / (2 * np.pi))


def test_of_a_ring_with_many_cells_some_sectors_are_drawn(build, monkeypatch):
    chain = build(SMALL)
    solution = solve(ContactProblem(chain.reduction.model, ContactLaws(friction=0.3), frequency=500.0))
    assert tell_ring(chain, solution) == "all 6 sectors at 500 Hz, engine order 4: motion about the mean"
    whole = gather_ring(chain, solution)
    monkeypatch.setattr(ring_plots, "MOST_CELLS", 4 * chain.mesh.cells + 1)
    assert tell_ring(chain, solution).startswith("4 of 6 sectors at 500 Hz")
    some = gather_ring(chain, solution)
    assert 6 * len(some.body) == 4 * len(whole.body)
    np.testing.assert_allclose(some.corners, whole.corners[: len(some.body)], atol=1e-15)


def test_a_ring_at_rest_has_its_diagram(tmp_path):
    mass = ReducedModel([[1.0]], [[0.0]], [[1e4]], normal=[[0.0]], tangential=[[0.0]])
    model = close_ring(mass, [], [], sectors=5, engine_order=1)
    draw_diameters(tmp_path / "waves.png", find_waves(model), model, ())
    assert (tmp_path / "waves.png").stat().st_size > 5_000


HELD = '[supports]\nclamp = ["clamp"]\nhold = { back_wedge = "z", back_blade = "z" }\n'


def draw_out(text: str) -> str:
    """The scene of a plane ring, as one of solids."""
    for old, new in (
        ("damped_ring.py", "extruded.py"),
        ("{ sectors = 6, ", '{ sectors = 6, profile = "damped_ring", layers = 1, '),
        ("centre = [0.0, 0.0]", "centre = [0.0, 0.0, 0.0]"),
        ("force = [10.0, 0.0]", "force = [10.0, 0.0, 3.0]"),
        ("direction = [1.0, 0.0]", "direction = [1.0, 0.0, 0.0]"),
    ):
        assert old in text
        text = text.replace(old, new)
    return text


def test_pairs_that_both_sectors_hold_have_no_friction_along_the_axis(build):
    """Their row is zero, and not what rounding leaves of one: a law would take that for a motion."""
    chain = build(draw_out(SMALL) + HELD)
    interface, model = chain.interface, chain.reduction.model
    held = np.isclose(interface.position[:, 2], 0.0)
    np.testing.assert_array_equal(interface.tangents[held, 1], [[0.0, 0.0, 1.0]] * 6)
    for wave in range(6):
        np.testing.assert_array_equal(np.any(model.rows("second_tangential", wave), axis=1), ~held)
    rows = [len(ContactProblem(model, ContactLaws(friction=0.3), frequency=700.0).system.rows)]
    assert rows == [3 * 12 - 6]


def test_pairs_that_both_sectors_hold_across_their_flank_are_refused(build):
    far = '[supports]\nclamp = ["clamp", "far_wedge", "far_blade"]\n'
    with pytest.raises(InterfaceError, match=r'flank "far": both nodes at .* are held along x and y, and cannot part'):
        build(SMALL + far)


def test_supports_that_turn_with_the_next_sector_hold_other_axes(build):
    """A wedge held along x, and the next blade held along its own: 60 degrees from the wedge's."""
    model = build(
        SMALL + '[supports]\nclamp = ["clamp"]\nhold = { far_wedge = "x", far_blade = "x" }\n'
    ).reduction.model
    assert np.all(np.any(model.rows("normal", 1)[3:], axis=1) & np.any(model.rows("tangential", 1)[3:], axis=1))


def test_fields_on_the_far_side_are_those_of_the_sector_before(build, tmp_path):
    """Which is ahead in time by the engine order over the sectors of a period."""
    chain = build(SMALL)
    solution = solve(ContactProblem(chain.reduction.model, ContactLaws(friction=0.3), frequency=770.0))
    write_fields(tmp_path, chain, solution)
    interface = chain.interface
    with h5py.File(tmp_path / "contact_pressure.h5") as file:
        places = file["Mesh/mesh/geometry"][()] if "Mesh/mesh/geometry" in file else None
        series = next(iter(file["Function"].values()))
        frames = [np.asarray(series[key]).ravel() for key in sorted(series, key=lambda k: float(k.replace("_", ".")))]
    assert places is not None and len(frames) == 32
    at = [np.argmin(np.linalg.norm(places[:, :2] - place, axis=1)) for place in interface.position_b]
    pressure = solution.history("normal_force", 32 * 6) / interface.area
    for k in np.flatnonzero(interface.is_next):
        expected = [pressure[(i * 6 + 4 * 32) % 192, k] for i in range(32)]
        found = [frame[at[k]] for frame in frames]
        np.testing.assert_allclose(found, expected, atol=1e-6 * pressure.max())
        assert np.ptp(expected) > 0.1 * pressure.max()


def test_flanks_between_sectors_have_laws_of_their_own(build):
    chain = build(SMALL + "[flanks.far]\nfriction = 0.1\n")
    friction = {laws.friction: pairs for pairs, laws in lay_laws(chain.scene, chain.interface)}
    assert friction == {0.3: [0, 1, 2], 0.1: [3, 4, 5]}


def test_dampers_settle_in_time_to_the_wave_that_a_sector_finds(build):
    """All six blades and wedges, stepped from rest by a formulation that knows neither harmonics nor waves."""
    model = build(SMALL + "[damping]\nkind = 'rayleigh'\nalpha = 200.0\nbeta = 1e-6\n").reduction.model
    laws = ContactLaws(friction=0.3)
    pose = lambda of: ContactProblem(of, laws, frequency=770.0, harmonics=15)  # noqa: E731
    wave = solve(pose(model))
    assert wave.merit["friction_dissipation"] > 0.1 * wave.merit["viscous_dissipation"]
    steady = integrate(pose(unroll_ring(model)), "rest", steps=1600, periods=150, theta=0.52)
    assert steady.converged, steady.reason
    found = wave.output("tip")
    for j in range(6):
        lag = np.exp(-2j * np.pi * 4 * j / 6 * np.array(wave.orders))
        np.testing.assert_allclose(steady.output(f"tip_{j}"), lag * found, atol=0.01 * np.abs(found[1:]).max())
