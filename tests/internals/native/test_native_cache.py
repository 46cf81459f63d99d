"""Machine code on disk: what is read again, what is never run, and what happens where nothing can be kept."""

from __future__ import annotations

import gc
import os
import subprocess
import sys
import threading
import time
import warnings
from collections.abc import Callable, Iterator
from pathlib import Path

import jax
import numpy as np
import pytest

pytest.importorskip("llvmlite", reason="native kernels need llvmlite")
if not hasattr(os, "getuid"):
    pytest.skip("nothing is kept where files have no owners", allow_module_level=True)

from twistax import progress
from twistax.scalar import kernel_cache as cache
from twistax.scalar.primitives.table import OPERATIONS
from twistax.scalar.reader import scalarize
from twistax.scalar.targets.llvm import kernel, self_test
from twistax.scalar.targets.llvm.kernel import HostKernel
from twistax.scalar.targets.llvm.kernel_body import native_form
from twistax.scalar.targets.llvm.machine_code import BuildError, Processor
from twistax.scalar.targets.llvm.self_test import check_kernel
from twistax.scalar.targets.llvm.straight.body import Straight

KEY, CODE = "0" * 64, bytes(range(256)) * 20
POINTS = np.random.default_rng(0).normal(size=(9, 3))


@pytest.fixture(autouse=True)
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """An empty cache; no message was given yet. Objects of earlier tests are not looked through for what is garbage."""
    gc.freeze()
    # Handlers are made 64 at a time. The files here are kernels alone.
    while len(kernel._FREE) < 4:
        _used(float(np.random.default_rng().random()))
    monkeypatch.setattr(progress, "_SAID", set())
    monkeypatch.setattr(self_test, "_CALLED", {"cpu"})
    found = tmp_path / "cache"
    monkeypatch.setenv("TWISTAX_CACHE", str(found))
    yield found
    gc.unfreeze()


