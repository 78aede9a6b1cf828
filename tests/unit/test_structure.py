"""The shape of the package: imports go upward, the core needs no mesh, everything public says what it is."""

from __future__ import annotations

import ast
import subprocess
import sys
from pathlib import Path

import pytest

import ewr_fenicsx

FOLDER = Path(ewr_fenicsx.__file__).parent

# Each folder may import from those before it, each module in it those before it too, and the commands at the end all.
# fmt: off
ORDER = {
    "": ["errors", "given", "display", "progress", "task_sharing", "whole_files"],
    "model": [
        "cyclic_symmetry", "rigid_modes", "reduced_model", "ring", "restriction", "receptance", "statics", "compliance",
    ],
    "laws": [
        "law_kinds", "smoothing", "cone", "mean_friction", "unilateral", "bonded", "prescribed", "planar_coulomb",
        "sprung_coulomb", "inertial_coulomb", "coulomb", "contact_laws",
    ],
    "problem": [
        "harmonics", "closure", "layout", "contact_system", "composition", "contact_problem", "dashpots", "ignored",
        "law_claims",
    ],
    "balance": [
        "petsc_calls", "law_derivatives", "elimination", "newton_step", "balance", "inexact_step", "periodic_motion",
    ],
    "in_time": [
        "compiled_loop", "time_stepping", "lifting", "periodicity", "surroundings", "followed_modes", "deviations",
        "hill", "floquet", "ring_growth", "stability", "walking",
    ],
    "solution": [
        "loading_history", "unpressed", "indicators", "solution", "solution_series", "remedies",
        "contact_state", "symmetry",
    ],
    "solver": [
        "snes", "continuation", "newton_path", "splitting", "growing_sets", "warm_starts", "long_splitting", "ladder",
        "at_rest", "initial_states", "time_integration", "growing_load", "faint_forces", "weights", "newton",
    ],
    "accuracy": ["looking_ahead", "modes_left_out", "estimates", "levels", "accuracy", "solving", "cost"],
    "response": [
        "solution_store", "following", "sweep_store", "refining", "response_curve", "frequency_sweep",
    ],
    "wear": ["archard", "wear_store", "wear_accuracy", "same_place", "cycle_jumps", "wear"],
    "scene": [
        "scene_errors", "scene_entries", "scene_structure", "scene_joint", "scene_sense", "scene", "scene_reference",
        "effects",
    ],
    "structure": [
        "_compat", "gmsh_inspection", "mesh", "materials", "boundaries", "elasticity", "pair_frames", "interface",
        "rigid_motions", "columns", "modes", "sector_cuts", "projection", "reduction", "chain",
    ],
    "output": [
        "gathering", "plots", "mesh_plots", "solid_plots", "cost_plots", "folder_lock", "result_folder", "work_folder",
        "pair_fields", "ring_plots", "output", "wear_fields",
    ],
    "runs": ["start", "petsc_options", "findings", "study", "cost_report"],
}
# fmt: on
COMMANDS = ["cli", "__main__"]
PLACES = [f"{folder}.{name}".lstrip(".") for folder, names in ORDER.items() for name in names] + COMMANDS
CORE = PLACES[PLACES.index("model.cyclic_symmetry") : PLACES.index("wear.wear") + 1]
MODULES = sorted(
    ".".join(path.relative_to(FOLDER).with_suffix("").parts) for path in FOLDER.rglob("*.py") if path.stem != "__init__"
)
LONGEST, MOST = 400, 15  # lines a module, modules a folder

every_module = pytest.mark.parametrize("name", MODULES)


def locate(name: str) -> Path:
    return FOLDER / f"{name.replace('.', '/')}.py"


def parse(name: str) -> ast.Module:
    return ast.parse(locate(name).read_text(encoding="utf-8"))


def imports_of(tree: ast.Module) -> set[str]:
    """Modules of the package that a module imports anywhere, functions and type checking included."""
    found = set()
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, "relative import"
            found |= {node.module} | {f"{node.module}.{alias.name}" for alias in node.names}
    return {name.removeprefix("ewr_fenicsx.") for name in found} & set(MODULES)


@every_module
def test_each_module_has_its_place_in_the_order(name):
    assert name in PLACES, f"{name} is not in the order of imports: place it, or do without it"


@every_module
def test_imports_go_upward(name):
    assert imports_of(parse(name)) - set(PLACES[: PLACES.index(name)]) == set()


@every_module
def test_names_are_imported_from_where_they_are_defined(name):
    """Not from a module that has them from another: imports tell which file to open."""
    found = [node for node in ast.walk(parse(name)) if isinstance(node, ast.ImportFrom)]
    for node in found:
        if (home := node.module.removeprefix("ewr_fenicsx.")) in MODULES:
            lent = {a.name for n in parse(home).body if isinstance(n, ast.ImportFrom) for a in n.names}
            assert not lent & {alias.name for alias in node.names}, f"{home} has them from elsewhere"


