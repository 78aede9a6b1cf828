"""Ctrl-C during ``ewr run``: the same command goes on from there, and its results are those of an unbroken run."""

from __future__ import annotations

import errno
import json
import os
import re
import signal
from dataclasses import replace
from functools import partial
from pathlib import Path
from types import SimpleNamespace

import dolfinx
import pytest
from counted_calls import count_calls
from mpi4py import MPI
from small_scenes import write_blocks

from ewr_fenicsx import load_scene
from ewr_fenicsx.accuracy import estimates
from ewr_fenicsx.cli import main, stop_together
from ewr_fenicsx.output.result_folder import hold_target
from ewr_fenicsx.response import frequency_sweep
from ewr_fenicsx.runs.study import UNSEEN, run_study
from ewr_fenicsx.solution import solution
from ewr_fenicsx.structure.chain import build_chain
from ewr_fenicsx.wear import cycle_jumps
from ewr_fenicsx.wear.wear_accuracy import AccurateWear

write_scene = partial(write_blocks, "[contact]\nfriction = 0.1", shake=150.0, solver="harmonics = 1")
STUDIES = {  # scene, what is interrupted and counted, its calls unbroken, table
    "wear": (write_scene("[wear]\ncycles = 12"), (cycle_jumps, "solve_from"), 12, "wear.csv"),
    "sweep": (
        write_scene(frequency="{ from = 2000, to = 3500, points = 16 }"),
        (frequency_sweep, "_solve_block"),
        3,
        "frequency_response.csv",
    ),
}
ACCURATE_WEAR = write_scene("[wear]\ncycles = 12", solver="accuracy = 0.02\n[reduction]\nmodes = 2")


@pytest.fixture
def scene(tmp_path):
    return tmp_path / "scene.toml"


@pytest.fixture
def ewr(scene, tmp_path, capsys):
    """Run the scene; returns the exit code and what was told on standard error."""

    def run(*options: str, out: str = "broken") -> tuple[int, str]:
        capsys.readouterr()
        code = main(["run", str(scene), "--out", str(tmp_path / out), *options])
        return code, capsys.readouterr().err

    return run


@pytest.mark.parametrize("study", STUDIES)
def test_an_interrupted_run_goes_on(ewr, scene, tmp_path, monkeypatch, study):
    asked, place, unbroken, table = STUDIES[study]
    scene.write_text(asked)
    done = unbroken // 2
    with monkeypatch.context() as patch:
        assert len(count_calls(patch, *place, done)) == 0
        code, told = ewr()
    partial = tmp_path / "broken.partial"
    assert code == 130 and not (tmp_path / "broken").exists()
    assert f"ewr: interrupted; the work so far is in {partial}, and the same command goes on from there" in told
    with monkeypatch.context() as patch:
        calls = count_calls(patch, *place)
        code, told = ewr()
    assert code == 0 and f"ewr: found interrupted work in {partial}" in told
    assert len(calls) == unbroken - done
    assert {path.name for path in tmp_path.iterdir()} == {"broken", "scene.toml"}, "the work is removed"
    with monkeypatch.context() as patch:
        calls = count_calls(patch, *place)
        assert ewr(out="unbroken")[0] == 0
    assert len(calls) == unbroken
    assert (tmp_path / "broken" / table).read_bytes() == (tmp_path / "unbroken" / table).read_bytes()
    one, two = (json.loads((tmp_path / out / "summary.json").read_text()) for out in ("broken", "unbroken"))
    assert (one["solution"], one["files"], one[study]) == (two["solution"], two["files"], two[study])


def test_interrupted_wear_with_an_accuracy_goes_on_with_the_modes_that_it_raised(ewr, scene, tmp_path, monkeypatch):
    """It began anew, however many cycles were done."""
    scene.write_text(ACCURATE_WEAR)
    with monkeypatch.context() as patch:
        count_calls(patch, cycle_jumps, "solve_from", 4)
        code, told = ewr()
    assert code == 130 and told.endswith("and the same command goes on from there\n")
    with monkeypatch.context() as patch:
        patch.setattr(AccurateWear, "begin", lambda *_: pytest.fail("begun anew"))
        calls = count_calls(patch, cycle_jumps, "solve_from")
        assert ewr()[0] == 0
    with monkeypatch.context() as patch:
        unbroken = count_calls(patch, cycle_jumps, "solve_from")
        assert ewr(out="unbroken")[0] == 0
    assert len(calls) == len(unbroken) - 4
    assert (tmp_path / "broken" / "wear.csv").read_bytes() == (tmp_path / "unbroken" / "wear.csv").read_bytes()
    one, two = (json.loads((tmp_path / out / "summary.json").read_text()) for out in ("broken", "unbroken"))
    assert len(one["model"]["fixed_interface_frequencies_Hz"]) > 2, "or no modes were raised"
    assert all(one[name] == two[name] for name in ("model", "solution", "files", "wear", "accuracy"))


