"""A scene over time, as a page, a file or a server."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Any

from ..checks import path_of, whole
from ..errors import InputError
from .animation import Animation
from .stage import page, served


@dataclasses.dataclass(frozen=True, eq=False)
class Scene(Animation):
    """What `show` gives back: a scene over time. A notebook shows it.

    Attributes:
        ts: (n,) times in s, rising.
        bodies: what moves.
        vectors: what is drawn as arrows.
        shapes: what stands still.
        up: (3,) the direction that is drawn upwards.
        seconds: how long the animation takes; the time of the motion, from 2 to 20 s, unless given.
    """

    def html(self) -> str:
        """The animation as one HTML page, with a slider and without anything from elsewhere.

        Raises ModelError where viser is not installed.
        """
        return page(self)

    def save(self, path: Any) -> Path:
        """Write the page of `html`; a file that is there is written over.

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

    def live(self, port: int = 8080) -> Any:
        """Serve the scene to browsers of this machine, with a slider for the time, at a free port.

        Returns:
            the viser server: `server.sleep_forever()` keeps a script running, `server.stop()` ends it; more can be put
            into its scene.
        Raises:
            InputError: port is no positive whole number.
            ModelError: viser is not installed.
        """
        return served(self, whole("live: port", port))

    def _repr_html_(self) -> str:
        from html import escape

        return f'<iframe srcdoc="{escape(self.html())}" style="width: 100%; height: 480px; border: 0"></iframe>'
