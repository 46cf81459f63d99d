"""A scene as a video: frames from a headless browser, joined by ffmpeg."""

from __future__ import annotations

import contextlib
import shutil
import subprocess
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from ..checks import short
from ..errors import InputError, ModelError
from ..progress import watching
from .animation import RATE, Animation
from .stage import Stage, silent_server

BROWSERS = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable", "chrome")
#: How long a browser may take to begin, and to draw a picture, s.
_BEGIN, _PICTURE = 60.0, 60.0
#: The most pictures that are drawn before the first one of a film.
_SETTLING = 10


@watching("video")
def film(scene: Animation, path: Path, size: tuple[int, int]) -> Path:
    """Write a video of a scene; see `Scene.video`."""
    is_size = len(size) == 2 and all(isinstance(n, int) and 16 <= n <= 8192 and n % 2 == 0 for n in size)
    if not is_size:
        raise InputError(f"video expects size to be two even numbers of pixels from 16 to 8192, got {short(size)}")
    if not path.parent.is_dir():
        raise InputError(f"video cannot write {str(path)!r}: there is no folder {str(path.parent)!r}")
    try:
        import imageio_ffmpeg
    except ImportError as error:
        raise ModelError(f"video needs imageio-ffmpeg ({error}).\n  fix: pip install 'twistax[video]'") from None
    browser = next(filter(None, map(shutil.which, BROWSERS)), None)
    if browser is None:
        raise ModelError(
            "video needs Chromium or Chrome to draw the pictures; none was found on the PATH.\n"
            "  fix: install one, or write a page with solution.show('flight.html') and record it"
        )
    width, height = size
    with silent_server() as server:
        frames = scene.frames()
        stage = Stage(server, frames)
        with _client(server, browser, size) as client, _ffmpeg(imageio_ffmpeg.get_ffmpeg_exe(), path, size) as pipe:
            _settle(client, size)
            for k in range(len(frames.ts)):
                stage.draw(k)
                try:
                    picture = client.get_render(height, width, transport_format="png", timeout=_PICTURE)
                    pipe.write(np.ascontiguousarray(_on_white(picture)).tobytes())
                except (TimeoutError, OSError) as error:
                    raise ModelError(f"video: picture {k} of {len(frames.ts)} fails: {error!r}") from None
    return path


def _settle(client: Any, size: tuple[int, int]) -> None:
    """Draw pictures until two are equal: camera, lights and text arrive after the browser has connected."""
    width, height = size
    before = None
    for _ in range(_SETTLING):
        picture = client.get_render(height, width, transport_format="png", timeout=_PICTURE)
        if before is not None and np.array_equal(picture, before):
            return
        before = picture


def _on_white(picture: Any) -> Any:
    """RGB of a picture RGBA before a white ground."""
    if picture.shape[2] == 3:
        return picture
    opacity = picture[:, :, 3:].astype(np.float32) / 255.0
    return (picture[:, :, :3] * opacity + 255.0 * (1.0 - opacity)).astype(np.uint8)


@contextlib.contextmanager
def _ffmpeg(program: str, path: Path, size: tuple[int, int]) -> Iterator[Any]:
    """A pipe for pictures as raw RGB. Raises InputError for what ffmpeg says of the file."""
    taken = ["-f", "rawvideo", "-pix_fmt", "rgb24", "-s", f"{size[0]}x{size[1]}", "-r", str(RATE), "-i", "-"]
    made = ["-pix_fmt", "yuv420p", "-an", str(path)]
    command = [program, "-y", "-loglevel", "error", *taken, *made]
    with tempfile.TemporaryFile() as messages:
        process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.DEVNULL, stderr=messages)
        assert process.stdin is not None
        try:
            yield process.stdin
        finally:
            with contextlib.suppress(OSError):
                process.stdin.close()
            failed = process.wait()
            messages.seek(0)
            message = messages.read().decode(errors="replace").strip()
        if failed:
            raise InputError(f"video cannot write {str(path)!r}: {message.splitlines()[-1] if message else failed}")


@contextlib.contextmanager
def _client(server: Any, browser: str, size: tuple[int, int]) -> Iterator[Any]:
    """A browser without a window that shows the scene. Raises ModelError if it does not connect."""
    with tempfile.TemporaryDirectory(prefix="twistax_browser_", ignore_cleanup_errors=True) as profile:
        options = ["--headless=new", "--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--hide-scrollbars"]
        options += ["--no-sandbox", "--no-first-run", f"--user-data-dir={profile}"]
        options += [f"--window-size={size[0]},{size[1] + 160}"]
        address = f"http://127.0.0.1:{server.get_port()}"
        process = subprocess.Popen([browser, *options, address], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        try:
            end = time.monotonic() + _BEGIN
            while not server.get_clients():
                if process.poll() is not None or time.monotonic() > end:
                    raise ModelError(f"video: {browser} did not show the scene (exit status {process.returncode})")
                time.sleep(0.1)
            time.sleep(1.0)  # until the scene is there
            yield next(iter(server.get_clients().values()))
        finally:
            process.terminate()
            with contextlib.suppress(subprocess.TimeoutExpired):
                process.wait(timeout=10.0)
