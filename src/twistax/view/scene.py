"""A scene over time, with its forms: a page, a file or a server."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Any

from ..checks import path_of, whole
from ..errors import InputError
from ..progress import watching
from .animation import Animation
from .film import film
from .stage import page, served


@dataclasses.dataclass(frozen=True, eq=False)
class Scene(Animation):
    """The result of `show`: a scene over time. Notebooks display it.

    Attributes:
        ts: (n,) increasing times in s.
        bodies: the moving bodies.
        vectors: the vectors, which are drawn as arrows.
        shapes: the fixed shapes.
        up: (3,) the upward direction.
        seconds: the duration of the animation; by default the time of the motion, from 2 to 20 s.
        follow: the name of the body at the centre of the picture; none by default.
        caption: (n, ...) values by name that are printed next to the time.
        ground: whether a plane is drawn below everything, with shadows.
    """

    def html(self) -> str:
        """The animation as one self-contained HTML page with a slider.

        Raises ModelError if viser is not installed.
        """
        return page(self)

    @watching("save")
    def save(self, path: Any) -> Path:
        """Write the page of `html`; an existing file is overwritten.

        Raises:
            InputError: a path that cannot be written.
            ModelError: viser is not installed.
        """
        file = path_of("save: path", path)
        page = self.html()
        try:
            file.write_text(page, encoding="utf-8")
        except OSError as error:
            raise InputError(f"save cannot write {str(file)!r}: {error.strerror}") from None
        return file

    def video(self, path: Any, *, size: tuple[int, int] = (1280, 720)) -> Path:
        """Write the animation as a video, such as flight.mp4, with thirty frames a second.

        An installed Chromium or Chrome draws the frames, without a window; imageio-ffmpeg writes the file.

        Args:
            path: path of the file; an existing file is overwritten. The extension selects the format.
            size: width and height in pixels, even numbers.
        Raises:
            InputError: a path that cannot be written, or invalid sizes.
            ModelError: viser or imageio-ffmpeg is not installed, no browser was found, or it draws nothing.
        """
        return film(self, path_of("video: path", path), size)

    def live(self, port: int = 8080) -> Any:
        """Serve the scene to browsers on this machine, with a slider for the time, at a free port.

        Returns:
            the viser server: `server.sleep_forever()` keeps a script running, `server.stop()` ends it; its scene can be
            extended.
        Raises:
            InputError: port is not a positive whole number.
            ModelError: viser is not installed.
        """
        return served(self, whole("live: port", port))

    def _repr_html_(self) -> str:
        from html import escape

        return f'<iframe srcdoc="{escape(self.html())}" style="width: 100%; height: 480px; border: 0"></iframe>'