@pytest.mark.parametrize("study", STUDIES)
@pytest.mark.parametrize("change", [("friction = 0.1", "friction = 0.2"), ("-1000.0", "-1001.0")])
def test_work_of_another_scene_is_refused(ewr, scene, tmp_path, monkeypatch, study, change):
    """Whether the laws differ or the model; what to do about it is something that a user can do."""
    asked, place, unbroken, _ = STUDIES[study]
    scene.write_text(asked)
    with monkeypatch.context() as patch:
        count_calls(patch, *place, unbroken // 2)
        assert ewr()[0] == 130
    scene.write_text(asked.replace(*change))
    code, told = ewr()
    partial = tmp_path / "broken.partial"
    assert code == 2 and "Traceback" not in told
    assert f"Remove the folder {partial} if you do not need it, or give another --out" in " ".join(told.split())
    assert partial.is_dir() and not (tmp_path / "broken").exists()


def test_work_begun_on_more_ranks_says_how_to_go_on(ewr, scene, tmp_path, monkeypatch):
    """Where they cut the mesh otherwise, their model is not quite this one (tests/parallel has them do so)."""
    asked, place, unbroken, _ = STUDIES["sweep"]
    scene.write_text(asked)
    with monkeypatch.context() as patch:
        count_calls(patch, *place, unbroken // 2)
        assert ewr()[0] == 130
    partial = tmp_path / "broken.partial"
    assert (partial / "ranks.txt").read_text() == "1\n"
    (partial / "ranks.txt").write_text("3\n")
    scene.write_text(asked.replace("-1000.0", "-1001.0"))
    code, told = ewr()
    assert code == 2 and "Traceback" not in told
    assert (
        f"{partial} holds work begun on 3 ranks, and this run has 1 rank: go on with `mpirun -n 3`, or remove" in told
    )
    scene.write_text(asked)
    assert ewr()[0] == 0, "the same model but for rounding: as good on any number"
    assert not partial.exists()


@pytest.mark.parametrize("study, other", [("wear", "sweep"), ("sweep", "wear")])
def test_work_of_another_kind_of_study_is_refused(ewr, scene, tmp_path, monkeypatch, study, other):
    """On the same model, which fits: that study would begin anew, and at its end remove what it did not use."""
    asked, place, unbroken, _ = STUDIES[study]
    scene.write_text(asked)
    with monkeypatch.context() as patch:
        count_calls(patch, *place, unbroken // 2)
        assert ewr()[0] == 130
    partial = tmp_path / "broken.partial"
    kept = {path: path.read_bytes() for path in partial.rglob("*.h5")}
    scene.write_text(STUDIES[other][0])
    code, told = ewr()
    assert code == 2 and "interrupted work of another kind of study. Remove the folder" in " ".join(told.split())
    assert {path: path.read_bytes() for path in partial.rglob("*.h5")} == kept


def test_a_full_disk_loses_no_work(ewr, scene, tmp_path, monkeypatch):
    """A run that has solved everything cannot write its fields; with room, it need not solve anything again."""
    asked, place, _, table = STUDIES["wear"]
    scene.write_text(asked)

    def refuse(*given, **named):
        raise RuntimeError("Failed to close HDF5 dataset.")  # what dolfinx says then

    with monkeypatch.context() as patch:
        patch.setattr(dolfinx.io.XDMFFile, "write_function", refuse)
        code, told = ewr()
    partial = tmp_path / "broken.partial"
    assert code == 2 and "Traceback" not in told
    told = told.splitlines()[-1]
    assert re.search(r"cannot write results: .*displacement\.xdmf: Failed .* MB are free there; make room, or ", told)
    assert told.endswith(f"; the work so far is in {partial}, and the same command goes on from there")
    assert {path.name for path in tmp_path.iterdir()} == {"broken.partial", "scene.toml"}
    with monkeypatch.context() as patch:
        calls = count_calls(patch, *place)
        code, told = ewr()
    assert code == 0 and len(calls) == 0 and f"ewr: found interrupted work in {partial}" in told
    assert ewr(out="unbroken")[0] == 0
    assert (tmp_path / "broken" / table).read_bytes() == (tmp_path / "unbroken" / table).read_bytes()


def test_fields_without_room_are_not_begun(ewr, scene, tmp_path, monkeypatch):
    """On ranks dolfinx would end the process, with a dump, as it closes a file that HDF5 could not write."""
    scene.write_text(STUDIES["wear"][0])
    with monkeypatch.context() as patch:
        patch.setattr("ewr_fenicsx.output.output.shutil.disk_usage", lambda _: SimpleNamespace(free=10_000))
        patch.setattr("ewr_fenicsx.output.output.dolfinx.io.XDMFFile", None)
        code, told = ewr()
    assert code == 2
    line = "No space left on device: 0.0 MB are free there, of up to "
    assert re.search(rf"ewr: cannot write results: .*\.xdmf: {line}0\.\d needed; make room", told.splitlines()[-1])


@pytest.mark.parametrize(
    ("place", "name", "told_of"),
    [(Path, "write_text", "cannot write results: {}"), (os, "fsync", "{}/reduced_model.h5 cannot be written")],
)
def test_a_disk_that_is_full_at_once_is_told_by_the_folder(ewr, scene, tmp_path, monkeypatch, place, name, told_of):
    """A write that fails, unlike an open that does, comes without the name of its file."""
    scene.write_text(STUDIES["wear"][0])

    def refuse(*given, **named):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    with monkeypatch.context() as patch:
        patch.setattr(place, name, refuse)
        code, told = ewr()
    assert code == 2
    words = f"ewr: {told_of.format(tmp_path / 'broken.partial')}: No space left on device; "
    assert told.splitlines()[-1].startswith(words) and "make room" in told
    assert [path.name for path in tmp_path.iterdir()] == ["scene.toml"]


def test_a_run_that_a_scheduler_ends_goes_on(ewr, scene, tmp_path, monkeypatch):
    """SIGTERM is what comes before a job's time is up."""
    asked, (module, name), unbroken, _ = STUDIES["wear"]
    scene.write_text(asked)
    calls, work = [], getattr(module, name)

    def end(*given, **named):
        calls.append(name)
        if len(calls) == unbroken // 2:
            os.kill(os.getpid(), signal.SIGTERM)
        return work(*given, **named)

    with monkeypatch.context() as patch:
        patch.setattr(module, name, end)
        code, told = ewr()
    assert code == 130 and told.endswith("and the same command goes on from there\n")
    code, told = ewr()
    assert code == 0 and "found interrupted work" in told


def test_a_solution_outlives_the_estimate_of_its_error(ewr, scene, tmp_path, monkeypatch):
    """The estimate may take as long as the solve; of a single solution nothing else would be kept."""
    scene.write_text(write_scene())
    with monkeypatch.context() as patch:
        count_calls(patch, estimates, "estimate_at_once", 0)
        code, told = ewr()
    results = tmp_path / "broken"
    assert code == 130
    assert told.endswith(f"ewr: interrupted; the results are in {results}, without an estimate of their error\n")
    assert {path.name for path in tmp_path.iterdir()} == {"broken", "scene.toml"}
    assert ewr(out="unbroken")[0] == 0
    one, two = (json.loads((tmp_path / out / "summary.json").read_text()) for out in ("broken", "unbroken"))
    assert (one["solution"], one["files"]) == (two["solution"], two["files"])
    assert one["estimate"] is None and two["estimate"]


@pytest.mark.parametrize("asked", ["harmonics = 1", "accuracy = 0.1"])
def test_a_solution_outlives_the_look_at_its_stability(ewr, scene, tmp_path, monkeypatch, asked):
    """Which may take longer than the solve, and the estimate as well."""
    scene.write_text(write_scene(solver=asked))
    with monkeypatch.context() as patch:
        count_calls(patch, solution, "find_growth", 0)
        code, told = ewr()
    results = tmp_path / "broken"
    assert code == 130
    assert told.endswith(
        f"ewr: interrupted; the results are in {results}, without a look at what speaks against them\n"
    )
    assert ewr(out="unbroken")[0] == 0
    one, two = (json.loads((tmp_path / out / "summary.json").read_text()) for out in ("broken", "unbroken"))
    assert one["solution"].pop("cautions") == [UNSEEN] and UNSEEN not in two["solution"].pop("cautions")
    assert (one["solution"], one["files"]) == (two["solution"], two["files"])
    assert one.get("estimate") is None


def test_wear_of_which_no_work_is_kept_outlives_the_look_at_its_stability(scene, monkeypatch):
    """In Python; where the motion is unstable, many solutions are looked at."""
    scene.write_text(write_scene("[wear]\ncycles = 3", solver="accuracy = 0.1"))
    chain = build_chain(load_scene(scene))
    with monkeypatch.context() as patch:
        count_calls(patch, solution, "find_growth", 0)
        broken = run_study(chain)
    unbroken = run_study(chain)
    assert broken.cut_short == "a look at what speaks against them" and not unbroken.cut_short
    assert UNSEEN in broken.told and UNSEEN not in unbroken.told
    one, two = ({**study.facts["wear"]} for study in (broken, unbroken))
    assert one.pop("reservations_of_first_solve") == [UNSEEN] != two.pop("reservations_of_first_solve")
    assert one == two


@pytest.mark.parametrize("study", STUDIES)
def test_work_that_goes_on_waits_for_its_estimate(ewr, scene, tmp_path, monkeypatch, study):
    scene.write_text(STUDIES[study][0])
    with monkeypatch.context() as patch:
        count_calls(patch, estimates, "estimate_at_once", 0)
        code, told = ewr()
    assert code == 130 and told.endswith("and the same command goes on from there\n")
    assert {path.name for path in tmp_path.iterdir()} == {"broken.partial", "scene.toml"}


def test_an_interrupted_import_is_an_interruption(capsys):
    """Compiled modules make an ImportError of it."""

    def load():
        raise ImportError("initialization failed") from KeyboardInterrupt()

    assert stop_together(MPI.COMM_SELF, load) == 130
    assert capsys.readouterr().err == "ewr: interrupted\n"


def test_a_rank_that_ends_since_another_failed_says_that_it_may_be_so(monkeypatch, capsys):
    """What MPI_Abort sends it is a signal like any."""
    ended = []
    comm = SimpleNamespace(rank=1, size=2, Dup=lambda: None, Abort=ended.append)
    monkeypatch.setattr("ewr_fenicsx.cli.everyone_failed", lambda _: False)

    def wait():
        raise KeyboardInterrupt

    assert stop_together(comm, wait) == 130 and ended == [130]
    assert capsys.readouterr().err == "ewr: interrupted (rank 1, by a signal or since another rank failed)\n"


def test_nothing_is_left_where_nothing_was_done_or_nothing_can_come_of_it(ewr, scene, tmp_path, monkeypatch):
    asked, place, _, _ = STUDIES["sweep"]
    scene.write_text(asked)
    with monkeypatch.context() as patch:
        count_calls(patch, *place, 0)
        code, told = ewr()
    assert code == 130 and told.endswith("ewr: interrupted\n")
    assert {path.name for path in tmp_path.iterdir()} == {"scene.toml"}
    sweep = frequency_sweep.frequency_response
    vain = lambda *given, **named: replace(sweep(*given, **named), solutions=())  # noqa: E731
    with monkeypatch.context() as patch:
        patch.setattr(frequency_sweep, "frequency_response", vain)
        code, told = ewr()
    assert code == 3 and "no periodic solution at any of 16 frequencies" in told
    assert {path.name for path in tmp_path.iterdir()} == {"scene.toml"}


def test_a_folder_of_the_user_s_own_is_kept(ewr, scene, tmp_path):
    scene.write_text(STUDIES["wear"][0])
    (tmp_path / "broken.partial").mkdir()
    (tmp_path / "broken.partial" / "notes.txt").write_text("mine")
    code, told = ewr()
    assert code == 2 and "no run wrote it" in told
    assert (tmp_path / "broken.partial" / "notes.txt").read_text() == "mine"


@pytest.mark.parametrize("study", STUDIES)
def test_another_run_takes_neither_the_folder_nor_the_work(ewr, scene, tmp_path, monkeypatch, study):
    """A short run once removed the work of a long one into the same folder, or its results."""
    asked, (module, name), *_ = STUDIES[study]
    scene.write_text(asked)
    work, refused, kept = getattr(module, name), [], []

    def run_another(*given, **named):
        patch.undo()
        before = sorted(tmp_path.rglob("*"))
        refused.extend([ewr(), ewr("--overwrite")])
        kept.append(sorted(tmp_path.rglob("*")) == before)
        return work(*given, **named)

    with monkeypatch.context() as patch:
        patch.setattr(module, name, run_another)
        assert ewr()[0] == 0
    for code, told in refused:
        assert code == 2
        assert told.endswith(f"ewr: another run writes to {tmp_path / 'broken'}; wait for it, or give another --out\n")
        assert "going on" not in told
    assert len(refused) == 2 and kept == [True]
    assert {path.name for path in tmp_path.iterdir()} == {"broken", "scene.toml"}
    with hold_target(tmp_path / "broken_cost"):
        assert main(["cost", str(scene), "--out", str(tmp_path / "broken_cost")]) == 2
