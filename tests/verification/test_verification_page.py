"""docs/verification.md is what its script writes: no row more, none less, and figures that the code still gives."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).parents[2] / "docs"))

import generate_verification as page

AGAIN = "run docs/generate_verification.py again"


def read_tables() -> dict[str, list[list[str]]]:
    """Heading -> rows of the tables below it, header first, cells as text."""
    tables, heading = {}, None
    for line in page.PAGE.read_text(encoding="utf-8").splitlines():
        if line.startswith("#"):
            heading = line.lstrip("# ")
            tables[heading] = []
        elif line.startswith("| "):
            tables[heading].append([cell.strip() for cell in line.strip("|").split("|")])
    return tables


def test_headings_are_the_scripts():
    text = page.PAGE.read_text(encoding="utf-8")
    assert text.startswith(page.INTRODUCTION), AGAIN
    sections = [*page.SECTIONS, page.BLADE_TITLE, *page.BLADE_CASES, *page.BENCHMARKS]
    assert list(read_tables()) == ["Verification", *sections], AGAIN


def test_sections_on_benchmarks_are_what_the_results_say():
    assert page.PAGE.read_text(encoding="utf-8").endswith(page.write_benchmarks()), f"{AGAIN}, with --benchmarks"


@pytest.mark.parametrize("title", page.SECTIONS)
def test_every_case_has_its_rows(title):
    header, *rows = read_tables()[title]
    assert header == page.HEADER, AGAIN
    assert list(dict.fromkeys(row[0] for row in rows)) == [name for name, *_ in page.SECTIONS[title]], AGAIN


@pytest.mark.parametrize("name", page.BLADE_CASES)
def test_every_blade_root_case_has_its_orders(name):
    header, *rows = read_tables()[name]
    assert header == page.BLADE_HEADER, AGAIN
    assert [row[:2] for row in rows] == [[c, str(n)] for c in page.CLOSURES for n in page.ORDERS], AGAIN


def test_blade_root_tip_is_within_the_target_at_the_highest_order():
    """0.3 %, modulus and rms, of what the script measured last, with either closure."""
    tables = read_tables()
    for name in page.BLADE_CASES:
        for last in (row for row in tables[name][1:] if row[1] == str(page.ORDERS[-1])):
            assert abs(float(last[3])) < 0.3 and abs(float(last[4])) < 0.3, (name, last)


LONG = ("Mass that hits a stop",)  # seconds each
ROUNDING = 1e-6  # errors below this are rounding, whose digits are the machine's own
# How far figures may be from the printed ones: printing rounds them, rounding decides at which step a mass in time
# stepping turns and at which a bisection, and gmsh's versions mesh the fir tree differently.
DIGITS, STEP, MESH = 2e-5, 1e-3, 1e-2


def read_error(cell: str) -> float:
    """The last cell but one of a row, as a share."""
    return float(cell.removesuffix(" %")) / 100 if cell.endswith(" %") else float(cell)


def list_quick_cases() -> list:
    """Title, case, and how far its figures may be off."""
    listed = []
    for title, cases in page.SECTIONS.items():
        for case in (case for case in cases if not case[0].startswith(LONG)):
            allowed = STEP if title.startswith("Time stepping") or "where stops begin" in case[0] else DIGITS
            allowed = MESH if case[0].startswith("Fir tree") else allowed
            listed.append(pytest.param(title, case, allowed, id=case[0]))
    return listed


@pytest.mark.parametrize("title, case, allowed", list_quick_cases())
def test_figures_are_those_of_todays_code(title, case, allowed):
    """The quick cases once more: the same quantities, and figures as printed but for rounding."""
    rows = [row for row in read_tables()[title][1:] if row[0] == case[0]]
    found = page.measure_case(case)
    assert [row[1] for row in rows] == [row[1] for row in found], AGAIN
    for (_, quantity, exact, ours, error, _), row in zip(rows, found, strict=True):
        if row[2] is None:
            assert exact == ours == "", AGAIN
            digits = max(0.1, 20 * allowed)  # two are printed
            assert read_error(error) == pytest.approx(read_error(row[4]), rel=digits, abs=ROUNDING), (quantity, AGAIN)
        else:
            assert float(exact) == pytest.approx(row[2], rel=allowed), (quantity, AGAIN)
            assert float(ours) == pytest.approx(row[3], rel=allowed, abs=1e-12), (quantity, AGAIN)
