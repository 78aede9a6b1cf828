"""Scenes as a whole: flanks with laws of their own, what contradicts itself, what was probably not meant."""

from __future__ import annotations

import json
import re
import warnings
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from small_scenes import AT, HEAD, PULL, SCENE, SHAKE

from ewr_fenicsx.errors import SceneError, SceneWarning
from ewr_fenicsx.scene.effects import list_effects
from ewr_fenicsx.scene.scene import Scene, load_scene
from ewr_fenicsx.structure.chain import check_flanks, lay_laws, spread_wear

ROOT = Path(__file__).parents[2]
JOINT = SimpleNamespace(flanks=("left", "right", "top"), flank_of_pair=np.array([0, 0, 1, 1, 1, 2]))


def test_flanks_have_what_the_contact_says_and_what_is_special(read):
    scene = read(
        SCENE + "[contact]\nfriction = 0.3\n[flanks.left]\ntangential = 'bonded'\nnormal = 'bonded'\n"
        "[flanks.top]\nfriction = 0.5\ninitial_gap = 2e-6\n"
    )
    (left, bonded), (right, usual), (top, special) = lay_laws(scene, JOINT)
    assert (left, right, top) == ([0, 1], [2, 3, 4], [5])
    assert (bonded.normal, bonded.tangential) == ("bonded", "bonded")
    assert (usual.normal, usual.tangential, usual.friction, usual.initial_gap) == ("unilateral", "coulomb", 0.3, 0.0)
    assert (special.normal, special.friction, special.initial_gap) == ("unilateral", 0.5, 2e-6)


def test_flanks_with_the_same_laws_are_one_group(read):
    scene = read(
        SCENE + "[flanks.left]\nfriction = 0.5\n[flanks.top]\nfriction = 0.5\n[flanks.right]\nfriction = 0.2\n"
    )
    assert [pairs for pairs, _ in lay_laws(scene, JOINT)] == [[0, 1, 5], [2, 3, 4]]
    assert lay_laws(read(SCENE)).friction == 0.2, "one law for all: no groups, and no interface needed"
    with pytest.raises(SceneError, match=r"have laws of their own; .*'s interface as well, or take .*\.pose\(\)"):
        lay_laws(scene)


def test_unknown_flanks_are_named(read):
    with pytest.raises(SceneError, match=r'flanks\.lefd: the joint has no flank of that name.*did you mean "left"\?'):
        check_flanks(read(SCENE + "[flanks.lefd]\nfriction = 0.1\n"), JOINT)


def test_wear_coefficients_by_flank(read):
    wear = "[wear]\ncoefficient = 2e-11\n"
    scene = read(SCENE + wear + "[flanks.left]\ntangential = 'bonded'\n[flanks.top]\nwear = 5e-11\n")
    np.testing.assert_array_equal(spread_wear(scene, JOINT), [0, 0, 2e-11, 2e-11, 2e-11, 5e-11])
    np.testing.assert_array_equal(spread_wear(read(SCENE), JOINT), np.zeros(6))
    smooth = read(SCENE + wear + "[flanks.left]\ntangential = 'frictionless'\n")
    np.testing.assert_array_equal(spread_wear(smooth, JOINT), np.full(6, 2e-11))  # what slides wears
    none = read(SCENE + wear + "[flanks.right]\nwear = 0\n")
    np.testing.assert_array_equal(spread_wear(none, JOINT), [2e-11, 2e-11, 0, 0, 0, 2e-11])


@pytest.mark.parametrize(
    "frequency, expected",
    [
        ("1000", (1000.0,)),
        ("[900, 1000, 1100]", (900.0, 1000.0, 1100.0)),
        ("{ from = 900, to = 1100, points = 5 }", (900.0, 950.0, 1000.0, 1050.0, 1100.0)),
    ],
)
def test_frequencies(read, frequency, expected):
    scene = read(HEAD + PULL + SHAKE + f"[excitation]\nfrequency = {frequency}\n")
    assert scene.frequencies == expected
    again = Scene.model_validate(json.loads(scene.model_dump_json(by_alias=True)))
    assert again.model_dump() == scene.model_dump() and again.frequencies == expected


