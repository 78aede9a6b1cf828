"""A wear calculation killed at any moment and taken up again leaves the file of an unbroken one, byte for byte."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

FOLDER = Path(__file__).parents[1]
SCRIPT = """
import sys
from ewr_fenicsx import ContactLaws, ContactProblem, Tolerance, evolve_wear
from small_models import dovetail

file, jumps = sys.argv[1], sys.argv[2] == "jumps"
problem = ContactProblem(dovetail(excitation=200.0), ContactLaws(friction=0.2), 600.0)
jump = Tolerance(share=1e-4) if jumps else None
history = evolve_wear(problem, 120, 1e-10, jump, keep_every=3, file=file, checkpoint_every=4)
assert history.cycles[-1] == 120
"""


def start(file: Path, mode: str) -> subprocess.Popen:
    environment = os.environ | {"PYTHONPATH": f"{FOLDER.parent}:{FOLDER}"}
    return subprocess.Popen([sys.executable, "-c", SCRIPT, file, mode], env=environment)


def kill_after_updates(process: subprocess.Popen, file: Path, updates: int, delay: float) -> bool:
    """SIGKILL once the file has been replaced so many times and a moment more has gone by; whether it was in time."""
    seen, last = 0, file.stat().st_mtime_ns if file.exists() else None
    while process.poll() is None:
        now = file.stat().st_mtime_ns if file.exists() else None
        if now != last:
            last, seen = now, seen + 1
            if seen >= updates:
                time.sleep(delay)
                process.send_signal(signal.SIGKILL)
                break
        time.sleep(1e-3)
    return process.wait() == -signal.SIGKILL


@pytest.mark.parametrize("mode", ["cycles", "jumps"])
def test_killed_and_resumed_is_unbroken(tmp_path, mode):
    unbroken, broken = tmp_path / "unbroken.h5", tmp_path / "broken.h5"
    assert start(unbroken, mode).wait(timeout=120) == 0
    kills = 0
    for updates, delay in ((1, 0.0), (3, 0.013), (7, 0.004)):
        kills += kill_after_updates(start(broken, mode), broken, updates, delay)
    assert kills == 3
    assert broken.read_bytes() != unbroken.read_bytes(), "it was not done when it was killed"
    assert start(broken, mode).wait(timeout=120) == 0
    assert broken.read_bytes() == unbroken.read_bytes()
    leftovers = {path.name for path in tmp_path.iterdir()} - {"unbroken.h5", "broken.h5"}
    assert all(name.startswith(".broken.h5.") for name in leftovers), "at most drafts of killed writers"
