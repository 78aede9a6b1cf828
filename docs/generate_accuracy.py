"""Write docs/accuracy.md and its pictures from what the two accuracy benchmarks measured.

OPENBLAS_NUM_THREADS=1 .venv/bin/python benchmarks/accuracy_cost.py
OPENBLAS_NUM_THREADS=1 .venv/bin/python benchmarks/accuracy_honesty.py
.venv/bin/python docs/generate_accuracy.py
"""

from __future__ import annotations

import argparse
import json
from collections import Counter
from pathlib import Path

from accuracy_text import PAGE_TEXT
from markdown_tables import percent, write_table

from ewr_fenicsx.accuracy.cost import LOOSE, choose_cheapest, fit_slope
from ewr_fenicsx.output.cost_plots import draw_work_precision

ROOT = Path(__file__).resolve().parent.parent
RESULTS, PAGE = ROOT / "benchmarks" / "results", ROOT / "docs" / "accuracy.md"
LEVELS = (0.1, 0.03, 0.01, 0.003, 0.001)
ROUNDING = 1e-9  # relative errors below it are no truncation
NAMES = {
    "output": "response, amplitude and phase",
    "rms": "response, rms",
    "J_T": "sliding, J_T",
    "largest normal force": "largest normal force",
    "normal forces": "normal forces, all pairs and times",
    "deepest wear": "deepest wear a cycle",
    "wear": "wear a cycle, all pairs",
    "signorini": "Signorini violation",
    "coulomb": "Coulomb violation",
}
TRUE_ERRORS = tuple(NAMES)[:7]
PICTURE = {
    "work_precision_knobs": ("N", "samples", "rho_N over default", "rho_T over default", "tolerance", "time steps"),
    "work_precision_best": (
        "N",
        "N, rho_T by mobility",
        "N, rho_T by mobility, 8 N samples",
        "N, springs",
        f"N, springs, tolerance {LOOSE:g}",
        "N, odd harmonics only",
        'N, static friction "zero"',
        "time steps",
        "time steps, accelerated",
        "accuracy asked for",
    ),
}


def tell_reference(cost: dict) -> str:
    """How far the reference can be trusted, by quantity."""
    rows = [[NAMES[e], percent(cost["own_error"][e]), percent(cost["agreement"][e])] for e in TRUE_ERRORS]
    header = [
        "quantity",
        "change with the last halving of the step",
        f"harmonic solve, N = {cost['high_order']}, from it",
    ]
    return write_table(header, rows)


def tell_choice(rows: list[dict]) -> str:
    """What to choose for each quantity and level: the cheapest harmonic setting, and the cheapest time stepping."""
    table = []
    stepping = [r for r in rows if r["knob"].startswith("time steps")]
    harmonic = [r for r in rows if r["knob"].startswith("N")]
    for error in TRUE_ERRORS:
        for level in LEVELS:
            best, other = (choose_cheapest(part, error, level) for part in (harmonic, stepping))
            name = lambda r: None if r is None else f"{r['knob']} = {r['value']:g}"  # noqa: E731
            seconds = lambda r: None if r is None else r["seconds"]  # noqa: E731
            table.append([NAMES[error], percent(level), name(best) or "none tried", seconds(best)])
            table[-1] += [name(other) or "none tried", seconds(other)]
    return write_table(["quantity", "error", "cheapest harmonic setting", "s", "cheapest time stepping", "s"], table)


def tell_knob(rows: list[dict], knob: str) -> str:
    """All errors along one knob, and how time and errors change with it."""
    mine = [r for r in rows if r["knob"] == knob]
    values = [r["value"] for r in mine]
    table = [
        [f"{r['value']:g}", r["unknowns"], r["steps"], r["seconds"], *(percent(r["errors"][e]) for e in NAMES)]
        for r in mine
    ]
    slopes = [_fit_power(mine, e) for e in NAMES]
    power = lambda slope: "" if slope != slope else f"^{slope:.1f}"  # noqa: E731
    table.append(["as a power", "", "", power(fit_slope(values, [r["seconds"] for r in mine])), *map(power, slopes)])
    return write_table([knob, "unknowns", "steps", "s", *NAMES.values()], table)


def _fit_power(rows: list[dict], error: str) -> float:
    """Power of the knob with which an error falls; errors of the size of rounding say nothing about it."""
    telling = [r for r in rows if r["errors"][error] > ROUNDING]
    return fit_slope([r["value"] for r in telling], [r["errors"][error] for r in telling])


