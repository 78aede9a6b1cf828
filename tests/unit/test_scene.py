"""Scenes: what is accepted, what is refused and with which words, and that the reference page says the same."""

from __future__ import annotations

import json
import re
from pathlib import Path

import pytest
from pydantic import ValidationError
from small_scenes import AT, HEAD, SCENE

from ewr_fenicsx.errors import SceneError, SceneWarning
from ewr_fenicsx.scene.effects import list_effects
from ewr_fenicsx.scene.scene import Excitation, Scene, load_scene
from ewr_fenicsx.scene.scene_entries import Section
from ewr_fenicsx.scene.scene_reference import list_sections, write_reference
from ewr_fenicsx.scene.scene_structure import ForceLoad, Geometry, RotationLoad

ROOT = Path(__file__).parents[2]


def test_short_scene_has_the_documented_defaults(read, tmp_path):
    scene = read(SCENE)
    assert scene.geometry.source == tmp_path / "builder.py"
    assert scene.harmonics == (0, 1, 2, 3, 4, 5)
    assert (scene.contact.normal, scene.contact.tangential, scene.contact.friction) == ("unilateral", "coulomb", 0.2)
    assert (scene.damping.kind, scene.damping.ratios, scene.damping.frequencies) == (
        "ratios",
        (0.002, 0.002),
        (500, 3000),
    )
    assert scene.supports.clamp == ("clamp",)
    assert scene.elasticity.thickness == 0.01


