"""What several unit tests need."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

from ewr_fenicsx.scene.scene import Scene, load_scene


@pytest.fixture
def read(tmp_path: Path) -> Callable[..., Scene]:
    """Write a scene beside a builder and load it."""
    (tmp_path / "builder.py").write_text("def build(): ...")

    def write_and_load(text: str, warn: bool = False) -> Scene:
        (tmp_path / "scene.toml").write_text(text)
        return load_scene(tmp_path / "scene.toml", warn=warn)

    return write_and_load
