"""Random expressions on every path to a number, against NumPy.

    python tests/fuzz --seconds 60 --seed 0
    python tests/fuzz --seconds 60 --seed 0 --magnitudes   # in single precision, from 1e-9 to 1e15, with derivatives

A case that is wrong is shrunk and printed as a script. The exit status is 1 if there was one. Seconds are processor
time of all threads, so that a busy machine looks at as much as a quiet one.
"""

import argparse
import gc
import sys
import time
import warnings

import jax
import magnitudes
import outside
from check import check
from grow import drawn
from paths import BACKENDS
from shrink import smallest

#: Programs that JAX keeps are dropped after so many cases.
KEPT = 40


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seconds", type=float, default=60.0, help="how long to look, in processor time")
    parser.add_argument("--seed", type=int, default=0, help="another one draws other cases")
    parser.add_argument("--first", type=int, default=0, help="begin with this case: a long run in parts")
    parser.add_argument("--case", type=int, help="this case of the seed alone")
    parser.add_argument("--most", type=int, default=20, help="stop after so many wrong cases")
    parser.add_argument("--magnitudes", action="store_true", help="derivatives in single precision")
    parser.add_argument("--unshrunk", action="store_true", help="print wrong cases as they were drawn")
    arguments = parser.parse_args()
    jax.config.update("jax_enable_x64", True)
    jax.config.update("jax_traceback_in_locations_limit", 0)  # where operations were written nobody reads
    warnings.simplefilter("ignore")
    begin = time.process_time()
    first = arguments.first if arguments.case is None else arguments.case
    if arguments.magnitudes:
        return at_magnitudes(arguments.seed, first, begin + arguments.seconds)
    end, number, found, terms, shown = begin + arguments.seconds, first, 0, 0, 0.0
    while time.process_time() < end and found < arguments.most:
        case = drawn(arguments.seed, number)
        if wrong := check(case):
            found += 1
            after = time.process_time() - begin
            small, said = (case, wrong) if arguments.unshrunk else smallest(case, check, wrong)
            print(
                f"\n# case {number} of seed {arguments.seed}, after {after:.0f} s: {said}\n{small.as_code()}",
                flush=True,
            )
        number, terms = number + 1, terms + len(case.terms)
        if number % KEPT == 0:
            jax.clear_caches()
            gc.collect()
        if sys.stderr.isatty() and time.process_time() > shown + 1.0:
            shown = time.process_time()
            print(
                f"\r{number - first} cases, {found} wrong, {max(0.0, end - shown):.0f} s left ", end="", file=sys.stderr
            )
        if arguments.case is not None:
            break
    print(f"cases {first} to {number - 1}, {terms} terms of seed {arguments.seed}, {found} wrong")
    return 1 if found else 0


def at_magnitudes(seed: int, number: int, end: float) -> int:
    """Each case by one backend or way out of JAX, in turn."""
    first, found = number, 0
    while time.process_time() < end:
        state, parts = magnitudes.drawn(seed, number)
        turns = [*BACKENDS, *outside.WAYS]
        by = turns[number % len(turns)]
        if said := (magnitudes if by in BACKENDS else outside).wrong(state, parts, by):
            found += 1
            print(f"\n# case {number} of seed {seed}, z = {state.tolist()}\n{said}", flush=True)
        number += 1
        if number % KEPT == 0:
            jax.clear_caches()
    print(f"cases {first} to {number - 1} of seed {seed}, {found} wrong")
    return 1 if found else 0


if __name__ == "__main__":
    sys.exit(main())