@pytest.mark.parametrize(
    ("addition", "expected"),
    [
        ("[contact]\nfrction = 0.3", r'contact\.frction = 0\.3: unknown key; did you mean "friction"\?'),
        ("[contct]\nfriction = 0.3", r'contct = .*unknown key; did you mean "contact"\?'),
        ("[contact]\nharmonics = 3", r"contact\.harmonics = 3: unknown key here; it belongs to \[solver\]"),
        ("[contact]\ntolerance = 1e-5", r'it belongs to \[solver\], or did you mean "pair_tolerance"\?$'),
        (
            "[materials]\nyoung = 1e11",
            r'\[materials\]: "young" stands in no table with a name; write \[materials\.BODY\] above',
        ),
        (
            "[outputs]\nboundary = 'tip'\ndirection = [1, 0]",
            r'toml: \[outputs\]: "boundary" .* write \[outputs\.NAME\] above it$',
        ),
        ("[flanks.left]\nparameters = 3", r"flanks\.left\.parameters = 3: should be a table$"),
        ("[[flanks.left]]\nfriction = 0.1", r"flanks\.left = .*: should be a table, in single brackets$"),
        ("[materials.blade]\nyung = 1.0", r'materials\.blade\.yung = 1\.0: unknown key; did you mean "young"\?'),
        ("[loads.s]\nboundry = 'tip'\nforce = [1, 0]", r'loads\.s\.boundry = .*did you mean "boundary"\?'),
        ("[contact]\nfriction = -0.2", r"contact\.friction = -0\.2: should be greater than or equal to 0"),
        ("[contact]\nfriction = '0.2'", r"contact\.friction = '0\.2': should be a number"),
        ("[contact]\nfriction = true", r"contact\.friction = True: should be a number"),
        ("[solver]\ntolerance = 1e-17", r"solver\.tolerance = 1e-17: should be greater than or equal to 1e-13"),
        ("[solver]\ntolerance = 0.5", r"solver\.tolerance = 0\.5: should be less than or equal to 0\.001"),
        ("[solver]\ntolerance = nan", r"solver\.tolerance = nan: should be a finite number"),
        ("[materials.disk]\npoisson = 0.5", r"materials\.disk\.poisson = 0\.5: should be less than 0\.5"),
        ("[elasticity]\nplane = 'stres'", r"elasticity\.plane = 'stres': should be 'stress' or 'strain'"),
        ("[elasticity]\ndegree = 3", r"elasticity\.degree = 3: should be 1 or 2"),
        ("[elasticity]\ndegree = true", r"elasticity\.degree = True: should be 1 or 2"),
        (f"[elasticity]\ndegree = {10**20}", r"elasticity\.degree = 10+: should be 1 or 2"),
        ("[contact]\nlaw_files = [1]", r"contact\.law_files\.0 = 1: should be a path, in quotes"),
        ("[reduction]\nmodes = 2.5", r"reduction\.modes = 2\.5: should be a whole number"),
        (
            "[loads.s]\nboundary = 'tip'\nforce = [0, 1, 0, 1]",
            r"loads\.s\.force = \[0, 1, 0, 1\]: has too many entries: 4, and only 3 mean something$",
        ),
        ("[loads.s]\nboundary = 'tip'\nforce = [1]", r"loads\.s\.force = \[1\]: has too few entries; give at least 2$"),
        ("[supports]\nclamp = 'clamp'", r"supports\.clamp = 'clamp': should be a list"),
        ("[solver]\nharmonics = '5'", r"solver\.harmonics = '5': should be a whole number, or should be a list"),
        ("[solver]\nharmonics = [1, 3]", r'solver\.harmonics = \[1, 3\] leave out harmonic 0, .* "pull" acts'),
        ("[solver]\nharmonics = 99999", r"solver\.harmonics = 99999: should go up to 255 at most; 5 to 30 are usual"),
        ("[solver]\nharmonics = [0, 1, 300]", r"solver\.harmonics = \[0, 1, 300\]: should go up to 255 at most"),
        ("[solver]\nsamples = 99999", r"solver\.samples = 99999: should be less than or equal to 65536"),
        ("[solver]\nharmonics = [0, 1, 1]", r"solver\.harmonics = \[0, 1, 1\]: should be distinct"),
        ("[loads.s]\nboundary = 'tip'\nforce = [1]", r"loads\.s\.force = \[1\]: has too few entries"),
        ("[loads.s]\nboundary = 'tip'\nforce = [0, 0]", r"loads\.s: the force is zero"),
        (
            "[loads.s]\nboundary = 'tip'\nforce = [1, 0]\nphase = 90",
            r"loads\.s: a static load .* was harmonic = 1 meant\?",
        ),
        ("[loads.s]\nkind = 'rotatoin'\nspeed = 1", r'loads\.s\.kind = \'rotatoin\': should be "force" or "rotation"'),
        ("[loads.s]\nkind = 'rotation'\nspeed = 9000", r"loads\.s\.centre: missing, and it has no default$"),
        (
            "[loads.s]\nkind = 'rotation'\nspeed = 1e200",
            r"loads\.s\.speed = 1e\+200: should be less than or equal to 1",
        ),
        ("[contact]\nfriction = 1e300", r"contact\.friction = 1e\+300: should be less than or equal to 1"),
        ("[wear]\ncycles = 10000000000000000", r"wear\.cycles = 1\d+: should be less than or equal to 1"),
        ("[loads.s]\nkind = 'rotation'\nspeed = 0", r"loads\.s\.speed = 0: should be greater than 0"),
        ("[damping]\nkind = 'rayleigh'\nalpha = 1", r"damping\.beta: missing"),
        ("[damping]\nfrequencies = [3000, 500]", r"damping: the two frequencies should rise"),
        ("[contact]\nnormal = 'bonded'\ninitial_gap = 1e-6", r'initial_gap does nothing with normal = "bonded"'),
        ("[contact]\ntangential = 'bonded'\nfriction = 0.3", r'friction does nothing with tangential = "bonded"'),
        ("[contact]\nnormal = 'prescribed'", r"needs normal_force \[N\]"),
        ("[contact]\nbody_b = 'blade'", r"body_a and body_b should differ"),
        (
            "[outputs.tip]\nboundary = 'tip'\ndirection = [0, 0]",
            r"outputs\.tip\.direction = \[0, 0\]: should not be the zero vector",
        ),
        ("[contact]\nflanks = []", r"contact\.flanks = \[\]: has too few entries; give at least 1$"),
        ("[contact]\n[contact]", r"not valid TOML"),
        (f"[solver]\nharmonics = {'9' * 5000}", r"not valid TOML: Exceeds the limit \(4300 digits\)"),
        (f"[solver]\nharmonics = {'[' * 3000}", r"not valid TOML: lists or tables in one another, too many of them$"),
        ("frequency = 900", r"not valid TOML: a key that was given before \(at end of document\)$"),
        ("[loads.s]\nspeed = 9000", r'loads\.s\.speed = 9000: unknown key; it belongs to kind = "rotation"$'),
        ("[damping]\nratio = 0.01", r'damping\.ratio = 0\.01: unknown key; it belongs to kind = "modal"$'),
        (
            "[outputs]\ntip = 'tip'",
            r'\[outputs\]: "tip" stands in no table with a name; write \[outputs\.NAME\] above it$',
        ),
        ("[loads.s]\nboundary = 'tip'\nforce = []", r"loads\.s\.force = \[\]: has too few entries; give at least 2$"),
        (
            "[solver]\nharmonics = [0, 1.0]",
            r"toml: solver\.harmonics\.1 = 1\.0: .* a whole number, .* exponent: 1$",
        ),
        ("[wear]\ncycles = 1e6", r"wear\.cycles = 1000000\.0: should be a whole number, .* exponent: 1000000$"),
        (
            "[contact]\nnormal = 'Bonded'",
            r"should be one of .*, or of a law that contact\.law_files register; did you mean \"bonded\"\?$",
        ),
    ],
)
def test_mistake_is_named_with_file_key_value_and_expectation(read, tmp_path, addition, expected):
    with pytest.raises(SceneError, match=expected) as caught:
        read(SCENE + addition)
    assert str(caught.value).startswith(f"scene {tmp_path / 'scene.toml'}: ")


