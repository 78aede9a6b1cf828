"""What the README says holds: its Python runs, and the commands and files that it names exist."""

from __future__ import annotations

import re
import subprocess
import textwrap
from pathlib import Path

import numpy as np
import pytest

from ewr_fenicsx.cli import parse_arguments

ROOT = Path(__file__).parents[2]
README = (ROOT / "README.md").read_text(encoding="utf-8")


def code_after(heading: str) -> str:
    """The indented lines of a section up to its next plain text."""
    section = README.split(f"## {heading}\n", 1)[1].split("\n## ", 1)[0]
    lines = re.match(r"\s*\n((?:    .*\n|\n)+)", section)[1].splitlines()
    return "\n".join(line[4:] for line in lines)


def test_ten_lines_of_python(capsys):
    """They end with a converged solution whose friction dissipates the work that the damper does not."""
    code = code_after("Ten lines of Python")
    assert len([line for line in code.splitlines() if line.strip()]) <= 10
    names: dict = {}
    exec(compile(code, "README.md", "exec"), names)
    assert "converged" in capsys.readouterr().out
    solution = names["solution"]
    amplitude = np.abs(solution.output("mass")[0])
    free = 100.0 / abs(1e6 + 20j * 2 * np.pi * 150 - (2 * np.pi * 150) ** 2)
    assert 0 < amplitude < free, "friction takes from the amplitude"
    merit = solution.merit
    work = merit["viscous_dissipation"] + merit["friction_dissipation"]
    assert merit["excitation_work"] == pytest.approx(work, rel=1e-6)


def test_what_follows_the_ten_lines_runs_after_them(tmp_path, monkeypatch):
    """In their order, and with no name that is not there."""
    monkeypatch.chdir(tmp_path)
    names: dict = {}
    exec(compile(code_after("Ten lines of Python"), "README.md", "exec"), names)
    snippets = re.findall(r"(?:^(?:    .*)?\n)+", README.split("## Ten lines of Python")[1], flags=re.MULTILINE)
    accuracy, many, worn = (
        next(s for s in snippets if name in s) for name in ("accuracy=0.01", "frequency_response(", "evolve_wear(")
    )
    assert many == worn, "one block"
    exec(compile(textwrap.dedent(accuracy), "README.md", "exec"), names)
    assert names["accurate"].estimated_error <= 0.01 and not names["accurate"].short
    (tmp_path / "demos").symlink_to(ROOT / "demos")
    exec(compile(textwrap.dedent(many), "README.md", "exec"), names)
    peak = {key: np.abs(curve.output("mass")[:, 1]).max() for key, curve in names["curves"].items()}
    assert np.abs(names["curve"].output("mass")[:, 1]).max() == peak[0.3] < peak[0.1]
    assert names["wear"].cycles[-1] == 3000 and names["wear"].depth[-1].max() > 0


def test_commands_exist():
    for target in re.findall(r"make ([\w-]+)", README):
        done = subprocess.run(["make", "--dry-run", target], cwd=ROOT, capture_output=True, text=True, check=False)
        assert done.returncode == 0, done.stderr
    commands = re.findall(r"^    (ewr .*?)(?: +#.*)?$", README, flags=re.MULTILINE)
    assert len(commands) == 3
    for command in commands:
        arguments, rest = parse_arguments(command.split()[1:])
        assert not rest and (ROOT / arguments.scene).is_file()


def test_one_version_everywhere(capsys):
    with pytest.raises(SystemExit) as stop:
        parse_arguments(["--version"])
    assert stop.value.code == 0
    version = capsys.readouterr().out.split()[-1]
    assert f'version = "{version}"' in (ROOT / "pyproject.toml").read_text(encoding="utf-8")
    assert f"\nversion: {version}\n" in (ROOT / "CITATION.cff").read_text(encoding="utf-8")
    assert f"## {version} " in (ROOT / "CHANGELOG.md").read_text(encoding="utf-8")


def test_files_exist():
    for name in re.findall(r"`([\w./]+\.(?:py|md|toml))`", README) + re.findall(r"\]\(([\w./]+)\)", README):
        assert (ROOT / name).is_file() or list((ROOT / "ewr_fenicsx").rglob(name)), name
