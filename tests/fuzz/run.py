"""Run the fuzz of the file readers, and print or write its table.

    python tests/fuzz/run.py [--cases N] [--seed S] [--only NAME] [--table FILE]
    python tests/fuzz/run.py --cases N --beside COMMIT=FILE -o benchmarks/results/hostile_files.json

Case k of a family has the generator `numpy.random.default_rng([seed, crc32 of the family's name, k])`. To try another
version of the package put its sources first on PYTHONPATH; its rows, in FILE, are then set beside those of this one.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

ROOT = Path(__file__).resolve().parents[2]
sys.path[:0] = [str(ROOT / "tests"), str(ROOT / "benchmarks")]

from measure import write_document  # noqa: E402 the paths come first
from support.fuzz_files import families, run_cases, summarize  # noqa: E402


def run(cases: int, seed: int, only: str) -> list[dict[str, Any]]:
    """Print and return the rows of the families whose names hold `only`."""
    rows = []
    with TemporaryDirectory() as folder:
        chosen = [family for family in families(Path(folder) / "healthy") if only in family.name]
        total = sum(family.weight for family in chosen)
        for family in chosen:
            share = round(cases * family.weight / total)
            (row,) = summarize(run_cases([family], share, seed, Path(folder)), [family])
            rows.append(row)
            print(
                f"{row['point']:3} {row['family']:22} {row['cases']:5} cases: {row['read']:5} read, "
                f"{row['refused']:5} refused, {row['failures']:4} failures; {row['longest_s']:6.1f} s, "
                f"{row['largest_mb']:5} MB {row['kinds'] or ''}",
                *(f"      {example}" for example in row["examples"]),
                sep="\n",
                flush=True,
            )
    return rows


def main() -> int:
    """Run, print and write; returns 1 where a case failed."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--cases", type=int, default=3000)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--only", default="", help="families whose names hold this")
    parser.add_argument("--table", type=Path, help="write the rows alone")
    parser.add_argument("--beside", default="", metavar="COMMIT=FILE", help="rows of another version")
    parser.add_argument("-o", "--out", type=Path, help="write a committed result")
    arguments = parser.parse_args()
    began = time.perf_counter()
    rows = run(arguments.cases, arguments.seed, arguments.only)
    failures = sum(row["failures"] for row in rows)
    cases = sum(row["cases"] for row in rows)
    print(f"{cases} cases, {failures} failures, {time.perf_counter() - began:.0f} s")
    if arguments.table:
        arguments.table.write_text(json.dumps(rows, indent=1) + "\n", encoding="utf-8")
    if arguments.out:
        commit, _, file = arguments.beside.partition("=")
        other = json.loads(Path(file).read_text(encoding="utf-8")) if file else []
        how = f"python tests/fuzz/run.py --cases {arguments.cases} --seed {arguments.seed}"
        beside = {"commit": commit, "families": other} if other else {}
        figures = {"cases": cases, "seed": arguments.seed, "failures": failures, "families": rows, "beside": beside}
        write_document(arguments.out, how, **figures)
    return int(failures > 0)


if __name__ == "__main__":
    sys.exit(main())