def test_scene_that_is_not_utf_8_is_refused_by_its_line(tmp_path):
    (tmp_path / "scene.toml").write_bytes(SCENE.encode() + "\n# Fuß".encode("latin-1"))
    line = SCENE.count("\n") + 2
    with pytest.raises(SceneError, match=rf"not valid TOML: line {line} is not UTF-8; save the file as UTF-8$"):
        load_scene(tmp_path / "scene.toml")


def test_a_mesh_in_place_of_a_scene_is_told_as_such(tmp_path):
    (tmp_path / "joint.msh").write_text("$MeshFormat\n4.1 0 8\n$EndMeshFormat\n")
    with pytest.raises(SceneError, match=r"joint.msh: a mesh; name it in a scene \(.toml\), as geometry.source$"):
        load_scene(tmp_path / "joint.msh")


def test_scene_that_an_editor_marked_as_utf_8_is_read(tmp_path):
    (tmp_path / "builder.py").touch()
    (tmp_path / "scene.toml").write_text(SCENE, encoding="utf-8-sig")
    assert load_scene(tmp_path / "scene.toml").frequencies == (1000,)


def test_all_mistakes_come_at_once(read):
    with pytest.raises(SceneError) as caught:
        read(SCENE + "[contact]\nfriction = -1\n[elasticity]\nthickness = 0")
    assert "2 mistakes" in str(caught.value)
    assert "contact.friction = -1" in str(caught.value)
    assert "elasticity.thickness = 0" in str(caught.value)


def test_missing_tables_and_files_are_named(read, tmp_path):
    with pytest.raises(
        SceneError, match=r'excitation\.frequency: missing, and the load "shake" oscillates; give the frequency'
    ):
        read(SCENE.replace("[excitation]\nfrequency = 1000", ""))
    with pytest.raises(
        SceneError, match=r"loads: missing, and no flank has an interference .* add a table \[loads\.NAME\]$"
    ):
        read(HEAD + AT + "[loads]")
    with pytest.raises(SceneError, match=r"geometry\.source = 'bilder\.py': no such file: .*bilder\.py"):
        read(SCENE.replace("builder.py", "bilder.py"))
    with pytest.raises(SceneError, match=r"should be a builder \(\.py\) or a gmsh mesh \(\.msh\), as gmsh -2 makes it"):
        read(SCENE.replace("builder.py", "builder.step"))
    with pytest.raises(SceneError, match=r"nowhere\.toml: cannot be read: No such file"):
        load_scene(tmp_path / "nowhere.toml")


