"""The cache of machine code on disk, with a file for each kernel, which only this user may write."""

from __future__ import annotations

import contextlib
import hashlib
import os
import stat
import sys
import tempfile
from pathlib import Path

from ..progress import say_once

#: The environment variable with the directory, or "off". Read for each kernel.
_VARIABLE = "TWISTAX_CACHE"

#: The largest size of all files together, bytes. The Panda's step takes 0.1 MB, its Jacobian 0.7 MB.
_MOST = 2**28

#: The prefix of the names of all files. Other files in the directory are left alone.
_NAME = "kernel_"

#: The length of the checksum at the start of each file, bytes.
_SUM = hashlib.sha256().digest_size


def version() -> str:
    """`twistax.__version__`, from the loaded package, which this layer must not import."""
    return str(sys.modules[__name__.partition(".")[0]].__version__)


def kept(key: str) -> bytes | None:
    """The machine code of a key; None if there is no file, or one that others may have written."""
    folder = _folder()
    if folder is None:
        return None
    try:
        _check_owner(os.stat(folder), f"the directory {folder}")
        with open(folder / (_NAME + key), "rb", opener=_opened) as file:
            _check_owner(os.fstat(file.fileno()), f"a file in {folder}")
            content = file.read()
            with contextlib.suppress(OSError):  # read-only files are never dropped
                os.utime(file.fileno())  # the least recently read files are dropped first
    except FileNotFoundError:
        return None
    except OSError as error:
        _say(folder, error)
        return None
    code = content[_SUM:]
    return code if content[:_SUM] == _checksum(key, code) else None


def keep(key: str, code: bytes) -> None:
    """Write machine code under a key, atomically, also with several concurrent processes."""
    folder = _folder()
    if folder is None:
        return
    try:
        folder.mkdir(0o700, parents=True, exist_ok=True)
        _check_owner(os.stat(folder), f"the directory {folder}")
        handle, part = tempfile.mkstemp(prefix=_NAME, suffix=".part", dir=folder)
        try:
            with open(handle, "wb") as file:
                file.write(_checksum(key, code) + code)
            os.replace(part, folder / (_NAME + key))
        except BaseException:
            with contextlib.suppress(FileNotFoundError):
                os.unlink(part)
            raise
        _drop_oldest(folder)
    except OSError as error:
        _say(folder, error)


def _folder() -> Path | None:
    """The folder of the files; None if there is none, or if its owner cannot be determined."""
    named, usual = os.environ.get(_VARIABLE, ""), os.environ.get("XDG_CACHE_HOME", "")
    if named.lower() == "off" or not hasattr(os, "getuid"):
        return None
    if named:
        return Path(os.path.expanduser(named)).absolute()  # shells leave "~" within quotes
    # By its specification relative paths are ignored; so is a home directory that the system does not know.
    usual = usual if os.path.isabs(usual) else os.path.expanduser("~/.cache")
    return Path(usual, "twistax") if os.path.isabs(usual) else None


def _opened(path: str, flags: int) -> int:
    return os.open(path, flags | os.O_NOFOLLOW)


def _check_owner(status: os.stat_result, what: str) -> None:
    """Refuse files that other users could have written.

    Raises:
        PermissionError: it is another user's, or others may write to it.
    """
    if status.st_uid != os.getuid():
        raise PermissionError(None, f"{what} belongs to another user")
    if status.st_mode & (stat.S_IWGRP | stat.S_IWOTH):
        raise PermissionError(None, f"other users may write to {what} (fix: chmod go-w)")


def _checksum(key: str, code: bytes) -> bytes:
    """A checksum of content and key, so that a renamed file is refused."""
    return hashlib.sha256(key.encode() + b"\0" + code).digest()


def _drop_oldest(folder: Path) -> None:
    """Delete the oldest files beyond the limit."""
    files = []
    for entry in os.scandir(folder):
        if entry.name.startswith(_NAME):
            with contextlib.suppress(FileNotFoundError):
                status = entry.stat(follow_symlinks=False)
                files.append((status.st_mtime_ns, status.st_size, entry.path))
    total = sum(size for _, size, _ in files)
    for _, size, path in sorted(files):
        if total <= _MOST:
            return
        with contextlib.suppress(FileNotFoundError):
            os.unlink(path)
        total -= size


def _say(folder: Path, error: OSError) -> None:
    say_once(
        f"kernels are compiled anew: {error.strerror or error} ({folder}).\n"
        f"  fix: let the environment variable {_VARIABLE} name another directory, or be 'off'"
    )
