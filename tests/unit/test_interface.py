"""Pairs, frames, areas and the signs of gap and slip; joints that cannot be paired are refused by name."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import dolfinx
import numpy as np
import pytest
from mpi4py import MPI

from ewr_fenicsx.errors import InterfaceError
from ewr_fenicsx.scene.scene import load_scene
from ewr_fenicsx.structure.boundaries import boundary_facets
from ewr_fenicsx.structure.elasticity import assemble_structure, body_nodes
from ewr_fenicsx.structure.interface import _pair_sides, _Side, doubt_boundaries, pair_interface
from ewr_fenicsx.structure.materials import TITANIUM
from ewr_fenicsx.structure.mesh import build_mesh
from ewr_fenicsx.structure.pair_frames import point_outward

TWO_BLOCKS = Path(__file__).parents[1] / "geometry" / "two_blocks.py"
EXTRUDED = Path(__file__).parents[2] / "geometry" / "extruded.py"
CORNERED = Path(__file__).parents[1] / "geometry" / "cornered.py"
PILE = Path(__file__).parents[1] / "geometry" / "pile.py"
BUSH = Path(__file__).parents[1] / "geometry" / "bush.py"
ROOT = Path(__file__).parents[2]
FIR_TREE = ROOT / "geometry" / "fir_tree.py"
DEMOS = {scene.geometry.source.stem: scene for scene in map(load_scene, sorted((ROOT / "demos").glob("*.toml")))}
SCENES = (ROOT / "docs" / "scenes.md").read_text(encoding="utf-8")
ANGLE = 25.0
NORMAL = np.array([np.sin(np.radians(ANGLE)), -np.cos(np.radians(ANGLE))])  # out of the blade, into the disk


def assemble(source=TWO_BLOCKS, degree=1, **parameters):
    mesh = build_mesh(source, parameters, MPI.COMM_WORLD)
    material = dict.fromkeys(mesh.bodies, TITANIUM)
    return assemble_structure(mesh, materials=material, thickness=0.02, degree=degree, clamp=())


def move(structure, **displacement):
    """Displacement of all degrees of freedom, each named body moved by a constant vector."""
    u = np.zeros((structure.mass.getSize()[0] // 2, 2))
    for body, vector in displacement.items():
        u[body_nodes(structure, body)] = vector
    return u.ravel()


@pytest.fixture(scope="module", params=[1, 2])
def joint(request):
    structure = assemble(degree=request.param, inclination=ANGLE)
    return structure, pair_interface(structure)


def test_frame_is_the_blades_outward_normal_and_its_left_turn(joint):
    _, interface = joint
    np.testing.assert_allclose(interface.normal, np.tile(NORMAL, (len(interface.area), 1)), atol=1e-12)
    np.testing.assert_allclose(
        interface.tangent, np.tile((-NORMAL[1], NORMAL[0]), (len(interface.area), 1)), atol=1e-12
    )


def test_pairs_follow_the_tangent_and_join_coincident_nodes_of_two_bodies(joint):
    structure, interface = joint
    x = structure.space.tabulate_dof_coordinates()[:, :2]
    np.testing.assert_allclose(x[interface.nodes_a], interface.position, atol=1e-15)
    np.testing.assert_allclose(x[interface.nodes_b], interface.position, atol=1e-12)
    steps = np.einsum("kd,kd->k", np.diff(interface.position, axis=0), interface.tangent[1:])
    np.testing.assert_allclose(steps, 0.04 / (len(interface.area) - 1), rtol=1e-9)
    assert np.isin(interface.nodes_a, body_nodes(structure, "blade")).all()
    assert np.isin(interface.nodes_b, body_nodes(structure, "disk")).all()


@pytest.mark.parametrize("degree", [1, 2])
def test_pairs_follow_a_tangent_that_turns_all_the_way_round(degree):
    interface = pair_interface(assemble(BUSH, degree))
    angle = np.degrees(np.unwrap(np.arctan2(*interface.position.T[::-1])))
    np.testing.assert_allclose(np.diff(angle), 360 / (16 * degree), rtol=0.02)
    outward = interface.position / np.linalg.norm(interface.position, axis=1, keepdims=True)
    np.testing.assert_allclose(interface.normal, outward, atol=1e-7)


def test_areas_are_integrals_of_the_shape_functions(joint):
    """Trapezoidal rule for degree 1, Simpson's for degree 2; both sum to length times thickness."""
    _, interface = joint
    total = 0.04 * 0.02
    weights = {7: [1, 2, 2, 2, 2, 2, 1], 13: [1, 4, 2, 4, 2, 4, 2, 4, 2, 4, 2, 4, 1]}[len(interface.area)]
    np.testing.assert_allclose(interface.area, total * np.array(weights) / sum(weights), rtol=1e-11)
    assert interface.area.sum() == pytest.approx(total, rel=1e-13)


