"""Scenes as the text that a user would write: one that can be read, one that runs, and the demos'."""

from __future__ import annotations

from pathlib import Path

# To be read beside a file builder.py, whatever that holds
HEAD = "[geometry]\nsource = 'builder.py'\n"
PULL = "[loads.pull]\nboundary = 'tip'\nforce = [0, 20e3]\n"
SHAKE = "[loads.shake]\nboundary = 'tip'\nforce = [50, 0]\nharmonic = 1\n"
AT = "[excitation]\nfrequency = 1000\n"
SCENE = HEAD + PULL + SHAKE + AT

BLOCKS = Path(__file__).parent / "geometry" / "two_blocks.py"
ROOT = Path(__file__).parents[1]


def read_demo(name: str) -> str:
    """The scene of a demo, to be read anywhere: the path of its builder is a whole one."""
    text = (ROOT / "demos" / f"{name}.toml").read_text(encoding="utf-8")
    return text.replace("../geometry", str(ROOT / "geometry"))


def write_blocks(
    *entries: str,
    source: Path = BLOCKS,
    parameters: str = "",
    shake: float = 50.0,
    frequency: object = 1000.0,
    solver: str = "harmonics = 3",
) -> str:
    """A block pressed on another one and shaken along it.

    Args:
        entries: Further tables.
        source: Builder or mesh.
        parameters: Of the builder, as TOML.
        shake: Amplitude of the oscillating force [N]; the static one is 1 kN.
        frequency: In Hz, or a sweep as TOML.
        solver: What stands in that table.
    """
    tables = f"""
[geometry]
source = "{source}"
parameters = {{ {parameters} }}

[loads.push]
boundary = "tip"
force = [0.0, -1000.0]

[loads.shake]
boundary = "tip"
force = [{shake}, 0.0]
harmonic = 1

[outputs.tip]
boundary = "tip"
direction = [1.0, 0.0]

[excitation]
frequency = {frequency}

[solver]
{solver}
"""
    return "\n".join([tables, *entries, ""])