def test_a_static_scene_needs_no_frequency(read):
    scene = read(HEAD + PULL)
    assert scene.frequencies == () and scene.doubts == ()


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        (
            SCENE + "[wear]\n[contact]\ntangential = 'bonded'",
            'wear without a contact that slides and opens: contact has normal = "unilateral" and tangential = '
            '"bonded"',
        ),
        (SCENE + "[wear]\n[contact]\nnormal = 'bonded'\ntangential = 'bonded'", "remove [wear], or set normal"),
        (
            SCENE + "[wear]\n[flanks.left]\ntangential = 'bonded'\nwear = 1e-11",
            'flanks.left.wear = 1e-11: with normal = "unilateral", tangential = "bonded" nothing slides and opens',
        ),
        (SCENE + "[flanks.left]\nwear = 1e-11", "flanks.left.wear = 1e-11: nothing wears without [wear]"),
        (HEAD + PULL + "[wear]\n", "wear, and no load oscillates: nothing slides; was harmonic = 1 meant"),
        (
            HEAD + PULL + SHAKE + "[excitation]\nfrequency = [900, 1000]\n[wear]\n",
            "wear and a sweep over 2 frequencies: cycles of which one?",
        ),
        (
            SCENE + "[flanks.left]\ntangential = 'bonded'\nfriction = 0.4",
            'flanks.left: friction does nothing with tangential = "bonded"; remove it, or set tangential = "coulomb"',
        ),
        (
            SCENE + "[contact]\ntangential = 'bonded'\n[flanks.left]\nfriction = 0.4",
            'flanks.left: friction does nothing with tangential = "bonded", as [contact] has it; remove it',
        ),
        (
            SCENE + "[contact]\ntangential = 'bonded'\nfriction = 0.4",
            'contact: friction does nothing with tangential = "bonded"',
        ),
        (SCENE + "[flanks.left]\nnormal = 'prescribed'", 'flanks.left: normal = "prescribed" needs normal_force [N]'),
        (
            SCENE + "[contact]\nflanks = ['left']\n[flanks.top]\nfriction = 0.4",
            "flanks.top: contact.flanks = ['left'] leave this flank out; add it there",
        ),
        (
            SCENE + "[contact]\nflanks = ['left']\n[flanks.lefd]\nfriction = 0.4",
            "flanks.lefd: contact.flanks = ['left'] leave this flank out; add it there; did you mean \"left\"?",
        ),
        (
            HEAD + PULL + SHAKE + "[excitation]\nfrequency = [1000]",
            "excitation.frequency = [1000]: a sweep over one point; write frequency = 1000",
        ),
        (
            HEAD + PULL + SHAKE + "[excitation]\nfrequency = []",
            "excitation.frequency = []: a sweep over no point; give frequencies that rise, or a single one",
        ),
        (
            HEAD + PULL + SHAKE + "[excitation]\nfrequency = { from = 900, to = 900, points = 7 }",
            "a sweep over one point; write frequency = 900",
        ),
        (
            HEAD + PULL + SHAKE + "[excitation]\nfrequency = { from = 900, to = 950, points = 1 }",
            "excitation.frequency.points = 1: should be greater than or equal to 2",
        ),
        (  # a thousand million of them took all memory
            HEAD + PULL + SHAKE + "[excitation]\nfrequency = { from = 900, to = 950, points = 100001 }",
            "excitation.frequency.points = 100001: should be less than or equal to 100000",
        ),
        *(
            (
                HEAD + PULL + SHAKE + f"[excitation]\nfrequency = {wrong}",
                f"excitation.frequency = {shown}: should be a positive number, a list of them, or a table with from, "
                "to and points; leave it out where nothing oscillates",
            )
            for wrong, shown in (("0", "0"), ("-3.0", "-3.0"), ("'140'", "'140'"), ("inf", "inf"), ("true", "True"))
        ),
        (
            HEAD + PULL + SHAKE + "[excitation]\nfrequency = [0.0, 3.0]",
            "scene.toml: excitation.frequency.0 = 0.0: should be greater than 0",
        ),
        (
            HEAD + PULL + SHAKE + "[excitation]\nfrequency = { from = 0, to = 3, points = 2 }",
            "scene.toml: excitation.frequency.from = 0: should be greater than 0",
        ),
        (HEAD + PULL + SHAKE + "[excitation]\nfrequency = {from = 3, to = 9}", "excitation.frequency.points: missing"),
        (HEAD + PULL + SHAKE + "[excitation]\nfrequency = [900, 900]", "should be frequencies that rise"),
        (
            HEAD + PULL + SHAKE + "[excitation]\nfrequency = { from = 950, to = 900, points = 3 }",
            "from should be below to",
        ),
        (
            HEAD + PULL + SHAKE + "[excitation]\nfrequency = { form = 900, to = 950, points = 2 }",
            'excitation.frequency.form = 900: unknown key; did you mean "from"?',
        ),
        (
            HEAD + PULL + "[excitation]\nfrequency = [900, 1000]",
            "excitation.frequency is a sweep over 2 frequencies, and no load oscillates: every point would be the same",
        ),
        (HEAD + PULL + SHAKE, 'excitation.frequency: missing, and the load "shake" oscillates'),
        (
            SCENE + "[supports]\nclamp = []",
            'supports.clamp = []: nothing carries the static load "pull"',
        ),
        (
            SCENE + "[solver]\nharmonics = [0, 2]",
            'solver.harmonics = [0, 2] leave out harmonic 1, at which the load "shake" acts; include it',
        ),
        (SCENE + "[solver]\nharmonics = 0", "solver.harmonics = [0] leave out harmonic 1"),
        (
            SCENE + "[solver]\nharmonics = 3\nsamples = 6",
            "solver.samples = 6 a period cannot resolve harmonic 3; give at least 7",
        ),
        (
            SCENE + "[loads.base]\nboundary = 'clamp'\nforce = [1, 0]\nharmonic = 1",
            'loads.base.boundary = "clamp": supports.clamp holds it, so that the force does nothing; name a boundary',
        ),
        (
            SCENE + "[outputs.base]\nboundary = 'clamp'\ndirection = [1, 0]",
            'outputs.base.boundary = "clamp": supports.clamp holds it, so that it never moves; name a boundary that is',
        ),
        (
            SCENE + "[supports.hold]\nclamp = 'x'",
            'supports.hold.clamp = "x": supports.clamp holds it in all directions; give one',
        ),
        (
            SCENE + "[supports.hold]\ntip = 'x'",
            'loads.shake.boundary = "tip": supports.hold holds it along x, so that the force does nothing; name a',
        ),
        (
            SCENE + "[supports.hold]\nside = 'xz'\n[outputs.side]\nboundary = 'side'\ndirection = [1, 0, 1]",
            'outputs.side.boundary = "side": supports.hold holds it along x and z, so that it never moves; name a',
        ),
        (SCENE + "[supports.hold]\nside = 'w'", "supports.hold.side = 'w': should be 'x', 'y', 'z', 'xy', 'xz' or 'y"),
        (
            HEAD + SHAKE + "[excitation]\nfrequency = 900.0\n[solver]\nharmonics = [1, 2, 3]",
            'solver.harmonics = [1, 2, 3] leave out harmonic 0, and contact.normal = "unilateral" may part: a normal',
        ),
        (
            HEAD + SHAKE + AT + "[contact]\nnormal = 'prescribed'\nnormal_force = 2\n[solver]\nharmonics = [1, 3]",
            "solver.harmonics = [1, 3] leave out harmonic 0, at which contact.normal_force acts; include it",
        ),
    ],
)  # fmt: skip
def test_contradictions_are_errors_that_say_what_was_meant(read, text, expected):
    with pytest.raises(SceneError) as caught:
        read(text)
    assert expected in str(caught.value)


