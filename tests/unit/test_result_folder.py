"""Result folders appear complete or not at all."""

from __future__ import annotations

import fcntl
import json
import subprocess
import sys
from pathlib import Path

import pytest
from mpi4py import MPI

from ewr_fenicsx.errors import OutputError
from ewr_fenicsx.output.result_folder import check_target, hold_target, result_folder
from ewr_fenicsx.output.work_folder import MODEL, keep_work, name_work_folder


def write_run(folder, value: str, **options) -> None:
    with result_folder(folder, **options) as draft:
        (draft / "value.txt").write_text(value)
        (draft / "summary.json").write_text(json.dumps({"files": ["value.txt", "summary.json"]}))


def test_folder_appears_at_the_end_and_nothing_else_does(tmp_path):
    target = tmp_path / "deep" / "results"
    with result_folder(target) as draft:
        (draft / "value.txt").write_text("1")
        assert not target.exists()
        assert draft.parent == target.parent, "beside the target: a rename there cannot cross file systems"
    assert (target / "value.txt").read_text() == "1"
    assert [path.name for path in target.parent.iterdir()] == ["results"]


def test_a_name_that_its_draft_makes_too_long_is_refused_before_any_work(tmp_path):
    check_target(tmp_path / ("b" * 230))
    with pytest.raises(OutputError, match="File name too long"):
        check_target(tmp_path / ("b" * 240))


def test_failure_leaves_nothing(tmp_path):
    with pytest.raises(ZeroDivisionError), result_folder(tmp_path / "results") as draft:
        (draft / "half.txt").write_text("written")
        raise ZeroDivisionError
    assert list(tmp_path.iterdir()) == []


def test_failure_while_overwriting_keeps_the_earlier_run(tmp_path):
    write_run(tmp_path / "results", "1")
    with pytest.raises(KeyboardInterrupt), result_folder(tmp_path / "results", overwrite=True) as draft:
        (draft / "value.txt").write_text("2")
        raise KeyboardInterrupt
    assert (tmp_path / "results" / "value.txt").read_text() == "1"
    assert [path.name for path in tmp_path.iterdir()] == ["results"]


def test_an_interruption_between_the_two_moves_keeps_the_earlier_run(tmp_path, monkeypatch):
    write_run(tmp_path / "results", "1")
    move = Path.rename

    def rename(source, target):
        if (source / "value.txt").is_file() and not Path(target).exists() and source.name != "results":
            monkeypatch.setattr(Path, "rename", move)
            raise KeyboardInterrupt
        return move(source, target)

    monkeypatch.setattr(Path, "rename", rename)
    with pytest.raises(KeyboardInterrupt):
        write_run(tmp_path / "results", "2", overwrite=True)
    assert (tmp_path / "results" / "value.txt").read_text() == "1"
    assert [path.name for path in tmp_path.iterdir()] == ["results"]


def test_overwriting_replaces_the_earlier_run_whole(tmp_path):
    write_run(tmp_path / "results", "1")
    with pytest.raises(OutputError, match=r"results exists and is kept; give --overwrite"):
        check_target(tmp_path / "results")
    write_run(tmp_path / "results", "2", overwrite=True)
    assert (tmp_path / "results" / "value.txt").read_text() == "2"
    assert [path.name for path in tmp_path.iterdir()] == ["results"]


def test_what_no_run_wrote_is_never_overwritten(tmp_path):
    write_run(tmp_path / "results", "1")
    (tmp_path / "results" / "state.pvsm").touch()
    with pytest.raises(OutputError, match=r"holds 'state\.pvsm', which no run wrote; move it away"):
        check_target(tmp_path / "results", overwrite=True)
    (tmp_path / "file").touch()
    with pytest.raises(OutputError, match=r"is a file"):
        check_target(tmp_path / "file", overwrite=True)


def test_empty_folder_is_free(tmp_path):
    (tmp_path / "results").mkdir()
    write_run(tmp_path / "results", "1")
    assert (tmp_path / "results" / "value.txt").read_text() == "1"


@pytest.mark.parametrize("begun", [False, True], ids=["to be made", "empty"])
def test_a_link_to_another_disk_stays_a_link(tmp_path, begun):
    disk, link = tmp_path / "disk", tmp_path / "home" / "results"
    disk.mkdir()
    link.parent.mkdir()
    link.symlink_to(disk / "results")
    if begun:
        (disk / "results").mkdir()
    for value in ("1", "2"):
        write_run(link, value, overwrite=value == "2")
        assert link.is_symlink() and (disk / "results" / "value.txt").read_text() == value
    assert [path.name for path in (*disk.iterdir(), *link.parent.iterdir())] == ["results", "results"]


def test_work_behind_a_link_to_another_disk_is_removed_in_the_end(tmp_path):
    """The next run took it for interrupted work, and refused to go on where its scene was another one."""
    disk, link = tmp_path / "disk", tmp_path / "results.partial"
    disk.mkdir()
    link.symlink_to(disk)
    with keep_work(link, MPI.COMM_SELF):
        (link / "blocks").mkdir()
        for name in (MODEL, "ranks.txt", "blocks/000_0000.h5"):
            (link / name).write_bytes(b"")
    assert link.is_symlink() and disk.is_dir()
    assert not any(disk.iterdir())


def test_a_link_that_leads_nowhere_is_refused_before_any_work(tmp_path):
    (tmp_path / "loop").symlink_to("loop")
    with pytest.raises(OutputError, match=r"loop is a file; give another --out"):
        check_target(tmp_path / "loop")


