"""What users get wrong: one clear message that names the thing, exit code 2, no traceback, nothing half-written."""

from __future__ import annotations

import os
import re
import signal
import subprocess
import sys

import pytest
from petsc4py import PETSc
from small_models import PROBLEMS
from small_scenes import BLOCKS, write_blocks

from ewr_fenicsx import solve
from ewr_fenicsx.cli import main, parse_arguments
from ewr_fenicsx.runs.petsc_options import check_options
from ewr_fenicsx.solver.snes import NEED_MATRIX

MIXED_CELLS = '''
import gmsh


def build() -> None:
    """A block of triangles on a block of quadrilaterals."""
    for name, bottom in (("disk", 0.0), ("blade", 1.0)):
        surface = gmsh.model.occ.addRectangle(0.0, bottom, 0.0, 1.0, 1.0)
        gmsh.model.occ.synchronize()
        if name == "disk":
            gmsh.model.mesh.setTransfiniteSurface(surface)
            gmsh.model.mesh.setRecombine(2, surface)
        gmsh.model.setPhysicalName(2, gmsh.model.addPhysicalGroup(2, [surface]), name)
    gmsh.model.mesh.generate(2)
'''


@pytest.fixture
def ewr(tmp_path, monkeypatch, capsys):
    """Write a scene, run ``ewr run`` on it, and check all that every failure has in common."""
    monkeypatch.chdir(tmp_path)

    def run(
        parameters: str = "", change: tuple[str, str] = ("", ""), addition: str = "", arguments: tuple[str, ...] = ()
    ) -> str:
        text = write_blocks(parameters=parameters, solver="harmonics = 1")
        assert change[0] in text
        (tmp_path / "scene.toml").write_text(text.replace(*change) + addition)
        before = sorted(tmp_path.rglob("*"))
        code = main(["run", "scene.toml", *(arguments or ("--out", "results"))])
        output = capsys.readouterr()
        assert code == 2
        assert output.out == ""
        message = output.err[output.err.index("ewr: ") :]
        assert "Traceback" not in output.err
        assert sorted(tmp_path.rglob("*")) == before, "something was left behind"
        return message

    return run


@pytest.fixture
def petsc_options():
    """Options as on a command line, gone after the test."""
    options, before = PETSc.Options(), PETSc.Options().getAll()
    yield options.insertString
    for name in set(options.getAll()) - set(before):
        options.delValue(name)


@pytest.mark.parametrize(
    ("addition", "expected"),
    [
        ("[contact]\nfrction = 0.3", 'scene scene.toml: contact.frction = 0.3: unknown key; did you mean "friction"?'),
        ("[contact]\nfriction = 'high'", "scene scene.toml: contact.friction = 'high': should be a number"),
        (
            "[contact]\nfriction = -0.3",
            "scene scene.toml: contact.friction = -0.3: should be greater than or equal to 0",
        ),
        ("[contact", "scene scene.toml: not valid TOML"),
        (
            "[contact]\nbody_b = 'disc'",
            'contact.body_b = "disc": two_blocks.py has no physical group of that name for a body, only blade, disk; '
            'did you mean "disk"?',
        ),
        ("[contact]\nflanks = ['jiont']", 'contact.flanks[0] = "jiont"'),
        ("[supports]\nclamp = ['clmp']", 'supports.clamp[0] = "clmp"'),
        ("[materials.rotor]\nyoung = 1e11", 'materials.rotor = "rotor"'),
    ],
)
def test_mistake_in_the_scene(ewr, addition, expected):
    assert expected in ewr(addition=addition)


def test_missing_physical_group(ewr):
    message = ewr(change=('boundary = "tip"\nforce = [0.0', 'boundary = "tp"\nforce = [0.0'))
    assert 'loads.push.boundary = "tp"' in message
    assert 'did you mean "tip"?' in message


def test_unknown_parameter_of_the_builder(ewr):
    message = ewr(parameters="colums = 5")
    assert "two_blocks.py" in message
    assert 'did you mean "columns"?' in message


def test_unequal_flank_nodes(ewr):
    message = ewr(parameters="columns = 6, disk_columns = 5")
    assert re.search(r'flank "joint": 7 nodes on the blade, 6 on the disk; give both curves the same', message)


def test_pair_further_apart_than_the_tolerance(ewr):
    message = ewr(parameters="shift = 1e-5")
    assert 'flank "joint"' in message
    assert "1e-05 m away" in message


