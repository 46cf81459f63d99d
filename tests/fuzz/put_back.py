"""Silent errors of one place, put into a copy of the tree one at a time: the fuzzer must find each.

    python tests/fuzz/put_back.py [--seconds N] [--seed S] [--only NAME ...] [--list]

The table says after how many seconds of processor time, and by which case, which is right without the error. What is
about calls that are refused is not here: bad calls have tests of their own. The exit status is 0 if each error was
found.
"""

import argparse
import os
import re
import subprocess
import sys
import tempfile
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))
from mutations import ROOT, copy_to

#: XLA optimises nothing: it takes half of the time, and the errors are none of its own.
QUICK = (
    "--xla_backend_optimization_level=0 --xla_llvm_disable_expensive_passes=true "
    "--xla_cpu_parallel_codegen_split_count=1"
)

ADJUGATE = """n = A.shape[-1]
    if n == 3:
        rows = [A[..., i, :] for i in range(3)]
        sides = jnp.stack([jnp.cross(rows[i - 2], rows[i - 1]) for i in range(3)], axis=-1)
        return sides @ b / jnp.sum(rows[0] * sides[..., 0], axis=-1)[..., None, None]"""

#: Name, text that stands in one file of the package and there once, what stands there instead.
TABLE = [
    ("3x3 by the adjugate", "n = A.shape[-1]\n    left", f"{ADJUGATE}\n    left"),
    (
        "integers wrap without x64",
        "array = real_array(place, value)\n        if array.shape != known[name].shape:",
        "array = real_array(place, value if is_traced(value) else np.asarray(jnp.asarray(np.asarray(value))))\n"
        "        if array.shape != known[name].shape:",
    ),
    (
        "index of mixed kinds through Stack",
        "isinstance(first, int) and not lists",
        "isinstance(first, int)",
    ),
    ("long arrays have one key", "_digest(array.tobytes())", "str(array)"),
    (
        "update function of a scatter",
        'p["update_jaxpr"] is None and _scattered(p)',
        "_scattered(p)",
    ),
    ("take beyond the end", 'p["mode"] == _FILL and not', 'p["mode"] is None and not'),
    ("scatter beyond the end", 'eqn.params["mode"] != _CLIP', "True"),
    (
        "baked numbers are rounded",
        "Constant(known[name].replace(value=value).value)",
        'Constant(known[name].replace(value=value).value.astype("float32"))',
    ),
    (
        "constants are float32 under x64",
        "jax.numpy.asarray(self.value, bool if self.value.dtype == bool else inputs.dtype)",
        "jax.numpy.asarray(self.value, bool if self.value.dtype == bool else np.float32).astype(inputs.dtype)",
    ),
    (
        "x <= y as x - y <= 0",
        "function = operator.le",
        "function = lambda a, b: a - b <= 0.0  # noqa: E731",
    ),
    (
        "scalars merged whose arguments differ",
        "return self._intern((operation, *arguments), dtype)",
        "own = self._intern((operation, *arguments), dtype)\n"
        '        like = operation.name == "tanh" and self.nodes[arguments[0]][0] is _MUL\n'
        '        return self._known.setdefault(("tanh", self.nodes[arguments[0]][:2]), own) if like else own',
    ),
    (
        "np.dot of stacks",
        'if a.ndim > 2 or b.ndim > 2:\n        raise OperationError("np.dot',
        'if a.ndim > 9 or b.ndim > 9:\n        raise OperationError("np.dot',
    ),
    (
        "np.fmax is Max",
        "if name in _NEAR:",
        'if name == "fmax":\n        return getattr(_nodes(), "Max")\n    if name in _NEAR:',
    ),
    (
        "np.hypot overflows",
        "if name in _NEAR:",
        'if name == "hypot":\n        return lambda x, y: (x * x + y * y) ** 0.5\n    if name in _NEAR:',
    ),
    (
        "SmoothReLU overflows",
        "jax.lax.stop_gradient(jnp.maximum(0.25 * part, 0.25 * self.c))",
        "jnp.ones_like(part)",
    ),
    (
        "order of what ad* becomes",
        "halves(self.momentum, self.order)\n        return",
        "halves(self.momentum, LINEAR_FIRST)\n        return",
    ),
    (
        "order of what nodes of twists give",
        "return self._swapped(type(self).function(*map(self._swapped, values)))",
        "return type(self).function(*map(self._swapped, values))",
    ),
    (
        "derivative of the Stumpff functions",
        "0.5 * (k * stumpff(k + 2, x) - stumpff(k + 1, x)) * dx",
        "0.5 * (k * stumpff(k + 2, x) + stumpff(k + 1, x)) * dx",
    ),
    (
        "derivative of atan2 in scalars",
        "return [g.mul(a[1], inverse), g.neg(g.mul(a[0], inverse))]",
        "return [g.mul(a[1], inverse), g.mul(a[0], inverse)]",
    ),
    (
        "gradient of ties",
        'g.select(on(g, "eq", *a), g.constant(0.5), g.zero)',
        "g.zero",
    ),
    ("axis of Vmap", "in_axes = (*[self.axis] * count", "in_axes = (*[0] * count"),
    (
        "batches along another axis",
        "in unbatched else batching.bdim_at_front(a, d, size)",
        "in unbatched else batching.bdim_at_front(a, None if d is None else 0, size)",
    ),
    (
        "integers are rounded",
        "(self.vector(kind), x))\n        if target in",
        '(self.vector(kind), self.intrinsic("rint", kind, x)))\n        if target in',
    ),
    (
        "NaN is lost by max in kernels",
        'self.instruction("fcmp uno", kind, a, a), a, first)',
        'self.instruction("fcmp uno", kind, b, b), a, first)',
    ),
    (
        "pivots of LU",
        'better = on(g, "gt", size, best)',
        'better = on(g, "gt", best, size)',
    ),
]