def test_all_contradictions_come_at_once(read):
    with pytest.raises(SceneError, match="2 mistakes"):
        read(SCENE + "[solver]\nharmonics = [1]\n[flanks.left]\nwear = 1e-11")


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        (SCENE + "[contact]\nfriction = 0", 'contact.friction = 0: friction that never resists.*"frictionless" meant'),
        (SCENE + "[flanks.left]\nfriction = 0", "flanks.left.friction = 0: friction that never resists"),
        (SCENE + "[contact]\nfriction = 30", r"contact.friction = 30 is that of no dry joint; was 0.3 \(given in per"),
        (SCENE + "[wear]\ncycles = 100000000", r"wear.cycles = 100000000: every one of them is solved; give wear.tol"),
        (HEAD + SHAKE + AT, 'contact.normal = "unilateral", and no load is static: nothing presses the joint together'),
        (HEAD + PULL + AT, "excitation.frequency = 1000: no load oscillates, so that it does nothing"),
        (
            HEAD + PULL + SHAKE + "[excitation]\nfrequency = [900, 1000]",
            "excitation.frequency is a sweep, and there are no outputs",
        ),
        (SCENE + "[materials.blade]\nyoung = 210", r"materials.blade.young = 210 Pa .* was 210e9 Pa \(GPa\) meant"),
        (SCENE + "[materials.blade]\nyoung = 113800.0", r"young = 113800 Pa .* was 113800e6 Pa \(MPa\) meant"),
        (SCENE + "[materials.disk]\ndensity = 4.43", r"disk.density = 4.43 kg/m\^3 .* was it given in g/cm"),
        (SCENE + "[materials.disk]\ndensity = 4.43e6", r"density = 4.43e\+06 kg/m\^3 is that of no solid"),
        (SCENE + "[damping]\nratios = [0.2, 0.3]", r"damping.ratios: 0.3 .* was 0.003 \(given in per cent\) meant"),
        (SCENE + "[damping]\nkind = 'modal'\nratio = 0.5", r"damping.ratio: 0.5 of .* was 0.005 \(given in per cent"),
        (SCENE + "[elasticity]\nthickness = 10", r"elasticity.thickness = 10 m; was 10e-3 \(mm\) meant"),
        (SCENE + "[contact]\ninitial_gap = 0.02", "contact.initial_gap = 0.02 m is no gap of a joint"),
        (SCENE + "[flanks.left]\ninitial_gap = 5", "flanks.left.initial_gap = 5 m is no gap of a joint"),
        (SCENE + "[flanks.left]\ninitial_gap = -2", "flanks.left.initial_gap = -2 m is no interference of a joint"),
        (
            SCENE + "[wear]\ncoefficient = 1e-5",
            r"wear.coefficient = 1e-05 1/Pa .* was 1e-14 \(given in mm\^3/\(N m\)\) or 1e-11 \(given in 1/MPa",
        ),
        (SCENE + "[wear]\n[flanks.left]\nwear = 1e-3", "flanks.left.wear = 0.001 1/Pa is far above that of any joint"),
        (
            SCENE + "[contact]\nnormal = 'bonded'\ntangential = 'bonded'\n[solver]\nrho_normal = 1e9",
            'solver.rho_normal = 1e[+]09 does nothing: no flank has the law "unilateral"',
        ),
        (
            SCENE + "[contact]\ntangential = 'bonded'\n[solver]\nrho_tangential = 1e-9",
            'solver.rho_tangential = 1e-09 does nothing: no flank has the law "coulomb"',
        ),
    ],
)  # fmt: skip
def test_doubts_are_warnings_that_say_what_was_probably_meant(read, text, expected):
    with pytest.warns(SceneWarning, match=expected):
        scene = read(text, warn=True)
    assert len(scene.doubts) == 1