def test_moving_the_disk_along_the_normal_opens_the_joint(joint):
    structure, interface = joint
    u = move(structure, disk=2e-3 * NORMAL)
    np.testing.assert_allclose(interface.normal_gap @ u, 2e-3, rtol=1e-12)
    np.testing.assert_allclose(interface.tangential_slip @ u, 0, atol=1e-17)
    # and the blade into the disk: penetration
    np.testing.assert_allclose(interface.normal_gap @ move(structure, blade=2e-3 * NORMAL), -2e-3, rtol=1e-12)


def test_moving_the_blade_along_the_tangent_slips_forwards(joint):
    structure, interface = joint
    u = move(structure, blade=3e-3 * interface.tangent[0])
    np.testing.assert_allclose(interface.tangential_slip @ u, 3e-3, rtol=1e-12)
    np.testing.assert_allclose(interface.normal_gap @ u, 0, atol=1e-17)


def test_gap_transposed_gives_the_pair_forces_of_the_convention(joint):
    """On A: -lam_N n + lam_T t, on B the opposite."""
    _, interface = joint
    force = (
        interface.normal_gap.T @ np.full(len(interface.area), 5.0)
        + interface.tangential_slip.T @ np.full(len(interface.area), 2.0)
    ).reshape(-1, 2)
    np.testing.assert_allclose(force[interface.nodes_a], -5 * interface.normal + 2 * interface.tangent, rtol=1e-12)
    np.testing.assert_allclose(force[interface.nodes_b], 5 * interface.normal - 2 * interface.tangent, rtol=1e-12)


def test_rigid_motion_of_everything_leaves_the_joint_at_rest(joint):
    structure, interface = joint
    x = structure.space.tabulate_dof_coordinates()[:, :2]
    u = (np.column_stack([-x[:, 1], x[:, 0]]) + np.array([0.3, -0.1])).ravel()
    # gmsh places nodes along a curve to a few 1e-12 of its length
    assert abs(interface.normal_gap @ u).max() < 1e-12 and abs(interface.tangential_slip @ u).max() < 1e-12


def test_fir_tree_flanks_press_when_the_blade_is_pulled_out():
    """Ten pairs a flank; a radial pull closes all of them, and left and right flanks mirror each other."""
    structure = assemble(FIR_TREE)
    interface = pair_interface(structure)
    assert interface.flanks == ("bottom_left", "bottom_right", "top_left", "top_right")
    np.testing.assert_array_equal(np.bincount(interface.flank_of_pair), 10)
    assert (interface.normal_gap @ move(structure, blade=(0, 1e-3)) < -0.5e-3).all()
    area = np.bincount(interface.flank_of_pair, interface.area)
    for flank, total in enumerate(area):
        ends = interface.position[interface.flank_of_pair == flank][[0, -1]]
        assert total == pytest.approx(np.linalg.norm(ends[1] - ends[0]) * 0.02, rel=1e-12)
    left, right = (interface.position[interface.flank_of_pair == k] for k in (2, 3))
    np.testing.assert_allclose(left, right[::-1] * (-1, 1), atol=1e-9)


def test_unequal_node_counts_are_named():
    structure = assemble(columns=9, disk_columns=10)
    with pytest.raises(
        InterfaceError, match=r'flank "joint": 10 nodes on the blade, 11 on the disk; .*transfinite count$'
    ):
        pair_interface(structure)


def test_a_third_body_on_a_flank_is_told():
    with pytest.raises(InterfaceError, match=r"same transfinite count; a third body is on it, .* a part of disk$"):
        pair_interface(assemble(PILE, lid="joint"), ["joint"])
    with pytest.raises(InterfaceError, match=r'^flank "joint": a third body is on it, .* a part of disk$'):
        pair_interface(assemble(PILE, lid="joint", sides=1))


@pytest.mark.parametrize(
    "flank, told", [("tip", r"\d+ nodes on the blade, 0 on"), ("clamp", r"0 nodes on the blade, \d+ on")]
)
def test_a_boundary_of_one_body_is_no_flank(flank, told):
    structure = assemble(FIR_TREE)
    with pytest.raises(InterfaceError, match=rf'flank "{flank}": {told} the disk; a flank has curves of both bodies'):
        pair_interface(structure, [flank])


