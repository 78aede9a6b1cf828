"""Writes docs/studies.md and its pictures from what the demos of the paper's studies left in demos/results.

    .venv/bin/python docs/generate_studies.py

Run the five demos first; numbers and verdicts are theirs.
"""

from __future__ import annotations

import json
import shutil
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
RESULTS, DOCS = ROOT / "demos" / "results", ROOT / "docs"
STUDIES = {
    "contact_sets": "Figure 4: does the truncated solution stay on the contact sets?",
    "normal_forces": "Figure 5: what does vibration do to the normal forces?",
    "friction_damping": "Figure 6: which friction damps the blade best?",
    "fretting_wear": "Figures 7 and 8: how do the flanks wear?",
    "wear_and_response": "Figure 9: what does wear do to the response?",
}
INTRODUCTION = """# The paper's studies, on our fir tree

The paper reports its Figures 4 to 9 on an industrial blade that is not public. Here each is repeated on this package's
own fir tree (`geometry/fir_tree.py`) by a demo, and each statement of the paper is judged by the numbers of that demo:
it *agrees* with what we see, *differs*, or *can't be told*. Nothing was tuned to look right. The two structures are not
the same, and the paper does not say how hard its blade is pulled and shaken; so a difference does not mean that either
is wrong.

mu is the coefficient of friction, N the highest harmonic, J_T the sliding distance a cycle and J_N the gap, both means
over the pairs; all are defined in [method.md](method.md#figures-of-merit-solutionpy-indicatorspy). Flanks are named as
in the picture at the top of the [README](../README.md). "Figures" below a table unfolds all numbers.

Written by `docs/generate_studies.py` from the demos' results; do not edit.
"""


def main() -> int:
    missing = [name for name in STUDIES if not (RESULTS / name / f"{name}.json").exists()]
    if missing:
        print(f"no results of {', '.join(missing)}; run demos/{missing[0]}.py first", file=sys.stderr)
        return 1
    parts = [INTRODUCTION]
    for name, title in STUDIES.items():
        content = json.loads((RESULTS / name / f"{name}.json").read_text(encoding="utf-8"))
        shutil.copyfile(RESULTS / name / f"{name}.png", DOCS / "pictures" / f"{name}.png")
        parts.append(f"## {title}\n\n`demos/{name}.py`\n\n![{title}](pictures/{name}.png)\n")
        parts.append("| The paper | Ours | Because |\n|---|---|---|")
        parts += [f"| {v['statement']} | {v['verdict']} | {v['because']} |" for v in content["verdicts"]]
        parts.append("\n<details><summary>Figures</summary>\n\n| figure | value |\n|---|---|")
        parts += [f"| {key} | {show(value)} |" for key, value in content["figures"].items()]
        parts.append("\n</details>\n")
    (DOCS / "studies.md").write_text("\n".join(parts), encoding="utf-8")
    print(f"wrote {DOCS / 'studies.md'}")
    return 0


def show(value: object) -> str:
    """A figure for people: few digits, lists and tables in a line."""
    if isinstance(value, dict):
        return "; ".join(f"{key} {show(v)}" for key, v in value.items())
    if isinstance(value, list):
        return ", ".join(show(v) for v in value) or "none"
    return f"{value:.4g}" if isinstance(value, float) else str(value)


if __name__ == "__main__":
    sys.exit(main())