@pytest.fixture
def compilations(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """The texts that were compiled."""
    texts: list[str] = []
    compiled = kernel.compiled
    monkeypatch.setattr(kernel, "compiled", lambda text, *a: texts.append(text) or compiled(text, *a))
    return texts


def _used(factor: float) -> np.ndarray:
    """A kernel made, checked, run, and let go."""
    shape = jax.ShapeDtypeStruct((3,), float)
    form = native_form(scalarize(lambda x: [factor * x * x + x], shape))
    processor = Processor.host()
    body = Straight(form, processor.lanes(form.graph.dtype))
    own = HostKernel(body, processor)
    if not own.handle.checked:
        check_kernel(own)
    (found,) = own.run([POINTS])
    np.testing.assert_allclose(found, factor * POINTS**2 + POINTS, rtol=1e-14, atol=1e-15)  # they may cancel
    del own
    gc.collect()
    return found


def _entries(folder: Path) -> list[Path]:
    return sorted(folder.iterdir())


# ---- what is read again ----------------------------------------------------------------------------------------------


def test_a_kernel_is_compiled_and_checked_once(
    folder: Path, compilations: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    first = _used(2.0)
    assert len(compilations) == len(_entries(folder)) == 1
    monkeypatch.setattr(Straight, "plain", lambda *a: pytest.fail("checked again"))
    np.testing.assert_array_equal(_used(2.0), first)
    assert len(compilations) == 1


@pytest.mark.parametrize("what", ["program", "processor", "twistax", "JAX", "jaxlib", "llvmlite"])
def test_a_key_says_what_code_depends_on(
    what: str, compilations: list[str], folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    import jaxlib
    import llvmlite

    _used(3.0)
    factor = 3.0
    if what == "program":
        factor = np.nextafter(3.0, 4.0)
    elif what == "processor":
        narrow = Processor.host(128)
        monkeypatch.setattr(Processor, "host", lambda: narrow)
    elif what == "twistax":
        monkeypatch.setattr(kernel, "version", lambda: "9.9")
    else:
        monkeypatch.setattr({"JAX": jax, "jaxlib": jaxlib, "llvmlite": llvmlite}[what], "__version__", "9.9")
    _used(float(factor))
    assert len(compilations) == len(_entries(folder)) == 2


def test_a_kernel_that_is_wrong_is_not_kept(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(vars(OPERATIONS["mul"]), "llvm", OPERATIONS["add"].llvm)
    for _ in range(2):
        with pytest.raises(BuildError, match="differ"):
            _used(5.0)
    assert not folder.exists()


# ---- what is never run -----------------------------------------------------------------------------------------------


@pytest.mark.parametrize("damage", ["a bit", "half", "the sum alone", "nothing", "more", "another's"])
def test_damaged_files_are_compiled_anew(damage: str, folder: Path, compilations: list[str]) -> None:
    _used(7.0)
    (entry,) = _entries(folder)
    content = entry.read_bytes()
    if damage == "another's":
        _used(8.0)
        (other,) = set(_entries(folder)) - {entry}
        entry.write_bytes(other.read_bytes())
    else:
        flipped = bytearray(content)
        flipped[len(content) // 2] ^= 4
        parts = {"a bit": bytes(flipped), "half": content[: len(content) // 2], "the sum alone": content[:32]}
        entry.write_bytes({**parts, "nothing": b"", "more": content + b"\0"}[damage])
    before = len(compilations)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        _used(7.0)
    assert len(compilations) == before + 1
    assert entry.read_bytes() == content


def _told(function: Callable[[], object], words: str) -> None:
    """One message, with these words and the setting, however often it is called."""
    with warnings.catch_warnings(record=True) as messages:
        warnings.simplefilter("always")
        for _ in range(3):
            function()
    (message,) = [str(m.message) for m in messages]
    assert words in message
    assert "TWISTAX_CACHE" in message


def _not_read(words: str) -> None:
    def read() -> None:
        assert cache.kept(KEY) is None

    _told(read, words)


def test_another_users_files_are_not_run(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    cache.keep(KEY, CODE)
    mine = os.getuid()
    monkeypatch.setattr(cache.os, "getuid", lambda: mine + 1)
    _not_read("belongs to another user")


@pytest.mark.parametrize("mode", [0o620, 0o602])
def test_files_that_others_may_write_are_not_run(mode: int, folder: Path) -> None:
    cache.keep(KEY, CODE)
    (entry,) = _entries(folder)
    entry.chmod(mode)
    _not_read("other users may write")
    cache.keep(KEY, CODE)  # the mended one
    assert cache.kept(KEY) == CODE


@pytest.mark.parametrize("mode", [0o720, 0o702])
def test_a_folder_that_others_may_write_is_not_used(mode: int, folder: Path) -> None:
    cache.keep(KEY, CODE)
    folder.chmod(mode)
    _not_read(f"other users may write to the directory {folder} (fix: chmod go-w)")


def test_links_are_not_followed(folder: Path, tmp_path: Path) -> None:
    cache.keep(KEY, CODE)
    (entry,) = _entries(folder)
    entry.rename(tmp_path / "elsewhere")
    entry.symlink_to(tmp_path / "elsewhere")
    _not_read("link")


def test_what_is_written_is_the_users_alone(folder: Path) -> None:
    before = os.umask(0)
    try:
        cache.keep(KEY, CODE)
    finally:
        os.umask(before)
    (entry,) = _entries(folder)
    assert [own.stat().st_mode & 0o777 for own in (folder, entry)] == [0o700, 0o600]


# ---- where nothing can be kept ---------------------------------------------------------------------------------------


def test_off(folder: Path, monkeypatch: pytest.MonkeyPatch, compilations: list[str]) -> None:
    _used(9.0)
    monkeypatch.setenv("TWISTAX_CACHE", "off")
    _used(9.0)
    _used(10.0)
    assert len(compilations) == 3
    assert len(_entries(folder)) == 1
    assert not Path("off").exists()


def test_a_place_that_cannot_be_written(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "file").touch()
    monkeypatch.setenv("TWISTAX_CACHE", str(tmp_path / "file" / "below"))
    _told(lambda: [_used(factor) for factor in (11.0, 12.0)], "Not a directory")


def test_a_disk_that_is_full(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(*_: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(cache.os, "replace", full)
    _told(lambda: [_used(factor) for factor in (13.0, 14.0)], "No space left")
    assert _entries(folder) == []


# ---- where it is, and how large --------------------------------------------------------------------------------------


def test_the_usual_places(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("HOME", str(tmp_path / "home"))
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "xdg"))
    for unset, expected in (
        ("", tmp_path / "cache"),
        ("TWISTAX_CACHE", tmp_path / "xdg/twistax"),
        ("XDG_CACHE_HOME", tmp_path / "home/.cache/twistax"),
    ):
        monkeypatch.delenv(unset, raising=False)
        cache.keep(KEY, CODE)
        assert len(_entries(expected)) == 1
    monkeypatch.setenv("TWISTAX_CACHE", "~/own")
    cache.keep(KEY, CODE)
    assert len(_entries(tmp_path / "home/own")) == 1
    monkeypatch.delenv("TWISTAX_CACHE")
    monkeypatch.setenv("XDG_CACHE_HOME", "relative")
    assert cache.kept(KEY) == CODE
    assert not Path("relative").exists()


def test_the_oldest_go(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Those that were not read for longest, down to the bound, and nothing but kernels."""
    keys = [str(k) * 64 for k in range(5)]
    folder.mkdir(0o700)
    (folder / "notes.txt").write_bytes(bytes(10 * len(CODE)))
    for k, key in enumerate(keys[:4]):
        cache.keep(key, CODE)
        for entry in (e for e in _entries(folder) if e.name.endswith(key)):
            os.utime(entry, (1e9 + k, 1e9 + k))
    assert cache.kept(keys[0]) == CODE
    monkeypatch.setattr(cache, "_MOST", 3 * (len(CODE) + 32))
    cache.keep(keys[4], CODE)
    assert [key for key in keys if cache.kept(key) == CODE] == [keys[0], keys[3], keys[4]]
    assert (folder / "notes.txt").exists()


_MANY = """
import sys, time
from twistax.scalar import kernel_cache as cache
key, end = "0" * 64, float(sys.argv[1])
code = bytes(range(256)) * 8000
while time.time() < end:
    cache.keep(key, code)
    assert cache.kept(key) == code
"""


def test_many_at_once(folder: Path) -> None:
    """Threads and processes that write the same file: once it is there each reader finds it whole."""
    end, code, wrong = time.time() + 2.5, bytes(range(256)) * 8000, 0

    def run() -> None:
        nonlocal wrong
        while time.time() < end:
            cache.keep(KEY, code)
            wrong += cache.kept(KEY) != code

    processes = [subprocess.Popen([sys.executable, "-c", _MANY, str(end)]) for _ in range(2)]
    threads = [threading.Thread(target=run) for _ in range(3)]
    for each in threads:
        each.start()
    for each in threads:
        each.join()
    assert [each.wait() for each in processes] == [0, 0]
    assert wrong == 0
    assert len(_entries(folder)) == 1