def test_nodes_further_apart_than_the_tolerance_are_named():
    structure = assemble(shift=1e-5)
    with pytest.raises(
        InterfaceError, match=r'flank "joint": .* is 1e-05 m away .* allowed are 4e-08 m.*; a clearance is not drawn'
    ):
        pair_interface(structure)
    assert len(pair_interface(structure, tolerance=1e-3).area) == 7


def test_a_boundary_in_use_is_a_flank_only_where_the_bodies_lie_face_to_face():
    """As the scene's reference says. A group may hold the feet of both bodies; a flank held by mistake stays one."""
    assert "of those held, loaded or followed only where the bodies lie face to face" in SCENES
    structure = assemble(PILE.with_name("flush_blocks.py"))
    with pytest.raises(InterfaceError, match=r'flank "(sides|ends)": '):
        pair_interface(structure)
    assert pair_interface(structure, in_use=["sides", "ends"]).flanks == ("joint",)
    assert pair_interface(structure, in_use=["sides", "ends", "joint"]).flanks == ("joint",)


@pytest.mark.parametrize(
    ("rows", "told"), [(5, "the blade node at .* is 0.04 m away"), (7, "8 nodes on the blade, 6 on")]
)
def test_a_boundary_that_may_be_no_flank_is_told_so(rows, told):
    """Where nobody named the flanks, and the bodies do not lie face to face."""
    structure, words = assemble(PILE.with_name("flush_blocks.py"), rows=rows), "name the flanks in contact.flanks"
    free, named = ("ends", "sides") if rows == 5 else ("sides", "ends")
    with pytest.raises(InterfaceError, match=rf'flank "{free}": {told}.*; or, if it is no flank, {words}$'):
        pair_interface(structure, in_use=[named])
    with pytest.raises(InterfaceError, match=rf'flank "{free}": {told}') as refused:
        pair_interface(structure, ["joint", free])
    assert words not in str(refused.value)


@pytest.mark.parametrize("gap", [True, False])
def test_a_clearance_is_hinted_at_where_sides_part_across_the_flank(gap):
    """Also where they touch elsewhere, as those of a crowned flank do; not where nodes lie beside each other."""
    x, up = np.linspace(-1.0, 1.0, 5), np.tile([0.0, 1.0], (5, 1))
    lay = lambda first, x, y: _Side(first + np.arange(5), np.column_stack([x, y]), up, np.ones(5), np.zeros(5))  # noqa: E731
    moved = (x, 0.01 * x**2) if gap else (x + 0.01, 0 * x)
    with pytest.raises(InterfaceError, match=r"is 0\.01 m away") as refused:
        _pair_sides("joint", lay(0, x, 0 * x), lay(5, *moved), "blade", "disk", 1e-6)
    assert ("a clearance is not drawn" in str(refused.value)) == gap


def test_two_nodes_have_no_partner_in_common():
    """However near they are to it."""
    lay = lambda first, *x: _Side(  # noqa: E731
        first + np.arange(3), np.column_stack([x, np.zeros(3)]), np.tile([0.0, -1.0], (3, 1)), np.ones(3), np.zeros(3)
    )
    a, b = lay(0, 0.0, 1e-8, 1.0), lay(10, 0.0, 0.5, 1.0)
    with pytest.raises(InterfaceError, match=r'flank "top": .*; give both curves the same end points'):
        _pair_sides("top", a, b, "blade", "disk", 1e-6)


def test_shared_nodes_are_refused():
    structure = assemble(welded=True)
    for flanks in (None, ["joint"]):
        with pytest.raises(InterfaceError, match='flank "joint": blade and disk share 7 nodes'):
            pair_interface(structure, flanks)


@pytest.mark.parametrize(
    "choice, words",
    [
        ({"flanks": ["jiont"]}, 'no flank named "jiont".*did you mean "joint"'),
        ({"flanks": ["tip"]}, 'flank "tip": 7 nodes on the blade, 0 on the disk'),
        ({"body_a": "balde"}, 'no body named "balde".*did you mean "blade"'),
        ({"body_a": "blade", "body_b": "blade"}, "the same body"),
    ],
)
def test_unknown_names_are_refused(choice, words):
    with pytest.raises(InterfaceError, match=words):
        pair_interface(assemble(), **choice)


def test_flanks_that_share_a_node_are_refused():
    """The joint cut in two at its middle node."""
    structure = assemble()
    mesh, space = structure.mesh, structure.space
    facets = boundary_facets(mesh, "joint")
    x = space.tabulate_dof_coordinates()[:, 0]
    middle = np.array(
        [x[dolfinx.fem.locate_dofs_topological(space, 1, np.array([f], dtype=np.int32))].mean() for f in facets]
    )
    tags = dolfinx.mesh.meshtags(mesh.domain, 1, facets, np.where(middle < 0.02, 1, 2).astype(np.int32))
    cut = replace(structure, mesh=replace(mesh, facet_tags=tags, boundaries={"left": 1, "right": 2}))
    with pytest.raises(InterfaceError, match=r'flanks "left" and "right" share the node at \(0\.02, 0\.03\) m'):
        pair_interface(cut)