def tell_structure(rows: list[dict]) -> str:
    """Errors of modes, meshes and pairs, and the time of the stages that they cost."""
    names = list(rows[0]["errors"])
    table = []
    for r in rows:
        stages = r["stages"]
        row = [r["knob"], f"{r['value']:g}", r["nodes"], r["pairs"], stages["mesh"], stages["matrices"]]
        row += [
            stages["reduction"],
            r["solve"],
            *(percent(r["errors"][n]) if any(r["errors"].values()) else "reference" for n in names),
        ]
        table.append(row)
    header = [
        "knob",
        "value",
        "nodes",
        "pairs",
        "mesh, s",
        "matrices, s",
        "modes and compliance, s",
        "solve, s",
        *names,
    ]
    return write_table(header, table)


def tell_dominance(cost: dict) -> str:
    """How large each error is at the package's defaults: more of a knob buys nothing where another is larger."""
    rows, structure = cost["rows"], cost["structure"]
    at = lambda knob, value: next((r for r in rows if r["knob"] == knob and r["value"] == value), None)  # noqa: E731
    part = lambda knob, value: next(  # noqa: E731
        (r["errors"]["tip"] for r in structure if r["knob"] == knob and abs(r["value"] - value) < 1e-9), None
    )
    base = at("samples", 32 * 9)
    samples = [r for r in rows if r["knob"] == "samples"]
    table = [
        ["mesh, 1.4 mm, degree 1", percent(part("mesh size [mm], degree 1", 1.4)), "elements of degree 2"],
        ["mesh, 0.7 mm, degree 1", percent(part("mesh size [mm], degree 1", 0.7)), "elements of degree 2"],
        ["mesh, 2 mm, degree 2", percent(part("mesh size [mm], degree 2", 2.0)), "1.4 mm"],
        ["pairs, 10 a flank, mesh 0.7 mm", percent(part("pairs a flank, mesh 0.7 mm", 10)), "20 a flank"],
        ["N = 5", percent(at("N", 5)["errors"]["output"]), "N = 9"],
        ["N = 9", percent(at("N", 9)["errors"]["output"]), "N = 15"],
        ["30 modes", percent(part("modes", 30)), "60 modes"],
    ]
    if base and samples:
        change = abs(base["errors"]["output"] - samples[-1]["errors"]["output"])
        table.append(["32 samples a harmonic, N = 9", percent(change), "64 a harmonic"])
    tolerance = [r for r in rows if r["knob"] == "tolerance"]
    change = abs(tolerance[-2]["errors"]["output"] - tolerance[-1]["errors"]["output"])
    table.append(["tolerance 1e-8", percent(change), "1e-10"])
    return write_table(["error of the response at 1000 Hz by", "size", "what would lower it"], table)


def tell_peak(peak: dict) -> str:
    """Peak frequency and height by N."""
    rows = [
        [f"N = {n:g}", f"{f:.2f}", f"{1e3 * h:.4f}", percent(df), percent(dh), s] for n, f, h, df, dh, s in peak["rows"]
    ]
    f, h, s = peak["reference"]
    own = [f"to {percent(error)}" for error in peak["own_error"]]
    rows.append(["time stepping, three points", f"{f:.2f}", f"{1e3 * h:.4f}", *own, s])
    return write_table(["", "peak, Hz", "rms, mm", "frequency off by", "height off by", "s"], rows)


def tell_wear(rows: list[dict]) -> str:
    """Cycle jumps against every cycle."""
    table = [
        [
            "every cycle" if r["tolerance"] is None else f"{r['tolerance']:g}",
            *(r["solves"], r["seconds"], percent(r["largest"]), percent(r["L2"])),
        ]
        for r in rows
    ]
    return write_table(["tolerance of a jump", "solves", "s", "largest error of depth", "all pairs"], table)


def tell_adapted(rows: list[dict]) -> str:
    """All harmonics against those chosen."""
    table = [
        [
            *(r["case"], "all" if not r["share"] else f"{r['share']:g}", r["harmonics"], r["unknowns"], r["seconds"]),
            percent(r["change"]) if r["share"] else "",
        ]
        for r in rows
    ]
    return write_table(["case", "share of forces left out", "harmonics", "unknowns", "s", "response changes by"], table)


def tell_stages(stages: dict) -> str:
    """Times of the stages of a run and the memory of solves."""
    rows = [[name, *(f"{t:.3f}" for t in times)] for name, times in stages["stages"].items()]
    memory = [[m["N"], m["unknowns"], m["peak_MB"]] for m in stages["memory"]]
    return "\n\n".join(
        [
            write_table(["stage", "first run, s", "again, s"], rows),
            write_table(["N", "unknowns", "memory of the solve, MB"], memory),
        ]
    )