@pytest.mark.parametrize("folder", ["none/../results", "none/other/../../results", "none/.."])
def test_up_from_a_folder_that_is_not_there_is_refused_before_any_work(folder, tmp_path):
    """Results went to where the name would lead, and were then said not to be there."""
    with pytest.raises(OutputError, match=r"there is no \S*none\S* to go up from; give another --out"):
        check_target(tmp_path / folder)
    (tmp_path / "none" / "other").mkdir(parents=True)
    check_target(tmp_path / folder, overwrite=True, own=("none",))


@pytest.mark.parametrize("folder", [".", "", "..", "/"])
def test_the_folder_that_a_run_is_in_is_not_replaced(folder, tmp_path, monkeypatch):
    """It left the shell in a folder that was gone, and results of which it said that they could not be written."""
    inside = tmp_path / "inside"
    inside.mkdir()
    monkeypatch.chdir(inside)
    name_work_folder(Path(folder))  # before it is looked at
    with pytest.raises(OutputError, match="holds the folder that this runs in; give another --out"):
        check_target(Path(folder))
    assert not list(inside.iterdir())


def test_what_another_run_wrote_in_the_meantime_is_kept(tmp_path):
    """By a script, or where the file system knows no locks."""
    with (
        pytest.raises(OutputError, match=r"results exists and is kept; give --overwrite"),
        result_folder(tmp_path / "results") as draft,
    ):
        (draft / "value.txt").write_text("late")
        write_run(tmp_path / "results", "early")
    assert (tmp_path / "results" / "value.txt").read_text() == "early"
    assert [path.name for path in tmp_path.iterdir()] == ["results"]


def test_one_run_at_a_time_has_a_folder_by_whatever_name(tmp_path):
    results, link = tmp_path / "deep" / "results", tmp_path / "link"
    link.symlink_to(results)
    with hold_target(results):
        for name in (results, link):
            with pytest.raises(OutputError, match=rf"another run writes to {name}; wait for it, or give another --out"):
                hold_target(name, overwrite=True).__enter__()
        with hold_target(tmp_path / "deep" / "others"):
            write_run(results, "1")
    assert [path.name for path in results.parent.iterdir()] == ["results"]
    with pytest.raises(OutputError, match=r"exists and is kept"):
        hold_target(results).__enter__()
    with hold_target(results, overwrite=True):
        write_run(results, "2", overwrite=True)
    assert [path.name for path in results.parent.iterdir()] == ["results"]


def test_a_run_that_failed_leaves_nothing_beside_its_folder(tmp_path):
    with pytest.raises(ZeroDivisionError), hold_target(tmp_path / "deep" / "er" / "results"):
        raise ZeroDivisionError
    assert list(tmp_path.iterdir()) == []


def test_a_run_that_was_killed_keeps_nobody_out(tmp_path):
    script = (
        "import os, sys\nfrom pathlib import Path\nfrom ewr_fenicsx.output.result_folder import hold_target\n"
        "with hold_target(Path(sys.argv[1])):\n    os.kill(os.getpid(), 9)\n"
    )
    done = subprocess.run([sys.executable, "-c", script, tmp_path / "results"], check=False, timeout=120)
    assert done.returncode == -9
    assert [path.name for path in tmp_path.iterdir()] == [".results.lock"]
    with hold_target(tmp_path / "results"):
        write_run(tmp_path / "results", "1")
    assert [path.name for path in tmp_path.iterdir()] == ["results"]


def test_what_a_killed_run_was_writing_is_removed_by_the_next_one(tmp_path):
    script = (
        "import os, sys\nfrom pathlib import Path\n"
        "from ewr_fenicsx.output.result_folder import hold_target, result_folder\n"
        "with hold_target(Path(sys.argv[1])), result_folder(Path(sys.argv[1])) as draft:\n"
        "    (draft / 'half.txt').write_text('written')\n    os.kill(os.getpid(), 9)\n"
    )
    done = subprocess.run([sys.executable, "-c", script, tmp_path / "results"], check=False, timeout=120)
    assert done.returncode == -9
    (tmp_path / ".results.mine").mkdir()
    assert len(list(tmp_path.rglob("half.txt"))) == 1
    with hold_target(tmp_path / "results.other"):
        assert len(list(tmp_path.rglob("half.txt"))) == 1, "it is not this run's"
    with hold_target(tmp_path / "results"):
        write_run(tmp_path / "results", "1")
    assert {path.name for path in tmp_path.iterdir()} == {"results", ".results.mine"}


def test_a_lock_file_that_its_run_removed_in_the_meantime_is_none(tmp_path, monkeypatch):
    """Between opening the file and locking it: a third run would then find another file of that name, and lock that."""
    first, lock = hold_target(tmp_path / "results"), fcntl.flock
    first.__enter__()

    def end_first(handle, how):
        monkeypatch.setattr(fcntl, "flock", lock)
        first.__exit__(None, None, None)
        lock(handle, how)

    monkeypatch.setattr(fcntl, "flock", end_first)
    with hold_target(tmp_path / "results"), pytest.raises(OutputError, match="another run writes to"):
        hold_target(tmp_path / "results").__enter__()
    assert list(tmp_path.iterdir()) == []


def test_a_file_system_without_locks_will_do(tmp_path, monkeypatch):
    def refuse(*_):
        raise OSError(95, "Operation not supported")

    monkeypatch.setattr(fcntl, "flock", refuse)
    with hold_target(tmp_path / "results"):
        write_run(tmp_path / "results", "1")
    assert [path.name for path in tmp_path.iterdir()] == ["results"]
