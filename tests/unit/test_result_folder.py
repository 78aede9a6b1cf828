"""Result folders appear complete or not at all."""

from __future__ import annotations

import json

import pytest

from ewr_fenicsx.errors import OutputError
from ewr_fenicsx.result_folder import check_target, result_folder


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


def test_a_link_that_leads_nowhere_is_refused_before_any_work(tmp_path):
    (tmp_path / "loop").symlink_to("loop")
    with pytest.raises(OutputError, match=r"loop is a file; give another --out"):
        check_target(tmp_path / "loop")
