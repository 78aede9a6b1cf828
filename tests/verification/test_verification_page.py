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


@pytest.mark.parametrize(
    "case",
    [case for case in page.SECTIONS["Harmonic balance against closed forms"] if case[0].startswith(("Den", "Jen"))],
)
def test_figures_are_those_of_todays_code(case):
    """The quick cases once more: the same quantities, and figures as printed but for rounding."""
    rows = [row for row in read_tables()["Harmonic balance against closed forms"][1:] if row[0] == case[0]]
    found = page.measure_case(case)
    assert [row[1] for row in rows] == [row[1] for row in found], AGAIN
    for printed, row in zip(rows, found, strict=True):
        assert float(printed[2]) == pytest.approx(row[2], rel=1e-5), AGAIN
        assert float(printed[3]) == pytest.approx(row[3], rel=2e-5), AGAIN
