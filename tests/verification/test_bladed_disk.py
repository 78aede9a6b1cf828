"""A sector with `[cyclic]` against the whole wheel, which is meshed and solved without any cyclic symmetry.

The wheel's blades lean and are loaded askew: a wave that travels the wrong way round is another one.
"""

from __future__ import annotations

from contextlib import nullcontext
from dataclasses import replace
from functools import lru_cache
from math import cos, pi, sin
from pathlib import Path

import numpy as np
import pytest

from ewr_fenicsx import ContactLaws, ContactProblem, ReducedModel, integrate, load_scene, solve, unroll_ring
from ewr_fenicsx.errors import MeshError, SceneError
from ewr_fenicsx.model.restriction import solve_stuck
from ewr_fenicsx.structure.chain import build_chain
from ewr_fenicsx.structure.sector_cuts import find_cuts

TESTS = Path(__file__).parents[1]
WHEEL = TESTS / "geometry" / "wheel.py"
EXTRUDED = TESTS.parent / "geometry" / "extruded.py"
SCENE = """
[geometry]
source = "{source}"
[geometry.parameters]
sectors = {sectors}
whole = {whole}
{parameters}
[materials.disk]
young = 60e9
[supports]
clamp = ["hub"]
{supports}
[damping]
kind = "rayleigh"
alpha = 400.0
beta = 2e-7
[contact]
friction = 0.15
[excitation]
frequency = 2000.0
"""
LOADS = """
[loads.press_{j}]
boundary = "tip_{j}"
force = {press}
[loads.shake_{j}]
boundary = "tip_{j}"
force = {shake}
harmonic = 1
phase = {phase}
[loads.spit_{j}]
boundary = "floor_{j}"
force = {spit}
harmonic = 2
phase = {twice}
[outputs.tip_{j}]
boundary = "tip_{j}"
direction = {along}
[outputs.floor_{j}]
boundary = "floor_{j}"
direction = {along}
"""
RING = """
[cyclic]
sectors = {sectors}
engine_order = {engine_order}
low = "low"
high = "high"
"""
FLANKS = 'flanks = { shroud = ["ahead", "behind"] }\n'
SOLID = {
    "source": EXTRUDED,
    "parameters": f'profile = "{WHEEL}"\nlayers = 1\ndepth = 0.01\n',
    "supports": 'hold = { back_blade = "z", back_disk = "z" }',
}
# kinds of meshes: those of second degree and solids take the coarsest plane one
KINDS = {
    "plane": {"parameters": "beside = 2", "rest": ""},
    "held cuts": {"parameters": "beside = 2\nwhole_hub = true", "rest": ""},
    "second degree": {"rest": "[elasticity]\ndegree = 2\n"},
    "solid": SOLID,
    "plain shrouds": {"parameters": "shrouds = true"},
    "shrouds": {"parameters": "shrouds = true", "flanks": FLANKS},
    "shrouds of second degree": {
        "parameters": "shrouds = true",
        "flanks": FLANKS,
        "rest": "[elasticity]\ndegree = 2\n",
    },
    "solid shrouds": SOLID | {"parameters": SOLID["parameters"] + "shrouds = true\n", "flanks": FLANKS},
}


def write_wheel(folder, kind, *, sectors, whole, engine_order, modes, ring=RING):
    """A scene; loads and outputs of every sector are turned with it, and those that oscillate lag."""
    made = {"source": WHEEL, "parameters": "", "supports": "", "rest": "", "flanks": ""} | KINDS[kind]
    text = SCENE.format(sectors=sectors, whole=str(whole).lower(), **made)
    for j in range(sectors if whole else 1):
        angle = 2 * pi * j / sectors
        rest = [0.0] if made["source"] == EXTRUDED else []
        turn = lambda x, y, a=angle, r=rest: [x * cos(a) - y * sin(a), x * sin(a) + y * cos(a), *r]  # noqa: E731
        phase = -360 * engine_order * j / sectors
        text += LOADS.format(
            j=j, press=turn(0.0, -400.0), shake=turn(40.0, 200.0), spit=turn(300.0, 100.0), along=turn(1.0, 0.5),
            phase=phase, twice=2 * phase,
        )  # fmt: skip
    text += "" if whole else ring.format(sectors=sectors, engine_order=engine_order) + made["flanks"]
    path = folder / "wheel.toml"
    path.write_text(f"{text}\n{made['rest']}\n[reduction]\nmodes = {modes}\n")
    return load_scene(path)


