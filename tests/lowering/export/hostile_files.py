"""Saved files with errors put in, and a process of little memory and time that loads them.

    python tests/lowering/export/hostile_files.py FIRST COUNT

prints a line for each file that neither loads nor ends in an error of this package, that imports what is foreign, or
that takes long. The exit status is 0 where there is none.
"""

import copy
import io
import json
import random
import resource
import signal
import sys
import tempfile
import time
import warnings
import zipfile
from pathlib import Path
from typing import Any

#: What is put in the place of a number, a text, a list or a dict.
NUMBERS = [3_000_000_000, -1, 0, 2**31, 2**63, 10**400, -3_000_000_000, 1e308, 2.5, True, 70_000]
TEXTS = ["", "x", "os:system", "this:s", "antigravity:x", "twistax.__main__:main", "twistax.demo:x", "twistax:lie.so3",
         "scipy:stats.norm", "twistax.report.command:main", "builtins:eval", "numpy:ndarray", "<i4", "O", "nan",
         "a" * 100_000, "\x00", "twistax.expr.node:Expr", "twistax.expr.leaves:State"]  # fmt: skip
OTHERS: list[Any] = [None, [], {}, [[]], {"node": 3_000_000_000}, {"array": -1}, {"number": ["<i4", 3_000_000_000]},
          {"number": ["O", 1]}, {"float": "1e999"}, {"float": "x"}, {"slice": [0, 3_000_000_000, 1]},
          {"tuple": [3_000_000_000]}, {"list": [0] * 1000}, {"value": ["os:system", {}]}, {"tuple": [100_000, 100_000]},
          {"value": ["twistax.groups.group:Euclidean", {"shape": {"tuple": [3_000_000_000]}}]}]  # fmt: skip
#: Bytes of memory beyond what the process has, and seconds for one file.
MEMORY, TIME = 1_500_000_000, 20


def systems() -> list[Any]:
    """Compiled systems that have every kind of value in their files."""
    import numpy as np

    import twistax as tx
    from twistax.mechanics import environment

    g = tx.State("g", group=tx.SE3, order=tx.ANGULAR_FIRST, initial=np.eye(4), scale=2.0)
    w = tx.State("w", shape=(6,), min=-3.0, max=[1.0, 2.0, 3.0, 4.0, 5.0, np.inf], guess=np.linspace(0.0, 1.0, 6))
    u, k = tx.Control("u", shape=(3,), min=-1.0), tx.Parameter("k", value=1.0 / 3.0)
    J = tx.Parameter("J", shape=(3, 3))
    rate = tx.Concat(J @ w[:3] * k - tx.linalg.Cross(u, w[3:]), tx.Where(tx.Time() >= 1.0, w[:3], -w[3:]))
    table = tx.Interp(w[0], axes=[0.0, 1.0, 3.0, 4.0], values=[1.0, -1.0, 2.0, 2.5], kind=tx.tables.BSpline())
    air = environment.atmosphere.US1976.density(environment.earth.WGS84.geodetic(g[:3, 3]).altitude)
    whole = tx.System(
        rates={w: rate, g: w},
        outputs={"table": table, "air": air, "all": tx.Vmap(lambda p: p @ w[:3], batch=np.eye(3) * k)},
        constraints={"box": u <= 3.0, "level": g[2, 3] == 1.0},
        controls=[u],
        parameters=[J, k],
    )
    x = tx.State("x", shape=(2,))
    small = tx.System(rates={x: tx.Sin(x) * [1.0, 2.0]})
    return [tx.compile(whole, bake={"J": np.diag([0.1, 0.2, 0.7])}, backend=tx.XLA(least=7)), tx.compile(small)]


def places(value: Any, path: tuple[Any, ...] = ()) -> list[tuple[Any, ...]]:
    """Where something stands in the JSON."""
    found = [path] if path else []
    entries = value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else ()
    for key, entry in entries:
        found += places(entry, (*path, key))
    return found


def mutated(content: Any, rng: random.Random) -> Any:
    """A copy with one to three places changed."""
    content = copy.deepcopy(content)
    for _ in range(rng.choice([1, 1, 1, 2, 3])):
        *way, last = rng.choice(places(content))
        inside = content
        for key in way:
            inside = inside[key]
        old, kind = inside[last], rng.random()
        if kind < 0.1:
            del inside[last]
        elif kind < 0.2 and isinstance(inside, list):
            inside.append(copy.deepcopy(old))
        elif isinstance(old, str):
            inside[last] = rng.choice(TEXTS)
        elif isinstance(old, (int, float)) and kind < 0.8:
            inside[last] = rng.choice(NUMBERS)
        else:
            inside[last] = copy.deepcopy(rng.choice([*OTHERS, *NUMBERS]))
    return content