@pytest.mark.parametrize("degree", [1, 2])
@pytest.mark.parametrize("wall", [0.01, 0.1])
def test_a_flank_that_turns_a_corner_is_refused(degree, wall):
    """Its pair had the normal between both, and carried the whole load as a wedge; edges may be of any lengths."""
    words = r'flank "seat" turns a corner of 90 degrees at \(0, 0\) m: .* end the flank short of the corner'
    with pytest.raises(InterfaceError, match=words):
        pair_interface(assemble(CORNERED, degree, wall=wall))


def test_flanks_that_end_short_of_a_corner_have_normals_of_their_own():
    for flanks in (1, 2):
        interface = pair_interface(assemble(CORNERED, short=0.001, flanks=flanks))
        assert len(interface.area) == 10
        np.testing.assert_allclose(np.abs(interface.normal).max(axis=1), 1, rtol=1e-12)
    with pytest.raises(InterfaceError, match=r'flanks "floor" and "wall" share the node at .* go on without a corner'):
        pair_interface(assemble(CORNERED, flanks=2))


@pytest.mark.parametrize("around", [4, 5, 6, 8, 9])
def test_coarse_curves_are_no_corners(around):
    structure = assemble(CORNERED, around=around)
    if around > 5:
        interface = pair_interface(structure)
        outward = interface.position / np.linalg.norm(interface.position, axis=1, keepdims=True)
        np.testing.assert_allclose(interface.normal, outward, atol=1e-9)
    else:
        with pytest.raises(InterfaceError, match=f"a corner of {360 // around} degrees"):
            pair_interface(structure)


@pytest.mark.parametrize("grading", [1.0, 1.2])
@pytest.mark.parametrize(("order", "degree"), [(1, 1), (1, 2), (2, 2)])
def test_normals_in_a_part_of_a_bore_are_those_of_the_circle(order, degree, grading):
    """Where it ends they were askew by half of an edge's angle, and where unlike edges meet: a pin was wedged there."""
    interface = pair_interface(assemble(BUSH, degree, order=order, quarters=2, grading=grading), ["joint"])
    assert len(interface.area) == 8 * degree + 1
    outward = interface.position / np.linalg.norm(interface.position, axis=1, keepdims=True)
    np.testing.assert_allclose(interface.normal, outward, atol=1e-9)


def test_only_round_parts_of_a_flank_have_normals_of_circles():
    """Straight, with edges of 3 and 1, then round with edges of 0.1, and its last edge straight on, of 1."""
    turn = np.radians([0, 0, 0, 6, 12, 18, 24, 27, 27])
    length = np.array([3, 1, 1, 0.1, 0.1, 0.1, 0.1, 1, 1])
    steps = length[:, None] * np.column_stack([np.cos(turn), np.sin(turn)])
    position = np.vstack([np.zeros(2), np.cumsum(steps, axis=0)])
    means = np.zeros_like(position)
    for k, (x, y) in enumerate(steps):
        means[k : k + 2] += 0.5 * np.array([y, -x])
    straight = means / np.linalg.norm(means, axis=1, keepdims=True)
    normal = point_outward(position, means, [[(k, k + 1)] for k in range(len(steps))])
    round_ = [4, 5]
    along = np.radians([9, 15])
    np.testing.assert_array_equal(np.delete(normal, round_, axis=0), np.delete(straight, round_, axis=0))
    np.testing.assert_allclose(normal[round_], np.column_stack([np.sin(along), -np.cos(along)]), atol=1e-12)


@pytest.mark.parametrize("grading", [1.0, 1.2])
@pytest.mark.parametrize("degree", [1, 2])
def test_normals_of_hexahedra_in_a_part_of_a_bore_are_those_of_the_circle(degree, grading):
    """At its ends they were askew by half of a face's angle, those between the corners of its last edges as well."""
    made = {"profile": str(BUSH), "depth": 0.01, "layers": 2, "quarters": 2, "grading": grading}
    interface = pair_interface(assemble(EXTRUDED, degree, **made), ["joint"])
    assert len(interface.area) == (8 * degree + 1) * (2 * degree + 1)
    outward = interface.position * (1, 1, 0)
    outward /= np.linalg.norm(outward, axis=1, keepdims=True)
    np.testing.assert_allclose(interface.normal, outward, atol=1e-9)