def tell_asked(rows: list[dict], found: dict) -> str:
    """Accuracies asked for on the blade root, and over the sample."""
    table = [
        [
            percent(r["value"]),
            percent(r["errors"]["output"]),
            percent(r["estimate"]),
            r["N"],
            r["unknowns"],
            r["seconds"],
        ]
        for r in rows
        if r["knob"] == "accuracy asked for"
    ]
    sample = [[cell if not isinstance(cell, float) else f"{cell:.3g}" for cell in row] for row in found["table"]]
    return "\n\n".join(
        [
            "The blade root at 1000 Hz:",
            write_table(["asked", "true error", "estimate", "highest harmonic", "unknowns", "s"], table),
            "Over the sample: " + ", ".join(f"{n} {kind}" for kind, n in found["kinds"].items()) + ".",
            write_table(found["header"], sample),
        ]
    )


def tell_ways(found: dict) -> str:
    """How many cases of the sample have a reference by which ways."""
    names = {"both": "both", "time stepping": "time stepping alone", "harmonic": "harmonics alone"}
    ways = Counter(c["way"] for c in found["cases"] if c["kind"] == "compared")
    return ", ".join(f"{n} by {names[way]}" for way, n in ways.most_common())


def list_misses(found: dict) -> str:
    """Cases whose true error is above what was asked and thought to be reached."""
    rows = [
        [c["name"], percent(r["accuracy"]), *(f"{100 * r[name]:.2f} %" for name in ("estimate", "true"))]
        for c in found["cases"]
        if c["kind"] == "compared"
        for r in c["asked"]
        if r.get("reached") and r["true"] > r["accuracy"]
    ]
    return write_table(["case", "asked", "estimate", "true"], rows) if rows else "None."


def write_page(cost: dict, found: dict, pictures: Path) -> str:
    """The page as Markdown; draws its pictures."""
    rows = cost["rows"]
    for row in rows:  # time stepping counts by what it has reached, steady by its own judgement or not
        row["converged"] |= row["knob"].startswith("time steps")
    pictures.mkdir(exist_ok=True)
    for name, knobs in PICTURE.items():
        chosen = {e: NAMES[e] for e in ("output", "rms", "normal forces", "wear")}
        draw_work_precision(pictures / f"{name}.png", rows, chosen, shown=knobs)
    here = lambda knob: tell_knob(rows, knob)  # noqa: E731
    paper = [r for r in rows if r["value"] == 5 and r["knob"] in ("N", 'N, static friction "zero"')]
    paper_table = [
        ["resolved" if r["knob"] == "N" else "zero", r["seconds"], *(percent(r["errors"][e]) for e in NAMES)]
        for r in paper
    ]
    return PAGE_TEXT.format(
        frequency=cost["frequency"],
        reference=tell_reference(cost),
        choice=tell_choice(rows),
        dominance=tell_dominance(cost),
        paper=write_table(["static friction", "s", *NAMES.values()], paper_table),
        orders=here("N"),
        mobility=here("N, rho_T by mobility"),
        springs=here("N, springs"),
        loose=here(f"N, springs, tolerance {LOOSE:g}"),
        lean=here("N, rho_T by mobility, 8 N samples"),
        odd=here("N, odd harmonics only"),
        zero=here('N, static friction "zero"'),
        samples=here("samples"),
        normal=here("rho_N over default"),
        tangential=here("rho_T over default"),
        tolerance=here("tolerance"),
        stepping=here("time steps"),
        accelerated=here("time steps, accelerated"),
        structure=tell_structure(cost["structure"]),
        peak=tell_peak(cost["peak"]),
        wear=tell_wear(cost["wear"]),
        adapted=tell_adapted(cost["adapted"]),
        stages=tell_stages(cost["stages"]),
        asked=tell_asked(rows, found),
        misses=list_misses(found),
        without="\n".join(f"- {c['name']}" for c in found["cases"] if c["kind"] not in ("compared", "linear"))
        or "None.",
        ways=tell_ways(found),
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--results", type=Path, default=RESULTS, help="folder of the JSON files")
    parser.add_argument("--page", type=Path, default=PAGE, help="page to write")
    arguments = parser.parse_args()
    read = lambda name: json.loads((arguments.results / f"{name}.json").read_text(encoding="utf-8"))  # noqa: E731
    arguments.page.parent.mkdir(parents=True, exist_ok=True)
    text = write_page(read("accuracy_cost"), read("accuracy_honesty"), arguments.page.parent / "pictures")
    arguments.page.write_text(text, encoding="utf-8")
    print(f"wrote {arguments.page}")


if __name__ == "__main__":
    main()
