"""The schema by which editors help with scenes: what the definition says, and what the demos follow."""

from __future__ import annotations

import json
import tomllib
from pathlib import Path

import pytest

from ewr_fenicsx.scene.scene_reference import write_schema

ROOT = Path(__file__).parents[2]


def facts(schema: dict) -> dict:
    """What a schema says, apart from titles and the order and form that another pydantic may choose."""
    tables = {"": schema} | schema["$defs"]
    return {
        f"{name}.{key}": {k: v for k, v in entry.items() if k in ("default", "unit", "description", "enum", "minimum")}
        for name, table in tables.items()
        for key, entry in table["properties"].items()
    } | {f"{name} requires": sorted(table.get("required", [])) for name, table in tables.items()}


def test_schema_file_is_the_one_generated_from_the_definition():
    written = json.loads((ROOT / "docs" / "scene.schema.json").read_text(encoding="utf-8"))
    assert facts(written) == facts(json.loads(write_schema())), "run: python -m ewr_fenicsx.scene.scene_reference docs"


def test_lists_are_written_in_the_draft_that_the_schema_names():
    """Validators of draft 07 pass over ``prefixItems``, and lists of anything with it."""
    written = json.loads((ROOT / "docs" / "scene.schema.json").read_text(encoding="utf-8"))
    tables = written["$defs"]
    assert [entry["type"] for entry in tables["Cyclic"]["properties"]["axis"]["items"]] == ["number"] * 3
    assert [entry["exclusiveMaximum"] for entry in tables["RatioDamping"]["properties"]["ratios"]["items"]] == [1, 1]
    assert "prefixItems" not in json.dumps(written)


def find_table(schema: dict, entry: dict, value: dict) -> dict | None:
    """The table definition that an entry leads to for a value."""
    for part in [entry, *entry.get("anyOf", []), *entry.get("oneOf", [])]:
        if "$ref" in part:
            table = schema["$defs"][part["$ref"].rsplit("/", 1)[1]]
            kind = table["properties"].get("kind", {})
            if "kind" not in value or value["kind"] in (kind.get("const"), *kind.get("enum", [])):
                return table
    return None


def check_keys(schema: dict, table: dict, data: dict, path: str = "") -> None:
    assert set(table.get("required", [])) <= set(data), path
    for key, value in data.items():
        assert key in table["properties"], f"{path}{key}"
        if not isinstance(value, dict) or key == "parameters":
            continue
        entry = table["properties"][key]
        if (named := entry.get("additionalProperties")) is not None:
            for name, inner in value.items():
                if "enum" in named:
                    assert inner in named["enum"], f"{path}{key}.{name}"
                    continue
                if named.get("type") == "array":
                    assert named["minItems"] <= len(inner) <= named["maxItems"], f"{path}{key}.{name}"
                    continue
                check_keys(schema, find_table(schema, named, inner), inner, f"{path}{key}.{name}.")
        else:
            check_keys(schema, find_table(schema, entry, value), value, f"{path}{key}.")


@pytest.mark.parametrize("path", sorted(ROOT.glob("demos/*.toml")), ids=lambda path: path.stem)
def test_demo_scenes_follow_the_schema_that_they_name(path):
    text = path.read_text(encoding="utf-8")
    first = text.splitlines()[0]
    named = first.removeprefix("#:schema ") if first.startswith("#:schema ") else "../docs/scene.schema.json"
    schema = json.loads((path.parent / named).read_text(encoding="utf-8"))
    check_keys(schema, schema, tomllib.loads(text))


def test_most_demo_scenes_name_the_schema():
    """So that editors help with the first scene that someone opens."""
    named = {p.stem for p in ROOT.glob("demos/*.toml") if p.read_text(encoding="utf-8").startswith("#:schema ")}
    gallery = {"blade_root", "two_blocks", "dovetail", "bolted_lap", "tapping_rod", "friction_damped_beam"}
    assert gallery | {"platform_damper"} <= named