def test_normals_of_a_patch_of_a_ball_are_those_of_the_ball_and_flat_ones_stay():
    """Both lines of edges through a node bend; of 3 x 4 quadrilaterals, unlike in both directions."""
    number = np.arange(20).reshape(5, 4)
    facets = [
        [(a, b), (a, c), (b, d), (c, d)]
        for a, b, c, d in zip(
            number[:-1, :-1].ravel(),
            number[:-1, 1:].ravel(),
            number[1:, :-1].ravel(),
            number[1:, 1:].ravel(),
            strict=True,
        )
    ]
    u, v = np.meshgrid([0.2, 0.45, 0.75, 1.1], [-0.4, 0.0, 0.35, 0.65, 0.9])
    ball = np.stack([np.cos(u) * np.cos(v), np.sin(u) * np.cos(v), np.sin(v)], axis=-1).reshape(-1, 3)
    flat = np.stack([u, v, 0.3 * u], axis=-1).reshape(-1, 3)
    for position, found in ((ball, ball), (flat, None)):
        means = np.zeros_like(position)
        for (a, b), (_, c), (_, d), _ in facets:
            means[[a, b, c, d]] += np.cross(position[b] - position[c], position[d] - position[a])
        means *= np.sign(means @ [1.0, 0.0, 0.0] if found is not None else -means[:, 2])[:, None]
        unit = means / np.linalg.norm(means, axis=1, keepdims=True)
        normal = point_outward(position, means, facets)
        if found is None:
            np.testing.assert_array_equal(normal, unit)
        else:
            assert np.abs(unit - found).max() > 0.1
            np.testing.assert_allclose(normal, found, atol=1e-12)


@pytest.mark.parametrize("bodies", [("blade", "disk"), ("disk", "blade")])
def test_bodies_on_the_same_side_of_their_flank_are_refused(bodies):
    """The blade hangs down from its joint into the disk."""
    structure = assemble(blade_height=-0.01)
    words = (
        rf'flank "joint": {bodies[0]} and {bodies[1]} lie on the same side of it at \(0\.04, 0\.03\) m: they overlap'
    )
    with pytest.raises(InterfaceError, match=words):
        pair_interface(structure, body_a=bodies[0], body_b=bodies[1])


@pytest.mark.parametrize("gap", [0.0, 1e-3])
@pytest.mark.parametrize(
    ("cover", "words"),
    [
        ("cover", "lies on .*, face to face, .* make cover a part of disk; if they are glued"),
        ("blade", "lies on two pieces of blade, .* make one of them a part of blade, the other of disk;"),
        ("disk", "lies on .* and .*, .* name it in contact.flanks;"),
    ],
)
def test_bodies_face_to_face_on_a_boundary_that_is_no_flank_are_told(cover, words, gap):
    """The blade lifts off into its cover, and through it."""
    (doubt,) = doubt_boundaries(assemble(PILE, cover=cover, gap=gap), ["joint"], "blade", "disk", ["clamp"])
    assert re.search(f'boundary "lid" {words}', doubt), doubt


@pytest.mark.parametrize(
    ("source", "given"),
    [
        (PILE, {"glued": True}),
        (PILE, {"lid": "clamp"}),
        (PILE, {"gap": 0.004}),
        (PILE.with_name("flush_blocks.py"), {}),
        (PILE.with_name("stacks.py"), {"stacks": 2, "loose": True}),
        (PILE.with_name("shrouds.py"), {}),
        (PILE.with_name("welded_fir_tree.py"), {}),
        (BUSH, {}),
        (CORNERED, {"flanks": 2}),
        *((scene.geometry.source, scene.geometry.parameters) for scene in DEMOS.values()),
    ],
    ids=lambda given: getattr(given, "stem", ""),
)
def test_other_boundaries_raise_no_doubts(source, given):
    """Those whose curves are flush, apart, glued or held; no scene of the gallery has a joint that is left out."""
    structure = assemble(source, **given)
    joint = {"flush_blocks": ["joint"], "shrouds": ["face"], "cornered": ["floor", "wall"], "bush": ["joint"]}
    flanks, bodies = joint.get(source.stem, ["joint"]), list(structure.mesh.bodies)[:2]
    if source.stem in DEMOS and source.parent == ROOT / "geometry":
        contact = DEMOS[source.stem].contact
        bodies = contact.body_a, contact.body_b
        alone = contact.body_b not in structure.mesh.bodies  # all flanks are between sectors
        flanks = () if alone else pair_interface(structure, contact.flanks, *bodies).flanks
    assert list(doubt_boundaries(structure, flanks, *bodies, ["clamp"])) == []
