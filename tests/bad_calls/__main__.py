"""Every bad use and what it ends in: `python tests/bad_calls`, `--all` for each text, `--area NAME` for one table."""

import argparse
import sys
import warnings
from collections import Counter

import jax
from table import judge, tables


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--area", help="this table alone")
    parser.add_argument("--all", action="store_true", help="print the text of each")
    arguments = parser.parse_args()
    jax.config.update("jax_enable_x64", True)
    warnings.simplefilter("ignore")
    total: Counter[str] = Counter()
    for area, rows in tables().items():
        if arguments.area not in (None, area):
            continue
        found = [(row.name, judge(row)) for row in rows]
        counts = Counter(verdict.kind for _, verdict in found)
        total += counts
        print(f"{area:<14}{len(rows):>4} uses, {', '.join(f'{n} {kind}' for kind, n in sorted(counts.items()))}")
        for name, verdict in found:
            if arguments.all or verdict.kind != "ours":
                print(f"  {verdict.kind:<8}{name}: {verdict.text}")
    wrong = total.total() - total["ours"]
    print(f"{'all':<14}{total.total():>4} uses, {total['ours'] / total.total():.1%} ours, {total['silent']} silent")
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(main())
