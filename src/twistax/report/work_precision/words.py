"""What the findings mean for somebody who must choose, in sentences. All of them are found in the data."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from statistics import median

from ..pages.page import listed
from ..rows import plain
from .contender import Line
from .contenders import CONTENDERS, LONG, ONE_CALL, OURS, SHIPPED, STIFF
from .findings import TARGETS, Findings

__all__ = ["advice", "advice_if_stiff", "digits", "on_diffrax", "on_quaternions", "on_tolerance", "winners"]

#: Times closer than this count as the same.
_SAME = 1.05


def advice(findings: Findings, names: Mapping[str, str]) -> str:
    """The method whose worst case, over scenes and errors, is the best, of those that can be had by calling a library.

    Args:
        names: titles of the scenes.
    """
    scenes = [scene for scene in findings.scenes if scene not in (*STIFF, *LONG)]
    said = _advice(findings, names, scenes, "If in doubt")
    return said or "No method was run on all scenes to the errors compared here; there is no single advice."


def advice_if_stiff(findings: Findings, names: Mapping[str, str]) -> list[str]:
    """The same for the stiff scenes, where any were run."""
    said = _advice(findings, names, [scene for scene in findings.scenes if scene in STIFF], "If the system is stiff")
    return [said] if said else []


def _advice(findings: Findings, names: Mapping[str, str], scenes: Sequence[str], when: str) -> str:
    """A sentence; empty where no line reached every error."""
    worst = _worst_ratios(findings, scenes)
    if not worst:
        return ""
    line = min(worst, key=lambda line: worst[line][0])
    ratio, scene, error = worst[line]
    if ratio <= _SAME:
        close = "nothing else that can be had by calling a library is faster on any scene"
    else:
        close = f"at worst it takes {ratio:.1f} times as long as the fastest ({names[scene]}, error {plain(error)})"
    return f"**{when}, take {line.title}**, `{line.code}`: {close}."


def _worst_ratios(findings: Findings, scenes: Sequence[str]) -> dict[Line, tuple[float, str, float]]:
    """By line that reaches every error on every one of the scenes: its largest ratio to the fastest, and where."""
    found = {}
    lines = [line for line in findings.lines if line.side.ready]
    for line in lines:
        ratios = [
            (findings.time(scene, line, error) / ranking[0].seconds, scene, error)
            for scene in scenes
            for error in TARGETS
            if (ranking := findings.ranking(scene, error, lines))
        ]
        if ratios and all(math.isfinite(ratio) for ratio, _, _ in ratios):
            found[line] = max(ratios)
    return found


def winners(findings: Findings, names: Mapping[str, str]) -> list[str]:
    """For each error, which method was the fastest where."""
    sentences = []
    for error in TARGETS:
        firsts: dict[Line, list[str]] = {}
        for scene in findings.scenes:
            ranking = findings.ranking(scene, error)
            if ranking:
                firsts.setdefault(ranking[0].line, []).append(names[scene])
        if firsts:
            most = sorted(firsts.items(), key=lambda item: -len(item[1]))
            parts = "; ".join(f"{line.title} on {listed(scenes)}" for line, scenes in most)
            sentences.append(f"**Error {plain(error)}** ({-math.log10(error):.0f} digits). Fastest: {parts}.")
    return sentences


def digits(findings: Findings) -> str:
    """What one more digit costs."""
    costs = {}
    for line in findings.lines:
        ratios = [findings.time(s, line, TARGETS[1]) / findings.time(s, line, TARGETS[0]) for s in findings.scenes]
        known = [ratio for ratio in ratios if math.isfinite(ratio)]
        if line.side == OURS and line.drawn and known:
            costs[line] = median(known) ** (1.0 / math.log10(TARGETS[0] / TARGETS[1]))
    if not costs:
        return "What a digit costs cannot be said: no method reached both errors."
    parts = ", ".join(f"{cost:.2f} with {line.title}" for line, cost in sorted(costs.items(), key=lambda c: -c[1]))
    between = f"between errors of {plain(TARGETS[0])} and {plain(TARGETS[1])}"
    return f"**One more digit** multiplies the time by {parts} (median over the scenes, {between})."


def on_tolerance(findings: Findings) -> str:
    """That the tolerance is not the error."""
    name, setting = "dop853", 1e-9
    rows = [row for row in findings.rows if row.by == name and row.numbers["setting"] == setting and row.done]
    errors = [row.numbers["error"] for row in rows]
    if not errors:
        return "A tolerance bounds the error of one step. The error at the end is another matter: try two of them."
    low, high = plain(min(errors)), plain(max(errors))
    ended = f"an error of {low} on this scene" if len(errors) == 1 else f"errors from {low} to {high} on these scenes"
    return (
        "**A tolerance is not the error at the end**; it bounds what one step may add. With rtol = atol = "
        f"{plain(setting)} {CONTENDERS[name].line.title} ended with {ended}. "
        "Integrate once more with a tolerance ten times smaller to see what yours gives."
    )


def on_quaternions(findings: Findings, names: Mapping[str, str]) -> str:
    """Where plain quaternions beat exponential coordinates, and the other way round, with the same tableau."""
    plain, curved = CONTENDERS["dop853-quaternion"].line, CONTENDERS["dop853"].line
    ratios = _ratios(findings, plain, curved)
    if not ratios:
        return "Plain quaternions and exponential coordinates were not compared in this run."
    better = [names[scene] for scene, ratio in ratios.items() if ratio * _SAME < 1.0]
    worse = [names[scene] for scene, ratio in ratios.items() if ratio > _SAME]
    same = [names[scene] for scene in ratios if names[scene] not in (*better, *worse)]
    parts = [
        f"{word} on {listed(scenes)}"
        for word, scenes in (("faster", better), ("slower", worse), ("as fast", same))
        if scenes
    ]
    return (
        f"**Plain quaternions or exponential coordinates?** With the same tableau, {plain.title} is "
        f"{'; '.join(parts)} (its time is {_span(ratios.values())} times that of {curved.title}; "
        f"the mean over both errors counts). Linearisation and trajectory problems need "
        f"exponential coordinates in any case."
    )


def on_diffrax(findings: Findings, names: Mapping[str, str]) -> list[str]:
    """Where diffrax is the better choice."""
    sentences = []
    for side in (ONE_CALL, SHIPPED):
        wins, ratios = [], []
        for error in TARGETS:
            faster = []
            for scene in findings.scenes:
                ours, theirs = findings.best(scene, error, OURS), findings.best(scene, error, side)
                if theirs is not None:
                    ratios.append(ours.seconds / theirs.seconds if ours else math.inf)
                    share = f"{1.0 / ratios[-1]:.2f} of our time" if ours else "none of ours got there"
                    faster += [f"{names[scene]} ({share})"] if ratios[-1] > 1.0 else []
            wins += [f"at {plain(error)} on {listed(faster)}"] if faster else []
        if wins:
            sentences.append(f"**{side.name} is faster** {'; '.join(wins)}.")
        elif ratios:
            sentences.append(
                f"**{side.name} is not faster on any scene**: our fastest method takes {_span(ratios)} of the "
                "time of its fastest."
            )
    sentences.append(
        "Explicit methods are not run on the stiff scenes, which would move slowly but for a very fast part that has "
        "died out: their steps are as short as that part is fast. Implicit ones are run there alone."
    )
    return sentences


def _ratios(findings: Findings, line: Line, other: Line) -> dict[str, float]:
    """By scene the geometric mean of the ratios of time at the errors that both reach."""
    found = {}
    for scene in findings.scenes:
        ratios = [findings.time(scene, line, error) / findings.time(scene, other, error) for error in TARGETS]
        known = [math.log(ratio) for ratio in ratios if math.isfinite(ratio)]
        if known:
            found[scene] = math.exp(sum(known) / len(known))
    return found


def _span(values: Iterable[float]) -> str:
    ends = sorted(values)
    low, high = f"{ends[0]:.2f}", f"{ends[-1]:.2f}"
    return low if low == high else f"{low} to {high}"