@pytest.mark.parametrize("pressed", ["initial_gap = -1e-5", 'normal = "prescribed"\nnormal_force = 100.0'])
def test_interference_or_a_given_force_on_a_flank_presses_the_joint(read, pressed):
    """Also what meets on other flanks, as plates do under the heads of bolts."""
    own = "[flanks.left]\n"
    assert not any("nothing presses" in line for line in read(HEAD + SHAKE + AT + own + pressed).doubts)
    assert any("nothing presses" in line for line in read(HEAD + SHAKE + AT + own + "initial_gap = 1e-5").doubts)


def test_a_doubt_about_the_joint_is_told_once_and_where_it_stands(read):
    """Flanks that have it from [contact], or whose law does not read it, do not tell it again."""
    flanks = "[flanks.left]\nnormal = 'bonded'\n[flanks.right]\nwear = 0.0\n[wear]\n"
    told = read(SCENE + "[contact]\ninitial_gap = 0.02\nfriction = 20\n" + flanks).doubts
    units = [doubt for doubt in told if "joint" in doubt and "given in" in doubt]
    assert [doubt.partition(" m ")[0].partition(" is ")[0] for doubt in units] == [
        "contact.initial_gap = 0.02",
        "contact.friction = 20",
    ]


def test_a_cycle_jump_may_not_be_all_wrong(read):
    with pytest.raises(SceneError, match=r"wear\.tolerance = 1\.0: should be less than 1"):
        read(SCENE + "[wear]\ntolerance = 1.0")