def test_mixed_cell_types(ewr, tmp_path):
    (tmp_path / "mixed.py").write_text(MIXED_CELLS)
    message = ewr(change=(str(BLOCKS), "mixed.py"))
    assert "mixed.py" in message
    assert "cells of 2 types" in message


def test_floating_body_that_nothing_holds(ewr):
    message = ewr(change=("force = [0.0, -1000.0]", "force = [0.0, 1000.0]"))  # pulls the blade off its seat
    assert "scene scene.toml: nothing holds a floating body: 100% of the mean load stays unbalanced" in message
    assert re.search(r"opens pairs \d, \d, \d most; .* \(those pairs are on joint\)", message)


def test_floating_body_with_no_force_that_could_hold_it(ewr):
    message = ewr(addition="[contact]\nnormal = 'bonded'\ntangential = 'frictionless'")
    assert "1 rigid motions of floating bodies, but the forces of contact tell only 0 of them apart" in message
    assert re.search(r"one that they do not see slides along pairs \d, \d, \d without friction; clamp", message)


def test_too_little_memory(ewr, monkeypatch):
    def reduce_structure(*_, **__):
        raise MemoryError("Unable to allocate 812. GiB")

    monkeypatch.setattr("ewr_fenicsx.structure.chain.reduce_structure", reduce_structure)
    assert "ewr: out of memory: Unable to allocate 812. GiB; take a larger mesh_size, or fewer pairs" in ewr()


def test_unwritable_folder(ewr, tmp_path):
    message = ewr(arguments=("--out", "/proc/ewr/results"))  # even root cannot write there
    assert "result folder /proc/ewr/results cannot be made" in message
    (tmp_path / "taken").touch()
    assert "taken" in ewr(arguments=("--out", "taken/results"))


def test_existing_result_folder_is_kept(ewr, tmp_path):
    (tmp_path / "results").mkdir()
    (tmp_path / "results" / "summary.json").write_text('{"files": ["summary.json"]}')
    message = ewr()
    assert "result folder results exists" in message
    assert "--overwrite" in message
    assert (tmp_path / "results" / "summary.json").read_text() == '{"files": ["summary.json"]}'


def test_overwrite_spares_files_that_no_run_wrote(ewr, tmp_path):
    (tmp_path / "results").mkdir()
    (tmp_path / "results" / "thesis.txt").write_text("years of work")
    message = ewr(arguments=("--out", "results", "--overwrite"))
    assert "'thesis.txt'" in message
    assert (tmp_path / "results" / "thesis.txt").read_text() == "years of work"


def test_scene_file_that_is_not_there(tmp_path, capsys):
    assert main(["info", str(tmp_path / "nowhere.toml")]) == 2
    assert "nowhere.toml: cannot be read: No such file" in capsys.readouterr().err


def test_unknown_argument(capsys):
    with pytest.raises(SystemExit) as stopped:
        main(["run", "scene.toml", "--overwite"])
    assert stopped.value.code == 2
    assert "--overwite" in capsys.readouterr().err


