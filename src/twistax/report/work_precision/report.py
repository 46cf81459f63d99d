"""`python -m twistax report`."""

from __future__ import annotations

import argparse
import dataclasses
from collections.abc import Callable
from typing import Any

from ...scenes import SCENES
from ..progress import Tell
from ..report import Report
from ..rows import Row
from ..timing import empty_call_seconds
from .contender import FULL, QUICK
from .contenders import CONTENDERS, IN_QUICK, TOO_LONG_FOR_QUICK, suited
from .findings import Findings, bar_rows
from .measure import Refusal, measure_scene
from .page import context, draw

__all__ = ["WorkPrecision"]


class WorkPrecision(Report):
    name, template, title = "report", "work_precision", "Which integrator, and what does a digit cost?"

    def __init__(self, arguments: argparse.Namespace) -> None:
        self._effort = QUICK if arguments.quick else FULL
        self.effort = dataclasses.asdict(self._effort)
        self._asked = arguments.method
        chosen = arguments.method or (IN_QUICK if arguments.quick else list(CONTENDERS))
        self._contenders = {name: CONTENDERS[name] for name in CONTENDERS if name in chosen}
        left_out = TOO_LONG_FOR_QUICK if arguments.quick else ()
        asked = arguments.scene or [name for name in SCENES if name not in left_out]
        self._scenes = {name: SCENES[name] for name in SCENES if name in asked}
        self.parts = list(self._scenes)
        self._refused: list[Refusal] = []

    def measure(self, part: str, tell: Tell) -> None:
        names = self._asked or suited(self._contenders, part)
        chosen = [self._contenders[name] for name in names]
        self._refused += measure_scene(self._scenes[part], chosen, self._effort, self.store, tell)

    def _findings(self) -> Findings:
        return Findings((row for name in self.parts for row in self.store if row.group == name), self._contenders)

    def rows(self) -> list[Row]:
        return self._findings().rows

    def bars(self) -> list[Row]:
        return bar_rows(self._findings(), {name: scene.title for name, scene in self._scenes.items()})

    def problems(self) -> list[str]:
        findings = self._findings()
        return [] if findings.agreed else [doubt.sentence for doubt in findings.doubts]

    def drawings(self) -> dict[str, Callable[[], bytes]]:
        findings = self._findings()

        def drawing(name: str) -> Callable[[], bytes]:
            return lambda: draw(findings, name, self._scenes[name].title)

        return {name: drawing(name) for name in findings.scenes if findings.drawn(name)}

    def context(self) -> dict[str, Any]:
        origin = self.store.origin
        return context(self._findings(), self._scenes, self.bars(), self._refused, origin, empty_call_seconds())