def fuzzed(tree: Path, *options: str) -> str:
    """What the fuzzer says of a tree: its first wrong case; empty if it finds none."""
    command = [sys.executable, "tests/fuzz", "--most", "1", "--unshrunk", *options]
    own = {"PYTHONPATH": str(tree / "src"), "JAX_PLATFORMS": "cpu", "XLA_FLAGS": QUICK}
    run = subprocess.run(command, cwd=tree, env=os.environ | own, capture_output=True, text=True)
    said = re.search(r"^# (case .*)$", run.stdout, re.MULTILINE)
    if run.returncode not in (0, 1) or (run.returncode == 1 and said is None):
        raise RuntimeError(f"{tree}: {run.stdout[-1000:]}{run.stderr[-2000:]}")
    return said[1] if said else ""


def located(old: str) -> Path:
    """The one file of the package that has this text, relative to the root."""
    files = [file for file in sorted((ROOT / "src").rglob("*.py")) for _ in range(file.read_text().count(old))]
    if len(files) != 1:
        raise ValueError(f"{old!r} stands {len(files)} times in the package, not once; mend the entry")
    return files[0].relative_to(ROOT)


def detected(old: str, new: str, seconds: float, seed: int) -> str:
    """What the fuzzer says of a tree with the error. The case must be right without it."""
    with tempfile.TemporaryDirectory(prefix="put_back_") as folder:
        tree = copy_to(folder, ("src", "tests"))
        path = tree / located(old)
        text = path.read_text()
        path.write_text(text.replace(old, new))
        said = fuzzed(tree, "--seconds", str(seconds), "--seed", str(seed))
        path.write_text(text)
        if said and (own := fuzzed(tree, "--seed", str(seed), "--case", said.split()[1])):
            raise RuntimeError(f"wrong without any error put back: {own}")
    return said


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seconds", type=float, default=600.0, help="how long to look for each, in processor time")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--only", nargs="+", help="names of errors")
    parser.add_argument("--list", action="store_true", help="check that each error can be made, and run nothing")
    arguments = parser.parse_args()
    chosen = [row for row in TABLE if not arguments.only or row[0] in arguments.only]
    for _, old, _ in chosen:
        located(old)
    missed = 0
    for name, old, new in [] if arguments.list else chosen:
        said = detected(old, new, arguments.seconds, arguments.seed)
        missed += not said
        print(f"{name:40}  {said[:120] or 'NOT FOUND'}", flush=True)
    print(f"{len(chosen) - missed} of {len(chosen)} errors {'can be made' if arguments.list else 'are found'}")
    return 1 if missed else 0


if __name__ == "__main__":
    sys.exit(main())