@pytest.fixture(scope="module")
def build(tmp_path_factory):
    """Chains that keep all modes, with which the reduction is exact."""
    folder = tmp_path_factory.mktemp("wheels")

    @lru_cache
    def build_exactly(kind, sectors, whole, engine_order=1):
        case = {"sectors": sectors, "whole": whole, "engine_order": engine_order}
        most = build_chain(write_wheel(folder, kind, modes=1, **case)).reduction.most_modes
        return build_chain(write_wheel(folder, kind, modes=most, **case))

    return build_exactly


def pose(model, sectors, frequency=2000.0, harmonics=5, **options):
    """With weights that do not depend on how much of the wheel there is; as many samples as sectors, times some."""
    options = {"samples": 40 * sectors, "rho_normal": 1e8, "rho_tangential": 4e-5, "closure": "dashpot"} | options
    return ContactProblem(model, ContactLaws(friction=0.15), frequency=frequency, harmonics=harmonics, **options)


def find_pairs(sector, whole, j, sectors):
    """Numbers of the whole wheel's pairs that are those of the sector, in its order, turned to the j-th one."""
    angle, places = 2 * pi * j / sectors, sector.interface.position.copy()
    x, y = places[:, 0].copy(), places[:, 1].copy()
    places[:, 0], places[:, 1] = x * cos(angle) - y * sin(angle), x * sin(angle) + y * cos(angle)
    distance = np.linalg.norm(whole.interface.position - places[:, None], axis=2)
    assert distance.min(axis=1).max() < 1e-9
    return distance.argmin(axis=1)


