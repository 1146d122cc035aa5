"""Campaign logs as a Markdown table: ``python fuzz/report.py LOG.jsonl ... > table.md``."""

from __future__ import annotations

import json
import sys
from pathlib import Path


def table(lines: list[str]) -> str:
    """One row per campaign, in order; crashes by place."""
    rows = ["| target | seed | inputs | different | read | refused cleanly | crashes | slowest, CPU s |"]
    rows.append("|---|---|---|---|---|---|---|---|")
    total = 0
    for line in lines:
        c = json.loads(line)
        if "died" in c:
            rows.append(f"| {c['target']} | | | | | | **{c['died']}** | |")
            continue
        total += c["inputs"]
        crashes = "; ".join(f"{n}x {where}" for where, n in c["places"].items()) or "0"
        numbers = " | ".join(f"{c[k]:,}" for k in ("inputs", "distinct", "read", "refused"))
        rows.append(f"| {c['target']} | {c['seed']} | {numbers} | {crashes} | {c['slowest_s']:.2f} |")
    rows.append(f"\n{total:,} inputs in {len(lines)} campaigns.")
    return "\n".join(rows)


if __name__ == "__main__":
    print(table([line for name in sys.argv[1:] for line in Path(name).read_text().splitlines() if line.strip()]))
