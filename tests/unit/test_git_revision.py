"""The revision that a summary names is this package's, or none."""

from __future__ import annotations

import shutil
import subprocess

import pytest

from ewr_fenicsx.output import output


@pytest.mark.skipif(shutil.which("git") is None, reason="git is not installed")
def test_a_checkout_around_the_installed_package_is_not_its_own(tmp_path, monkeypatch):
    """Installed into a virtual environment within a user's project, it told the project's revision."""

    def git(*arguments: str) -> str:
        command = ["git", "-C", str(tmp_path), "-c", "user.name=n", "-c", "user.email=e", *arguments]
        return subprocess.run(command, capture_output=True, text=True, check=True).stdout.strip()

    here = tmp_path / "output.py"
    here.touch()
    monkeypatch.setattr(output, "__file__", str(here))
    git("init")
    git("commit", "--allow-empty", "--message=theirs")
    assert output.find_git_revision() is None
    git("add", here.name)
    git("commit", "--message=ours")
    assert output.find_git_revision() == git("rev-parse", "HEAD")