@pytest.mark.parametrize("path", sorted(ROOT.glob("demos/*.toml")), ids=lambda path: path.stem)
def test_demo_scenes_raise_no_doubts(path):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert load_scene(path).doubts == ()


OWN_LAW = """
from dataclasses import dataclass
from ewr_fenicsx.laws.law_kinds import LawKind, register_law

@register_law("tangential", "greased")
@dataclass(frozen=True)
class Greased(LawKind):
    viscosity: float
    histories = ("slip",)
"""


def test_scenes_may_bring_laws_of_their_own(read, tmp_path):
    (tmp_path / "grease.py").write_text(OWN_LAW)
    own = "[contact]\nlaw_files = ['grease.py']\n[flanks.left]\ntangential = 'greased'\n"
    own += "parameters = { viscosity = 3.0 }\n"
    scene = read(SCENE + own)
    (left, greased), (_, usual) = lay_laws(scene, JOINT)
    assert left == [0, 1] and greased.kinds[1].viscosity == 3.0
    assert usual.tangential == "coulomb" and usual.parameters == {}
    assert read(SCENE + own).laws_on("left").tangential == "greased", "reading it again does no harm"
    with pytest.raises(
        SceneError, match=r'parameters\.viscosty: no law of the joint takes it; did you mean "viscosity"'
    ):
        read(SCENE + own.replace("viscosity =", "viscosty ="))
    with pytest.raises(SceneError, match=r'flanks\.left: friction does nothing with tangential = "greased"'):
        read(SCENE + own + "friction = 0.2\n")


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("tangential = 'coulombe'", r"contact\.tangential = 'coulombe': should be one of .*did you mean \"coulomb\""),
        ("law_files = ['nowhere.py']", r"nowhere\.py cannot be run: FileNotFoundError"),
        ("law_files = ['broken.py']", r"broken\.py cannot be run: ZeroDivisionError: division by zero \(line 1\)"),
        ("law_files = ['leaves.py']", r"leaves\.py cannot be run: SystemExit: 5"),
    ],
)
def test_mistakes_in_own_laws_are_named(read, tmp_path, text, expected):
    (tmp_path / "broken.py").write_text("1 / 0")
    (tmp_path / "leaves.py").write_text("raise SystemExit(5)")
    with pytest.raises(SceneError, match=expected):
        read(SCENE + "[contact]\n" + text)


