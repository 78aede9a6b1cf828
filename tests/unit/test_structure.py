"""The shape of the package: imports go upward, the core needs no mesh, everything public says what it is."""

from __future__ import annotations

import ast
import subprocess
import sys
from pathlib import Path

import pytest

import ewr_fenicsx

FOLDER = Path(ewr_fenicsx.__file__).parent

# Each module may import those before it.
# fmt: off
ORDER = [
    "errors", "_compat", "petsc_options", "given", "whole_files", "rigid_modes", "reduced_model", "harmonics",
    "law_kinds", "smoothing", "cone", "mean_friction", "unilateral", "bonded", "prescribed", "planar_coulomb",
    "sprung_coulomb",
    "inertial_coulomb", "coulomb", "contact_laws", "statics", "compliance", "closure", "layout", "contact_system",
    "composition",
    "contact_problem", "ignored", "law_claims",
    "law_derivatives", "elimination", "newton_step", "balance", "inexact_step", "stability", "time_stepping",
    "deviations", "hill", "floquet", "walking", "loading_history", "indicators", "periodic_motion", "solution",
    "contact_state", "periodicity", "snes", "initial_states", "progress", "time_integration", "symmetry",
    "continuation", "newton_path", "splitting", "growing_sets", "warm_starts", "long_splitting", "ladder",
    "growing_load",
    "weights", "newton", "dashpots", "looking_ahead", "estimates", "accuracy", "solving", "cost", "task_sharing",
    "solution_store", "following", "sweep_store", "refining", "response_curve", "frequency_sweep", "archard",
    "wear_store", "wear_accuracy", "cycle_jumps", "wear", "scene_errors", "scene_entries", "scene_structure",
    "scene_joint", "scene_sense", "scene", "scene_reference", "effects", "mesh", "materials", "facing", "elasticity",
    "interface", "modes", "columns", "orientation", "reduction", "chain", "gathering", "plots", "mesh_plots",
    "cost_plots", "folder_lock", "result_folder", "output", "wear_fields", "work_folder", "findings", "study",
    "cost_report", "cli", "__main__",
]
# fmt: on
CORE = ORDER[ORDER.index("rigid_modes") : ORDER.index("wear") + 1]
MODULES = sorted(path.stem for path in FOLDER.rglob("*.py") if path.stem != "__init__")
LONGEST = 400

every_module = pytest.mark.parametrize("name", MODULES)


def parse(name: str) -> ast.Module:
    return ast.parse((FOLDER / f"{name}.py").read_text(encoding="utf-8"))


def imports_of(tree: ast.Module) -> set[str]:
    """Modules of the package that a module imports anywhere, functions and type checking included."""
    found = set()
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            found |= {alias.name.split(".")[1] for alias in node.names if alias.name.startswith("ewr_fenicsx.")}
        elif isinstance(node, ast.ImportFrom) and node.module and node.level == 0:
            if node.module == "ewr_fenicsx":
                found |= {alias.name for alias in node.names if alias.name in MODULES}
            elif node.module.startswith("ewr_fenicsx."):
                found.add(node.module.split(".")[1])
        elif isinstance(node, ast.ImportFrom) and node.level:
            raise AssertionError("relative import")
    return found


@every_module
def test_each_module_has_its_place_in_the_order(name):
    assert name in ORDER, f"{name}.py is not in the order of imports: place it, or do without it"


@every_module
def test_imports_go_upward(name):
    assert imports_of(parse(name)) - set(ORDER[: ORDER.index(name)]) == set()


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
    assert "_compat" not in imports_of(parse(name)), "_compat imports dolfinx"


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
    lines = len((FOLDER / f"{name}.py").read_text(encoding="utf-8").splitlines())
    assert lines <= LONGEST, f"{name}.py has {lines} lines"


@every_module
def test_no_drawer_for_odds_and_ends(name):
    assert name not in {"utils", "util", "helpers", "helper", "common", "misc"}


@every_module
def test_no_exception_is_swallowed(name):
    for node in ast.walk(parse(name)):
        if isinstance(node, ast.ExceptHandler):
            assert node.type is not None, "bare except"
            assert not (len(node.body) == 1 and isinstance(node.body[0], ast.Pass)), "except: pass"