def test_installed_command_prints_one_message_and_exits_with_2(tmp_path):
    (tmp_path / "scene.toml").write_text("titel = 'x'")
    done = subprocess.run(
        [sys.executable, "-m", "ewr_fenicsx", "run", "scene.toml"],
        cwd=tmp_path,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 2
    assert done.stdout == ""
    assert done.stderr.startswith("ewr: scene scene.toml:")
    assert 'did you mean "title"?' in done.stderr
    assert "Traceback" not in done.stderr


def test_whoever_reads_only_the_first_lines_sees_no_error(tmp_path):
    (tmp_path / "scene.toml").write_text(write_blocks())
    command = [sys.executable, "-m", "ewr_fenicsx", "info", "scene.toml"]
    with subprocess.Popen(command, cwd=tmp_path, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as info:
        info.stdout.close()
        told = info.stderr.read()
    assert info.returncode == -signal.SIGPIPE
    assert "Traceback" not in told and "PETSC ERROR" not in told


@pytest.mark.parametrize(
    ("redirection", "code", "told"),
    [
        (">&-", 0, ""),
        (">/dev/full", 2, "ewr: the output cannot be written: No space left on device; make room\n"),
        ("2>/dev/full", 0, ""),
    ],
)
def test_output_that_goes_nowhere(tmp_path, redirection, code, told):
    (tmp_path / "scene.toml").write_text(write_blocks())
    command = f"exec {sys.executable} -m ewr_fenicsx info scene.toml {redirection}"
    done = subprocess.run(["sh", "-c", command], cwd=tmp_path, capture_output=True, text=True, check=False, timeout=300)
    assert done.returncode == code, done.stderr
    assert done.stderr.endswith(told) and "Traceback" not in done.stderr


def test_letters_that_a_terminal_does_not_know_are_no_error(tmp_path):
    (tmp_path / "scene.toml").write_text(f'title = "Ω"\n{write_blocks()}', encoding="utf-8")
    command = [sys.executable, "-m", "ewr_fenicsx", "info", "scene.toml"]
    ascii_only = os.environ | {"PYTHONIOENCODING": "ascii"}
    done = subprocess.run(command, cwd=tmp_path, env=ascii_only, capture_output=True, check=False, timeout=300)
    assert done.returncode == 0, done.stderr
    assert done.stdout.startswith(rb"\u03a9")


def test_names_that_dolfinx_does_not_take_are_refused(capsys):
    with pytest.raises(SystemExit) as caught:
        parse_arguments(["run", "a\udcff.toml"])  # as Python reads bytes that are not UTF-8
    assert caught.value.code == 2
    assert r"'a\udcff.toml' is not UTF-8" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("given", "meant"),
    [("-out", "--out"), ("-out=there", "--out"), ("-overwrite", "--overwrite"), ("--overwite", "--overwrite")],
)
def test_an_option_with_a_dash_too_few_is_not_for_petsc(given, meant, capsys):
    with pytest.raises(SystemExit) as caught:
        parse_arguments(["run", "scene.toml", given, "there"])
    assert caught.value.code == 2
    assert f"unknown argument: {given}; was {meant} meant?" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("given", "why"),
    [
        ("-ewr_snes_max_it abc", "abc has no integer value"),
        ("-ewr_snes_max_it 3.5", "3.5 has no integer value"),
        ("-ewr_snes_monitor -ewr_snes_type foo", "SNES type foo"),
        ("-ewr_pc_type foo", "PC type foo"),
        ("-ewr_inexact_ksp_rtol foo", "foo has no numeric value"),
    ],
)
def test_an_option_that_petsc_refuses_is_told_before_the_work(tmp_path, given, why):
    (tmp_path / "scene.toml").write_text(write_blocks())
    command = [sys.executable, "-m", "ewr_fenicsx", "run", "scene.toml", "--out", "results", *given.split()]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False, timeout=300)
    assert done.returncode == 2
    assert re.fullmatch(
        rf"ewr: PETSc refuses an option: .*{re.escape(why)}.*; options given: {given}\n", done.stderr
    ), done.stderr
    assert [path.name for path in tmp_path.iterdir()] == ["scene.toml"]


def test_a_home_directory_is_meant_after_an_equals_sign_too(monkeypatch):
    """Where the shell leaves it, results went to a folder of that name."""
    monkeypatch.setenv("HOME", "/home/someone")
    assert str(parse_arguments(["run", "scene.toml", "--out=~/results"])[0].out) == "/home/someone/results"
    assert parse_arguments(["run", "scene.toml"])[0].out is None


def test_options_with_which_petsc_does_not_start_are_told(tmp_path):
    (tmp_path / "scene.toml").write_text(write_blocks())
    command = [sys.executable, "-m", "ewr_fenicsx", "run", "scene.toml", "-options_file", "none"]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False, timeout=300)
    assert done.returncode == 2
    assert re.search(r"PETSC ERROR: Unable to open .*none", done.stderr) and "Traceback" not in done.stderr
    assert "\newr: PETSc does not start, for the reason above; options given: -options_file none; " in done.stderr


def test_options_in_another_encoding_are_told(tmp_path):
    """As in a file that an old editor wrote; petsc4py reads them as UTF-8, those of others as well."""
    (tmp_path / "scene.toml").write_text(write_blocks())
    (tmp_path / ".petscrc").write_bytes("-log_view :andré.txt\n".encode("latin-1"))
    command = [sys.executable, "-m", "ewr_fenicsx", "run", "scene.toml"]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False, timeout=300)
    assert done.returncode == 2
    told = r"ewr: options for PETSc are not UTF-8: -log_view :andr\xe9.txt; see PETSC_OPTIONS and .petscrc"
    assert told in done.stderr.splitlines()