def test_effects_of_mixed_scenes_say_where_they_come_from(read):
    scene = read(
        HEAD + PULL + SHAKE + "[excitation]\nfrequency = 1000\n[wear]\ncycles = 500\n"
        "[flanks.left]\nnormal = 'bonded'\ntangential = 'bonded'\n[flanks.top]\nfriction = 0.5\n"
    )
    effects = {effect.name: effect for effect in list_effects(scene)}
    assert effects["bonded parts"].why == 'flanks.left.normal = "bonded"; flanks.left.tangential = "bonded"'
    assert effects["friction"].why == (
        'contact.tangential = "coulomb", friction = 0.2; flanks.top.tangential = "coulomb", friction = 0.5'
    )
    assert effects["mixed flanks"].why == "[flanks.left], [flanks.top]"
    assert effects["wear"].on and effects["wear"].why.endswith("500 cycles, on contact, flanks.top")
    assert not effects["frequency sweep"].on and not effects["initial gap"].on
    covered = {effect.name: effect for effect in list_effects(scene, flanks=("left", "top"))}
    assert covered["friction"].why == 'flanks.top.tangential = "coulomb", friction = 0.5', "[contact] holds nowhere"
    assert covered["wear"].why.endswith("500 cycles, on flanks.top")
    own = (
        "[contact]\ninitial_gap = 1e-6\n[wear]\ncycles = 500\n[flanks.top]\nwear = 1e-12\n[flanks.right]\nwear = 0.0\n"
        "[flanks.base]\ninitial_gap = -2e-6\n"
    )
    own += "[flanks.left]\nnormal = 'bonded'\ntangential = 'bonded'\n"
    scene = read(HEAD + PULL + SHAKE + "[excitation]\nfrequency = 1000\n" + own)
    own = {effect.name: effect for effect in list_effects(scene, flanks=("left", "right", "top", "base"))}
    gaps = "flanks.top.initial_gap = 1e-06 m; flanks.right.initial_gap = 1e-06 m"
    assert own["initial gap"].why == gaps, "a bond knows of none"
    assert own["interference"].why == "flanks.base.initial_gap = -2e-06 m"
    assert not effects["interference"].on
    assert own["wear"].why.endswith("500 cycles, on flanks.top (1e-12 1/Pa), flanks.base")
    sweep = read(HEAD + PULL + SHAKE + "[excitation]\nfrequency = { from = 900, to = 1000, points = 11 }\n")
    why = {e.name: e.why for e in list_effects(sweep) if e.on}["frequency sweep"]
    assert why == "11 frequencies, 900 to 1000 Hz"


@pytest.mark.parametrize(
    ("solver", "more", "told"),
    [
        ("accuracy = 0.01\nharmonics = 9", "", "accuracy = 0.01 chooses harmonics itself; give one of the two"),
        ("accuracy = 0.01\nsamples = 99", "", "accuracy = 0.01 chooses samples itself; give one of the two"),
    ],
)
def test_an_accuracy_takes_the_place_of_what_it_chooses(read, solver, more, told):
    with pytest.raises(SceneError, match=re.escape(told)):
        read(f"{SCENE}[solver]\n{solver}\n{more}")


def test_an_accuracy_may_be_asked_of_sweeps_and_of_a_model_with_stated_modes(read):
    """Modes are where it begins, as a mesh is; harmonics would be all that it has."""
    scene = read(SCENE.replace("1000", "[900, 1000]") + "[reduction]\nmodes = 7\n[solver]\naccuracy = 0.01")
    assert (scene.reduction.modes, scene.solver.accuracy) == (7, 0.01)


def test_a_law_of_ones_own_that_opens_is_separation(read, tmp_path):
    law = """
from ewr_fenicsx.laws.law_kinds import register_law
from ewr_fenicsx.laws.unilateral import Unilateral

register_law("normal", "adhesive")(type("Adhesive", (Unilateral,), {"__module__": __name__}))
"""
    (tmp_path / "glue.py").write_text(law)
    scene = read(SCENE + "[contact]\nlaw_files = ['glue.py']\nnormal = 'adhesive'\n[flanks.left]\nnormal = 'bonded'\n")
    effects = {effect.name: effect for effect in list_effects(scene)}
    assert (effects["separation"].on, effects["separation"].why) == (True, 'contact.normal = "adhesive"')
    none = {effect.name: effect for effect in list_effects(scene, flanks=("left",))}["separation"]
    assert (none.on, none.why) == (False, "normal: bonded")


def test_with_an_accuracy_loads_may_have_any_harmonic(read):
    scene = read(SCENE.replace("harmonic = 1", "harmonic = 7") + "[solver]\naccuracy = 0.01")
    assert scene.solver.accuracy == 0.01
