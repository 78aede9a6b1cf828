"""What is wrong with a scene, in the words of the person who wrote it."""

from __future__ import annotations

import typing
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from pydantic import ValidationError


def explain_mistakes(error: ValidationError, data: Any, file: Path | None, sections: Mapping[str, Any]) -> str:
    """All that is wrong with a scene, one line for each key.

    Args:
        error: What pydantic found.
        data: What was given.
        file: Where it was read from, or None.
        sections: The scene's fields by name, to tell where a misplaced key belongs.
    """
    mistakes: dict[str, dict[str, None]] = {}
    for detail in error.errors(include_url=False):
        key, message = _explain_one(detail, data, sections)
        mistakes.setdefault(key, {})[message] = None
    for key in list(mistakes):  # of a list that may be a number as well, only what is wrong in it
        if any(other.startswith(f"{key.split(' = ')[0]}.") for other in mistakes):
            del mistakes[key]
    return list_mistakes([f"{key}: " * bool(key) + ", or ".join(messages) for key, messages in mistakes.items()], file)


def explain_syntax(error: ValueError | RecursionError) -> str:
    """What is wrong with a file that is not TOML; the reader's own words on keys that stand there twice tell nobody."""
    if isinstance(error, UnicodeDecodeError):
        line = error.object[: error.start].count(b"\n") + 1
        return f"line {line} is not UTF-8; save the file as UTF-8"
    if isinstance(error, RecursionError):
        return "lists or tables in one another, too many of them"
    return str(error).replace("Cannot overwrite a value", "a key that was given before")


def list_mistakes(lines: Sequence[str], file: Path | None) -> str:
    """One message of one or several mistakes."""
    where = name_scene(file)
    return f"{where}: {lines[0]}" if len(lines) == 1 else "\n  ".join([f"{where}: {len(lines)} mistakes", *lines])


def name_scene(file: Path | None) -> str:
    """How messages call a scene: by its file, where it has one."""
    return f"scene {file}" if file else "scene"


def _explain_one(detail: Mapping[str, Any], data: Any, sections: Mapping[str, Any]) -> tuple[str, str]:
    """Key with its value, and what is wrong with it."""
    kind, message, loc = detail["type"], detail["msg"], detail["loc"]
    if kind == "unknown_key":
        loc = (*loc, detail["ctx"]["key"])
        homes = [name for name, field in sections.items() if loc[-1] in getattr(field.annotation, "model_fields", {})]
        if homes and "belongs to" not in message:
            meant = message.partition("; did you mean ")[2] if len(loc) > 1 else ""  # a key at the top is a table's
            message = f"unknown key here; it belongs to [{homes[0]}]" + f", or did you mean {meant}" * bool(meant)
    elif kind == "kind":
        loc = (*loc, "kind")
    elif kind == "missing" and isinstance(loc[-1], int):
        loc, message = loc[:-1], "has too few entries"
    elif kind == "too_long":
        count, most = detail["ctx"]["actual_length"], detail["ctx"]["max_length"]
        message = f"has too many entries: {count}, and only {most} mean something"
    elif kind == "too_short":
        message = f"has too few entries; give at least {detail['ctx']['min_length']}"
    elif kind == "missing":
        return ".".join(
            str(step) for step in loc if not str(step).startswith("kind=")
        ), "missing, and it has no default"
    for limit in {"gt", "ge", "lt", "le"} & set(detail.get("ctx", ())):  # pydantic writes 1e-13 with all its zeros
        message = f"{message.rsplit(' ', 1)[0]} {detail['ctx'][limit]:g}"
    if kind == "path_type":
        message = "should be a path, in quotes"
    no_table = kind in ("dict_type", "model_type", "model_attributes_type")
    if no_table and len(loc) > 1 and typing.get_origin(sections[loc[0]].annotation) is dict:  # such as loads
        strays = [key for key, entry in data[loc[0]].items() if not isinstance(entry, Mapping)]
        if loc[1] in strays and not _lists_tables(data[loc[0]][loc[1]]):
            name = "BODY" if loc[0] == "materials" else "NAME"
            return f"[{loc[0]}]", f'"{strays[0]}" stands in no table with a name; write [{loc[0]}.{name}] above it'
    path: list[str] = []
    for step in loc:
        # pydantic's location also holds the names of alternatives ("kind=force", "int"), which no user wrote
        if (isinstance(data, Mapping) and step in data) or (
            isinstance(data, (list, tuple)) and isinstance(step, int) and step < len(data)
        ):
            data = data[step]
        else:
            continue
        path.append(str(step))
    if no_table:
        message = "should be a table" + ", in single brackets" * _lists_tables(data)
    for theirs, ours in (
        ("Input should", "should"),
        ("Tuple should", "should"),
        ("a valid tuple", "a list"),
        ("a valid integer", "a whole number"),
        ("a valid ", "a "),
    ):
        message = message.replace(theirs, ours)
    if message.endswith("a whole number") and isinstance(data, float) and data.is_integer():  # 1e6 is one
        message = f"{message}, without point and exponent: {int(data)}"
    key = ".".join(path)
    shown = (isinstance(data, Mapping) and kind != "unknown_key") or not key
    return key if shown else f"{key} = {data!r}", message


def _lists_tables(entry: Any) -> bool:
    """Whether an entry is what double brackets make in TOML."""
    return isinstance(entry, list) and any(isinstance(table, Mapping) for table in entry)