def spoiled(data: bytes, rng: random.Random) -> bytes:
    """Some bytes changed, or a part left out."""
    some = bytearray(data)
    for _ in range(rng.choice([1, 2, 8])):
        some[rng.randrange(len(some))] = rng.randrange(256)
    if rng.random() < 0.3:
        a, b = sorted(rng.randrange(len(some)) for _ in range(2))
        del some[a:b]
    return bytes(some)


def headed(data: bytes, rng: random.Random) -> bytes:
    """An array whose header promises something else."""
    import numpy as np

    header = io.BytesIO()
    shape = rng.choice([(3_000_000_000,), (10**6, 10**6), (2,) * 40, (-1,), (0,), (2**62, 4), (10**15,)])
    descr = rng.choice(["<f8", "<f4", "|b1", "|O", "<U900000000", [("a", "<f8", (10**9,))], "<c16"])
    np.lib.format.write_array_header_2_0(header, {"descr": descr, "fortran_order": rng.random() < 0.5, "shape": shape})
    return header.getvalue() + data[-rng.choice([0, 8, 64]) :]


def written(members: dict[str, bytes], said: int | None = None) -> bytes:
    """The archive; `said` is the size that it gives for its first member."""
    buffer = io.BytesIO()
    with warnings.catch_warnings(), zipfile.ZipFile(buffer, "w", zipfile.ZIP_DEFLATED) as archive:
        warnings.simplefilter("ignore")
        for name, data in members.items():
            archive.writestr(name, data)
        if said is not None:
            archive.infolist()[0].file_size = said
    return buffer.getvalue()


def hostile(members: dict[str, bytes], rng: random.Random) -> bytes:
    """One file with errors."""
    kind = rng.random()
    if kind < 0.75:
        content = json.loads(members["system.json"])
        return written({**members, "system.json": json.dumps(mutated(content, rng)).encode()})
    if kind < 0.85:
        return spoiled(written(members), rng)
    if kind < 0.87:
        return written({**members, "system.json": b"[" * 100_000})
    if kind < 0.88:
        return written(members, said=3_000_000_000)
    name = rng.choice([each for each in members if each.endswith(".npy")])
    return written({**members, name: rng.choice([headed, spoiled])(members[name], rng)})


def ours(name: str) -> bool:
    return name.partition(".")[0] == "twistax"


def main(first: int, count: int) -> int:
    import twistax as tx

    folder, wrong = Path(tempfile.mkdtemp()), 0
    files = []
    for k, dynamics in enumerate(systems()):
        dynamics.save(folder / f"{k}")
        with zipfile.ZipFile(folder / f"{k}") as archive:
            files.append({name: archive.read(name) for name in archive.namelist()})
        tx.load(folder / f"{k}")
    size = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
    resource.setrlimit(resource.RLIMIT_AS, (size + MEMORY, resource.RLIM_INFINITY))

    def stop(*_: Any) -> None:
        raise SystemExit("this takes too long")

    signal.signal(signal.SIGALRM, stop)
    for seed in range(first, first + count):
        rng = random.Random(seed)
        data = hostile(rng.choice(files), rng)
        (folder / "hostile").write_bytes(data)
        before, start, came = set(sys.modules), time.perf_counter(), "loads"
        signal.alarm(TIME)
        try:
            tx.load(folder / "hostile")
        except tx.TwistaxError as error:
            came = f"{type(error).__name__}: {str(error)[:70]!r}"
            bad = "for the available memory" in str(error)
        except BaseException as error:
            came, bad = f"{type(error).__name__}: {str(error)[:200]!r}", True
        else:
            bad = False
        signal.alarm(0)
        took = time.perf_counter() - start
        new = sorted(set(sys.modules) - before)
        foreign = [name for name in new if not ours(name)] if not any(ours(name) for name in new) else []
        named = [name for name in new if name.endswith("__main__") or ".demo" in name or ".report" in name]
        if bad or foreign or named or took > 5.0:
            wrong += 1
            print(f"{seed}: {came}, {took:.1f} s, imports {foreign or named}", flush=True)
    return wrong


if __name__ == "__main__":
    raise SystemExit(min(main(*map(int, sys.argv[1:3])), 1))