def test_the_core_imports_no_finite_elements():
    """Whoever has matrices of their own needs neither dolfinx nor gmsh."""
    script = (
        "import sys, ewr_fenicsx; ewr_fenicsx.solve; ewr_fenicsx.ReducedModel; ewr_fenicsx.ContactProblem\n"
        "print(*sorted({name.split('.')[0] for name in sys.modules}))"
    )
    run = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True, cwd=FOLDER.parent)
    loaded = set(run.stdout.split())
    assert {"numpy", "petsc4py", "ewr_fenicsx"} <= loaded
    assert not loaded & {"dolfinx", "gmsh", "ufl", "ffcx", "basix", "slepc4py", "matplotlib", "pydantic"}


@pytest.mark.parametrize("name", CORE)
def test_core_modules_name_no_finite_elements(name):
    """Also not inside functions that the import above does not reach."""
    roots = set()
    for node in ast.walk(parse(name)):
        if isinstance(node, ast.Import):
            roots |= {alias.name.split(".")[0] for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module:
            roots.add(node.module.split(".")[0])
    assert not roots & {"dolfinx", "gmsh", "ufl", "basix", "slepc4py"}
    assert "structure._compat" not in imports_of(parse(name)), "_compat imports dolfinx"


def test_importing_the_package_loads_nothing():
    script = "import sys, ewr_fenicsx; print(*sorted(name for name in sys.modules if name.startswith('ewr_fenicsx')))"
    run = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True, cwd=FOLDER.parent)
    assert run.stdout.split() == ["ewr_fenicsx"]


@pytest.mark.parametrize("name", ewr_fenicsx.__all__)
def test_public_names_exist(name):
    assert getattr(ewr_fenicsx, name).__name__ == name


def test_unknown_public_names_are_attribute_errors():
    with pytest.raises(AttributeError, match="has no attribute 'sovle'"):
        ewr_fenicsx.sovle  # noqa: B018


def undocumented(tree: ast.Module, core: bool) -> list[str]:
    missing = [] if ast.get_docstring(tree) else ["the module"]
    for node in tree.body:
        if (
            isinstance(node, ast.FunctionDef | ast.ClassDef)
            and not node.name.startswith("_")
            and not ast.get_docstring(node)
        ):
            missing.append(node.name)
        if core and isinstance(node, ast.ClassDef) and not node.name.startswith("_"):
            methods = [
                item for item in node.body if isinstance(item, ast.FunctionDef) and not item.name.startswith("_")
            ]
            missing += [f"{node.name}.{item.name}" for item in methods if not ast.get_docstring(item)]
    return missing


def methods_of_protocols() -> set[str]:
    found = set()
    for name in MODULES:
        for node in parse(name).body:
            if isinstance(node, ast.ClassDef) and any("Protocol" in ast.unparse(base) for base in node.bases):
                found |= {item.name for item in node.body if isinstance(item, ast.FunctionDef)}
                found |= {item.target.id for item in node.body if isinstance(item, ast.AnnAssign)}
    return found


@every_module
def test_everything_public_says_what_it_is(name):
    """In the core methods too; those that a Protocol declares say it there."""
    declared = methods_of_protocols()
    assert [entry for entry in undocumented(parse(name), name in CORE) if entry.split(".")[-1] not in declared] == []


@every_module
def test_no_module_does_two_things(name):
    lines = len(locate(name).read_text(encoding="utf-8").splitlines())
    assert lines <= LONGEST, f"{name}.py has {lines} lines"


@every_module
def test_no_drawer_for_odds_and_ends(name):
    assert not {"utils", "util", "helpers", "helper", "common", "misc"} & set(name.split("."))


@pytest.mark.parametrize("folder", ORDER)
def test_each_folder_says_what_it_holds_and_can_be_overlooked(folder):
    assert ast.get_docstring(ast.parse((FOLDER / folder / "__init__.py").read_text(encoding="utf-8")))
    assert len(list((FOLDER / folder).glob("*.py"))) - 1 <= MOST


def test_names_of_modules_are_told_from_one_another_without_their_folders():
    """The documentation names files so."""
    stems = [name.split(".")[-1] for name in MODULES]
    assert len(set(stems)) == len(stems)


@every_module
def test_no_exception_is_swallowed(name):
    for node in ast.walk(parse(name)):
        if isinstance(node, ast.ExceptHandler):
            assert node.type is not None, "bare except"
            assert not (len(node.body) == 1 and isinstance(node.body[0], ast.Pass)), "except: pass"
