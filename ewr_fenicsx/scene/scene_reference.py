"""What documents the scene file, from the scene's own definition: the reference page and the schema for editors.

``python -m ewr_fenicsx.scene.scene_reference docs`` writes both into a folder.
"""

from __future__ import annotations

import json
import sys
import types
import typing
from collections.abc import Iterator
from pathlib import Path

from pydantic_core import PydanticUndefined

from ewr_fenicsx.scene.scene import Scene
from ewr_fenicsx.scene.scene_entries import Section

_INTRODUCTION = """\
# Scene files

A scene is a TOML file that says what the joint is, how it is loaded, and what to solve. `ewr info SCENE` checks it and
shows what it holds, `ewr run SCENE` solves it. In Python the same names build a scene:
`ewr_fenicsx.Scene(geometry=..., loads=...)`.

Only keys marked **required** must be given. Paths are relative to the scene file. An unknown key is an error that
names the nearest known one. `NAME` stands for a name of your choice, `BODY` for a body of the geometry; boundaries,
bodies and flanks have the names that the geometry gives them. Loads and outputs take boundaries that are no flanks: a
flank's curves are on both bodies, and a load would be shared between them.

A complete scene, as a file in the root of this repository:

```toml
[geometry]
source = "geometry/fir_tree.py"

[loads.pull]
boundary = "tip"
force = [0.0, 20e3]

[loads.shake]
boundary = "tip"
force = [50.0, 0.0]
harmonic = 1

[excitation]
frequency = 1000.0
```

Flanks may differ in their laws: `[flanks.NAME]` says what is special about one, `[contact]` what holds everywhere else.

```toml
[contact]
friction = 0.2

[flanks.top_left]
tangential = "bonded"

[flanks.bottom_left]
friction = 0.5
initial_gap = 2e-6
```

A list of frequencies or a range is a sweep, and a table `[wear]` follows fretting wear over many cycles:

```toml
[excitation]
frequency = { from = 900.0, to = 1200.0, points = 31 }
```

```toml
[wear]
coefficient = 1e-11
cycles = 3000
tolerance = 0.01          # jumps over cycles; without it every cycle is solved
```

Entries that contradict each other are an error, and combinations that were probably not meant a warning; both say what
the scene would mean.

Editors with TOML support complete and check keys in scenes whose first line is `#:schema`, followed by the path or
address of `docs/scene.schema.json`.

This page and the schema are generated from `ewr_fenicsx/scene/scene.py`:
`python -m ewr_fenicsx.scene.scene_reference docs`.
"""


def write_schema() -> str:
    """The JSON Schema of a scene file, in the draft that editors of TOML read."""
    schema = {"$schema": "http://json-schema.org/draft-07/schema#", **_write_lists(Scene.model_json_schema())}
    return json.dumps(schema, indent=1) + "\n"


def _write_lists(schema: typing.Any) -> typing.Any:
    """A schema whose lists of unlike entries are written as in draft 07, which has another word."""
    if isinstance(schema, list):
        return [_write_lists(part) for part in schema]
    if not isinstance(schema, dict):
        return schema
    return {"items" if key == "prefixItems" else key: _write_lists(part) for key, part in schema.items()}


def write_reference() -> str:
    """The page, as markdown."""
    parts = [_INTRODUCTION, "## Top level\n\n" + _tabulate(Scene, skip_sections=True)]
    for title, kind in list_sections():
        parts.append(f"## {title}\n\n{' '.join((kind.__doc__ or '').split())}\n\n{_tabulate(kind)}")
    return "\n".join(parts)


def list_sections(parent: type[Section] = Scene, prefix: str = "") -> Iterator[tuple[str, type[Section]]]:
    """Title and definition of every table of a scene, or within another one; alternatives of a table one by one."""
    for name, field in parent.model_fields.items():
        kinds = list(_find_sections(field.annotation))
        path = prefix + name
        if typing.get_origin(field.annotation) is dict:
            path += ".BODY" if name == "materials" else ".NAME"
        for kind in kinds:
            choice = f', kind = "{typing.get_args(kind.model_fields["kind"].annotation)[0]}"' if len(kinds) > 1 else ""
            yield f"`[{path}]`{choice}", kind
            yield from list_sections(kind, f"{path}.")


def _find_sections(annotation: typing.Any) -> Iterator[type[Section]]:
    if isinstance(annotation, type) and issubclass(annotation, Section):
        yield annotation
    for inner in typing.get_args(annotation):
        yield from _find_sections(inner)


def _find_choices(annotation: typing.Any) -> list[str]:
    if typing.get_origin(annotation) is typing.Literal:
        return [str(choice) for choice in typing.get_args(annotation)]
    if typing.get_origin(annotation) in (typing.Union, types.UnionType):
        return [choice for inner in typing.get_args(annotation) for choice in _find_choices(inner)]
    return []


def _tabulate(kind: type[Section], skip_sections: bool = False) -> str:
    lines = ["| key | unit | default | meaning |", "|---|---|---|---|"]
    for name, field in kind.model_fields.items():
        if skip_sections and any(True for _ in _find_sections(field.annotation)):
            continue
        unit = (field.json_schema_extra or {}).get("unit", "-")
        choices = _find_choices(field.annotation)
        meaning = (field.description or "") + (
            " One of " + ", ".join(f"`{c}`" for c in choices) + "." if len(choices) > 1 else ""
        )
        lines.append(f"| `{field.alias or name}` | {unit} | {_show_default(field.default)} | {meaning} |")
    return "\n".join(lines) + "\n"


def _show_default(default: typing.Any) -> str:
    if default is PydanticUndefined:
        return "**required**"
    if default is None:
        return "-"
    if isinstance(default, str):
        return f'`"{default}"`'
    if isinstance(default, tuple):
        return "`[" + ", ".join(f'"{entry}"' if isinstance(entry, str) else f"{entry:g}" for entry in default) + "]`"
    return f"`{default:g}`" if isinstance(default, (int, float)) else f"`{default}`"


def main(folder: Path) -> None:
    """Writes the page and the schema into a folder."""
    (folder / "scenes.md").write_text(write_reference(), encoding="utf-8")
    (folder / "scene.schema.json").write_text(write_schema(), encoding="utf-8")


if __name__ == "__main__":
    main(Path(sys.argv[1]))