@pytest.mark.parametrize(
    ("kind", "sectors"),
    [
        *(("plane", sectors) for sectors in (5, 4, 2)),
        *((kind, 3) for kind in ("held cuts", "second degree", "solid", "shrouds", "solid shrouds")),
    ],
)
def test_waves_of_a_sector_have_all_the_modes_of_the_wheel(build, kind, sectors):
    """Once each where sectors move in phase or in turn, else twice."""
    model = build(kind, sectors, False).reduction.model
    waves = [np.sqrt(solve_stuck(model, wave)[0]) for wave in range(sectors)]
    for wave in range(1, sectors):
        np.testing.assert_allclose(waves[wave], waves[-wave], rtol=1e-9)
    whole = build(kind, sectors, True).reduction
    expected = np.sqrt(solve_stuck(whole.model)[0])
    np.testing.assert_allclose(np.sort(np.concatenate(waves)), expected, rtol=1e-8)
    np.testing.assert_allclose(2 * pi * whole.full_stick.frequency, expected[:6], rtol=1e-7)
    apart = [np.abs(waves[k][:6] / waves[k + 1][:6] - 1).max() for k in range(sectors // 2)]
    assert min(apart) > 1e-3, "neighbours must feel each other, or this proves nothing"


@pytest.mark.parametrize(
    ("kind", "sectors", "engine_order"),
    [
        *(("plane", 4, order) for order in (0, 1, 2, -1)),
        ("plane", 5, 2),
        ("plane", 5, -1),
        ("plane", 2, 1),
        ("held cuts", 3, 1),
        ("second degree", 3, 1),
        ("solid", 3, 1),
        *(("shrouds", 4, order) for order in (0, 1, 2)),
        ("shrouds", 5, -1),
        ("shrouds of second degree", 3, 1),
        ("solid shrouds", 4, 1),
    ],
)
def test_a_sector_does_what_every_sector_of_the_wheel_does(build, kind, sectors, engine_order):
    """Slip and lift-off, also of shrouds: outputs and forces of each blade are those of the sector, later."""
    sector, wheel = (build(kind, sectors, whole, engine_order) for whole in (False, True))
    frequency = 1500.0 if "shrouds" in kind else 2000.0  # where there is one solution
    models = (chain.reduction.model for chain in (sector, wheel))
    one, all_of_them = (solve(pose(model, sectors, frequency), tolerance=1e-11) for model in models)
    assert len(one.problem.system.rows) * sectors == len(all_of_them.problem.system.rows)
    samples = one.problem.basis.samples
    force = one.history("normal_force", samples)
    opens = (force < 1e-9 * force.max()).any(axis=0)
    assert opens.any() and one.merit["friction_dissipation"] > 0
    if "shrouds" in kind:
        beyond = sector.interface.is_next
        assert opens[beyond].any() and np.ptp(force[:, beyond], axis=0).max() > 5.0
    assert sector.reduction.model.size * sectors == wheel.reduction.model.size
    for j in range(sectors):
        lag = np.exp(-2j * pi * engine_order * j / sectors * np.array(one.orders))
        for name in ("tip", "floor"):  # of the disk, whose motion is the neighbours', too
            mine, theirs = one.output(f"{name}_0"), all_of_them.output(f"{name}_{j}")
            np.testing.assert_allclose(theirs, lag * mine, atol=1e-9 * np.abs(mine).max(), err_msg=name)
        pairs = find_pairs(sector, wheel, j, sectors)
        for name in ("normal_force", "friction_force", "slip", "gap"):
            mine, theirs = (solution.history(name, samples) for solution in (one, all_of_them))
            later = np.roll(mine, engine_order * j * samples // sectors, axis=0)
            np.testing.assert_allclose(theirs[:, pairs], later, atol=1e-8 * np.abs(mine).max(), err_msg=name)


def test_merit_of_a_sector_is_that_of_the_wheel_a_sector(build):
    one, four = (solve(pose(build("plane", 4, whole).reduction.model, 4)).merit for whole in (False, True))
    for name in ("excitation_work", "viscous_dissipation", "friction_dissipation"):
        assert 4 * one[name] == pytest.approx(four[name], rel=1e-8), name
    for name in ("penetration", "tension", "largest_normal_force", "cone_violation", "J_T", "J_N"):
        assert one[name] == pytest.approx(four[name], rel=1e-7), name
    for name in ("rms_tip", "rms_floor"):
        assert [one[f"{name}_0"]] * 4 == pytest.approx([four[f"{name}_{j}"] for j in range(4)], rel=1e-8)


@pytest.mark.parametrize("engine_order", [1, -1])
def test_the_wheel_settles_in_time_to_the_wave_that_a_sector_finds(build, engine_order):
    """From rest, by a formulation that knows neither harmonics nor waves."""
    model = build("plane", 3, False, engine_order).reduction.model
    usual = {"harmonics": 15, "samples": None, "rho_normal": None, "rho_tangential": None, "closure": "mass"}
    wave = solve(pose(model, 3, **usual))
    steady = integrate(pose(unroll_ring(model), 3, **usual), "rest", steps=1200, periods=150, theta=0.52)
    assert steady.converged, steady.reason
    for name in ("tip_0", "floor_0"):
        found = wave.output(name)
        for j in range(3):
            lag = np.exp(-2j * pi * engine_order * j / 3 * np.array(wave.orders))
            np.testing.assert_allclose(steady.output(f"{name}_{j}"), lag * found, atol=0.01 * np.abs(found[1:]).max())


@pytest.mark.parametrize("wrong", [1, -2, 0, 4])
def test_waves_of_other_engine_orders_differ(build, wrong):
    """Or else the comparisons with the wheel would prove nothing; but sectors cannot tell orders from those N apart."""
    one, other = (
        solve(pose(build("plane", 5, False, order).reduction.model, 5)).output("tip_0") for order in (-1, wrong)
    )
    apart = np.abs(one - other).max() / np.abs(one).max()
    assert apart < 1e-12 if wrong == 4 else apart > 0.01, apart


@pytest.mark.parametrize(
    ("change", "told"),
    [
        ({"ring": RING.replace('w = "low"', 'w = "high"').replace('h = "high"', 'h = "low"')}, "which cut is low"),
        ({"ring": RING.replace("{sectors}", "6")}, "6 sectors, of 60 degrees each: turned about the axis, the nodes"),
        ({"ring": RING + "centre = [0.0, 1e-4]\n"}, "turned about the axis, the nodes of low are up to 0.000118 m"),
        ({"parameters": "miss = 1e-5"}, "the nodes of low are up to 1e-05 m from those of high"),
    ],
)
def test_cuts_that_do_not_fit_are_refused(tmp_path, monkeypatch, change, told):
    monkeypatch.setitem(KINDS, "bad", {"parameters": change.get("parameters", "")})
    ring = change.get("ring", RING)
    with pytest.raises(MeshError, match=told):
        build_chain(write_wheel(tmp_path, "bad", sectors=5, whole=False, engine_order=1, modes=3, ring=ring))


def test_cuts_with_other_numbers_of_nodes_are_refused(tmp_path):
    """Here with the face of a shroud in place of one of them."""
    ring = RING.replace('high = "high"', 'high = "ahead"')
    with pytest.raises(MeshError, match="2 nodes on low, and 3 on ahead; mesh both cuts alike"):
        build_chain(write_wheel(tmp_path, "plain shrouds", sectors=5, whole=False, engine_order=1, modes=3, ring=ring))


@pytest.mark.parametrize(
    ("change", "error", "told"),
    [
        (
            lambda s, i, cuts: (s, replace(i, nodes_a=i.nodes_a * 0 + cuts.low[0] // 2)),
            MeshError,
            "1 nodes of the cuts",
        ),
        (
            lambda s, i, cuts: (replace(s, fixed_dofs=np.append(s.fixed_dofs, cuts.low[-1])), i),
            SceneError,
            "supports hold nodes of low otherwise than those of high",
        ),
    ],
)
def test_cuts_in_contact_or_held_unlike_each_other_are_refused(build, change, error, told):
    chain = build("plane", 5, False)
    cuts = chain.reduction.cuts
    with pytest.raises(error, match=told):
        find_cuts(*change(chain.structure, chain.interface, cuts), cuts.ring)


def test_an_engine_order_beyond_all_reason_is_refused(tmp_path):
    with pytest.raises(SceneError, match=r"cyclic\.engine_order = 10000000: should be less than or equal to 100000"):
        write_wheel(tmp_path, "plane", sectors=5, whole=False, engine_order=10_000_000, modes=3)


def test_a_ring_spins_about_its_own_axis(tmp_path, monkeypatch):
    spin = '[loads.spin]\nkind = "rotation"\nspeed = 3000.0\ncentre = [0.0, {y}]\n'
    for y in (0.0, 1e-17, 1e-3):
        monkeypatch.setitem(KINDS, "spun", {"rest": spin.format(y=y)})
        scene = write_wheel(tmp_path, "spun", sectors=5, whole=False, engine_order=1, modes=3)
        with (
            pytest.raises(SceneError, match=r"loads\.spin turns the ring about another axis")
            if y > 1e-9
            else nullcontext()
        ):
            build_chain(scene)


def test_a_sector_is_read_as_it_was_written(build, tmp_path):
    """With what outputs of the disk see of the next sector."""
    model = build("plane", 4, False).reduction.model
    model.save(tmp_path / "sector.h5")
    read = ReducedModel.load(tmp_path / "sector.h5")
    assert list(read.cyclic.outputs) == ["floor_0"]
    order = [list(read.outputs).index(name) for name in model.outputs]
    for wave in range(4):
        np.testing.assert_array_equal(read.read_outputs(wave)[order], model.read_outputs(wave))
        np.testing.assert_array_equal(read.matrix("stiffness", wave), model.matrix("stiffness", wave))
    first, again = (solve(pose(one, 4)).output("floor_0") for one in (model, read))
    np.testing.assert_array_equal(again, first)
