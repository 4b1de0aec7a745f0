"""Run the fuzz of the file readers, and write its table: python tests/fuzz/run.py [--cases N] [--seed S] [-o FILE].

Every number of a case is stated: case k of family f has the generator `numpy.random.default_rng([seed, f, k])`. To try
another version of the package, put its sources first on PYTHONPATH.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from pathlib import Path
from tempfile import TemporaryDirectory

ROOT = Path(__file__).resolve().parents[2]
sys.path[:0] = [str(ROOT / "tests"), str(ROOT / "benchmarks")]

from support.fuzz_files import families, run_cases, summarize  # noqa: E402 the paths come first


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--cases", type=int, default=3000)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--only", default="", help="run families whose name holds this")
    parser.add_argument("-o", "--out", type=Path, help="JSON of the table")
    arguments = parser.parse_args()
    began = time.perf_counter()
    with TemporaryDirectory() as folder:
        chosen = [family for family in families(Path(folder) / "healthy") if arguments.only in family.name]
        rows = summarize(run_cases(chosen, arguments.cases, arguments.seed, Path(folder)), chosen)
    for row in rows:
        print(f"{row['point']:3} {row['family']:22} {row['cases']:5} cases: {row['read']:5} read, "
              f"{row['refused']:5} refused, {row['failures']:4} failures; {row['longest_s']:6.1f} s, "
              f"{row['largest_mb']:5} MB {row['kinds'] or ''}")  # fmt: skip
        for example in row["examples"]:
            print("     ", example)
    failures = sum(row["failures"] for row in rows)
    seconds = time.perf_counter() - began
    print(f"{sum(row['cases'] for row in rows)} cases, {failures} failures, {seconds:.0f} s")
    if arguments.out:
        figures = {"cases": sum(row["cases"] for row in rows), "seed": arguments.seed, "failures": failures}
        arguments.out.write_text(json.dumps({**figures, "seconds": round(seconds), "families": rows}, indent=1) + "\n")
    return failures > 0


if __name__ == "__main__":
    sys.exit(main())