@pytest.mark.parametrize(
    ("given", "told"),
    [
        ("-ewr_snes_mf", "-ewr_snes_mf does not work here: the Newton matrix is exact"),
        ("-ewr_snes_fd", "-ewr_snes_fd does not work here: the Newton matrix is exact"),
        ("-ewr_snes_atol 1e-3", "-ewr_snes_atol does not work here: solver.tolerance in the scene decides"),
        ("-ewr_snes_monitor -ewr_pc_type gamg", "-ewr_pc_type gamg does not work here; choose one of lu, qr, "),
        ("-ewr_inexact_pc_type lu", "-ewr_inexact_pc_type lu does not work here; choose one of none, mat, or leave it"),
        ("-ewr_snes_type shell", "-ewr_snes_type shell does not work here; choose one of newtonls, newtontr, "),
        ("-ewr_ksp_type lsqr", "-ewr_ksp_type lsqr does not work here; choose one of preonly, none, richardson, "),
        ("-ewr_pc_type bjacobi -ewr_sub_pc_type foo", "PETSc refuses an option: Unable to find requested PC type foo"),
        ("-ewr_ksp_type fgmres -ewr_ksp_pc_side left", "PETSc refuses an option: KSP fgmres does not support "),
        ("-mat_type dense", "-mat_type dense does not work here; choose one of aij, or leave it out"),
    ],
)
def test_an_option_that_would_fail_in_the_midst_of_the_work_is_refused_before(ewr, petsc_options, given, told):
    petsc_options(given)
    message = ewr()
    assert message.startswith(f"ewr: {told}") and message.count("\n") == 1


def test_a_negative_number_of_steps_is_refused_before_the_work(ewr, petsc_options):
    """By PETSc itself where it looks, as that of Debian 13 does."""
    petsc_options("-ewr_snes_max_it -5")
    own = "-ewr_snes_max_it -5 does not work here; give a number of Newton steps, 0 or more"
    theirs = "PETSc refuses an option: .*-5 must be non-negative; options given: -ewr_snes_max_it -5"
    assert re.fullmatch(f"ewr: ({own}|{theirs})\n", ewr())


@pytest.mark.parametrize(
    "given",
    [
        "-ewr_snes_monitor -ewr_snes_view -ewr_ksp_view",
        "-ewr_snes_test_jacobian",
        "-ewr_snes_type newtonls -ewr_snes_linesearch_type bt",
        *(f"-ewr_snes_type {kind}" for kind in NEED_MATRIX),
        "-ewr_pc_type lu",
        "-ewr_pc_type none -ewr_ksp_type gmres -ewr_ksp_rtol 1e-12 -ewr_ksp_gmres_restart 300",
        "-ewr_pc_type bjacobi -ewr_ksp_type fgmres -ewr_inexact_ksp_type gcr",
        "-ewr_snes_max_it 30",
    ],
)
def test_options_that_work_are_taken(petsc_options, given):
    petsc_options(given)
    check_options()
    assert solve(PROBLEMS["floating, slip"]).converged


def test_options_that_were_only_checked_still_count_as_not_taken(tmp_path):
    bonded = '[contact]\nnormal = "bonded"\ntangential = "bonded"'
    (tmp_path / "scene.toml").write_text(write_blocks(bonded))
    command = [sys.executable, "-m", "ewr_fenicsx", "run", "scene.toml", "-ewr_snes_max_it", "30", "-ewr_snes_monitor"]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False, timeout=300)
    assert done.returncode == 0, done.stderr
    for name in ("max_it", "monitor"):
        assert f"nothing took -ewr_snes_{name}: is it spelt so? Linear scenes take none" in done.stderr


def test_options_for_petsc_are_left_to_it():
    options = ["-ewr_snes_monitor", "-ewr_snes_max_it", "30", "-options_left", "-log_view"]
    assert parse_arguments(["run", "scene.toml", "--out", "there", *options])[1] == options


def test_importing_the_package_leaves_control_c_as_it_is():
    """gmsh 4.8 takes it away as it is imported."""
    code = "import signal; from ewr_fenicsx import build_reduced_model; print(signal.getsignal(signal.SIGINT).__name__)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60, check=True)
    assert done.stdout == "default_int_handler\n"