def test_python_scene_equals_the_file_s(read, tmp_path):
    scene = Scene(
        geometry=Geometry(source=tmp_path / "builder.py"),
        loads={
            "pull": ForceLoad(boundary="tip", force=(0, 20e3)),
            "shake": ForceLoad(boundary="tip", force=(50, 0), harmonic=1),
        },
        excitation=Excitation(frequency=1000),
    )
    assert scene.model_dump() == read(SCENE).model_dump()
    assert Scene.model_validate(json.loads(scene.model_dump_json())) == scene


def test_python_scene_is_checked_too(tmp_path):
    (tmp_path / "builder.py").touch()
    geometry = Geometry(source=tmp_path / "builder.py")
    with pytest.raises(SceneError, match=r"scene: solver\.harmonics = \[0\] leave out harmonic 1"):
        Scene(
            geometry=geometry,
            loads={"shake": ForceLoad(boundary="tip", force=(1, 0), harmonic=1)},
            excitation=Excitation(frequency=1),
            solver={"harmonics": 0},
        )


def test_scene_is_frozen(read):
    with pytest.raises(ValidationError, match="frozen"):
        read(SCENE).contact.friction = 0.3


def test_effects_follow_the_scene(read):
    on = lambda text: {effect.name for effect in list_effects(read(text, warn=True)) if effect.on}  # noqa: E731
    assert on(SCENE) == {"separation", "friction", "static friction", "static load", "harmonic load"}
    assert on(SCENE + "[contact]\nnormal = 'bonded'\ntangential = 'bonded'") == {
        "bonded parts",
        "static load",
        "harmonic load",
    }
    with pytest.warns(SceneWarning, match="friction that never resists"):
        assert "friction" not in on(SCENE + "[contact]\nfriction = 0")
    assert "centrifugal load" in on(SCENE + "[loads.spin]\nkind = 'rotation'\nspeed = 9000\ncentre = [0, -0.3]")
    odd = SCENE.replace("force = [0, 20e3]", "force = [0, 20e3]\nharmonic = 1") + "[solver]\nharmonics = [1, 3, 5]"
    assert "odd harmonics only" in on(odd + "\n[contact]\nnormal = 'bonded'")


def test_rotation_is_static():
    assert RotationLoad(kind="rotation", speed=9000, centre=(0.0, -0.3)).harmonic == 0


def test_reference_page_is_the_one_generated_from_the_definition():
    page = (ROOT / "docs" / "scenes.md").read_text()
    assert page == write_reference(), "run: python -m ewr_fenicsx.scene.scene_reference docs"
    for title, kind in list_sections():
        assert f"## {title}" in page
        for name, field in kind.model_fields.items():
            assert f"| `{field.alias or name}` |" in page
            assert field.description, f"{title} {name} has no description"


def test_example_of_the_reference_page_is_a_scene(read):
    example = re.search(r"```toml\n(.*?)```", write_reference(), re.DOTALL).group(1)
    assert read(example.replace("geometry/fir_tree.py", "builder.py")).excitation.frequency == 1000


def test_schema_closes_every_table():
    schema = Scene.model_json_schema()
    tables = [schema, *schema["$defs"].values()]
    assert all(table["additionalProperties"] is False for table in tables)
    assert len(tables) == 1 + len(list(list_sections()))
    assert issubclass(Scene, Section)


@pytest.mark.parametrize("joint", ["initial_gap = -1e-5", 'normal = "prescribed"\nnormal_force = 10.0'])
def test_a_joint_that_presses_by_itself_needs_no_load(read, joint):
    at_rest = HEAD + "[contact]\n"
    assert not read(at_rest + joint).loads
    with pytest.raises(SceneError, match="nothing moves; add a table"):
        read(at_rest + joint.replace("-1e-5", "1e-5").replace("10.0", "0.0"))


def test_a_law_of_ones_own_may_press_by_itself(read, tmp_path):
    bolt = """
from dataclasses import dataclass

from ewr_fenicsx.laws.law_kinds import LawKind, register_law


@register_law("normal", "bolted")
@dataclass(frozen=True, eq=False)
class Bolted(LawKind):
    def give_force(self, spread):
        return {0: spread(10.0)}
"""
    (tmp_path / "bolt.py").write_text(bolt)
    own = 'law_files = ["bolt.py"]\nnormal = "bolted"\ntangential = "frictionless"'
    assert not read(HEAD + "[contact]\n" + own).loads
