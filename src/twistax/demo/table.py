"""The table of a landing, and in words how good it is."""

from __future__ import annotations

import csv
from collections.abc import Mapping, Sequence
from pathlib import Path

import jax
import numpy as np

import twistax as tx

from ..scenes.powered_descent import Array
from ..scenes.touchdown import ALLOWED, Descent, Miss, Reach

__all__ = ["describe_failure", "describe_limits", "describe_misses", "save_table"]


def describe_misses(misses: Mapping[str, Miss]) -> list[str]:
    """A line for every rollout, under a heading."""
    lines = [f"{'simulated, ends off the pad by':<44}{'position':>12}{'velocity':>14}{'upright':>13}"]
    for name, miss in misses.items():
        lines.append(f"{name:<44}{miss.position:>10.4f} m{miss.velocity:>10.4f} m/s{miss.angle:>9.4f} deg")
    return lines


def describe_limits(found: Sequence[Reach]) -> list[str]:
    """A line for every limit, under a heading."""
    lines = [f"{'between the nodes':<18}{'limit':>15}{'nearest':>14}{'at':>10}{'margin':>15}"]
    for reach in found:
        limit = reach.limit
        bound = f"{limit.relation} {limit.shown} {limit.unit}"
        # Adding zero turns a rounded -0.0 into 0.0.
        margin = f"{round(reach.margin, 2) + 0.0:+,.2f} {limit.unit}"
        lines.append(f"{limit.name:<18}{bound:>15}{reach.value:>14,.2f}{reach.time:>8.2f} s{margin:>15}")
    return lines


def describe_failure(
    misses: Mapping[str, Miss], found: Sequence[Reach], time: float, times: tuple[float, float]
) -> list[str]:
    """What a try that is no landing violates, in words; nothing where all is well.

    Args:
        time, times: the flight time and its limits, s.
    """
    said = []
    missed = {name: miss for name, miss in misses.items() if not miss.within(ALLOWED)}
    for name, miss in list(missed.items())[:1]:
        said.append(
            f"it ends {miss.position:,.2f} m off the pad, at {miss.velocity:,.2f} m/s, {miss.angle:,.2f} deg from "
            f"upright (simulated with {name})"
        )
    for reach in found:
        if not reach.holds:
            limit = reach.limit
            said.append(
                f"{limit.name}: {reach.value:,.2f} {limit.unit} at {reach.time:.2f} s, but the limit is "
                f"{limit.relation} {limit.shown} {limit.unit}"
            )
    if not times[0] - 0.01 <= time <= times[1] + 0.01:
        said.append(f"flight time: {time:.2f} s, but it must be from {times[0]:g} to {times[1]:g} s")
    return said


def save_table(path: Path, descent: Descent) -> None:
    """Write a descent as CSV, one line a sample, with units in the first line."""
    quaternions = np.asarray(jax.vmap(tx.lie.quaternion)(descent.rotation))
    degrees = 180.0 / np.pi
    columns: list[tuple[str, Array]] = [
        ("time (s)", descent.ts),
        *zip(("x (m)", "y (m)", "height (m)"), descent.position.T),
        *zip(("velocity x (m/s)", "velocity y (m/s)", "velocity z (m/s)"), descent.velocity.T),
        *zip(("quaternion w", "quaternion x", "quaternion y", "quaternion z"), quaternions.T),
        *zip(("body rate x (rad/s)", "body rate y (rad/s)", "body rate z (rad/s)"), descent.xs["V"][:, 3:].T),
        ("mass (kg)", descent.xs["m"]),
        *zip(("body thrust x (N)", "body thrust y (N)", "body thrust z (N)"), descent.us["T"].T),
        ("thrust (kN)", descent.outputs["thrust"] / 1e3),
        ("gimbal (deg)", descent.outputs["gimbal"] * degrees),
        ("tilt (deg)", descent.outputs["tilt"] * degrees),
        ("rate (deg/s)", descent.outputs["rate"] * degrees),
        ("inside the cone (m)", descent.outputs["cone"]),
    ]
    with path.open("w", newline="") as file:
        writer = csv.writer(file)
        writer.writerow([name for name, _ in columns])
        for row in zip(*(values for _, values in columns)):
            writer.writerow([f"{value:.9g}" for value in row])
