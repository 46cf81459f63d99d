"""Exponential coordinates of any group, through what every group offers."""

from __future__ import annotations

import jax
import jax.numpy as jnp

from ...groups import Group
from .coordinates import Block, Coordinates

__all__ = ["GroupCoordinates"]


class GroupCoordinates(Coordinates):
    """g = g_0 Exp(z), z' = J_r(z)^-1 Omega, with the group's own maps: for groups that a chart does not know."""

    def __init__(self, group: Group) -> None:
        self.group = group

    def enter(self, g: jax.Array) -> Block:
        return (g,)

    def value(self, y: Block) -> jax.Array:
        return y[0]

    def rate(self, omega: jax.Array) -> Block:
        return (omega,)

    def move(self, y: Block, z: Block) -> Block:
        return (self.group.retract(y[0], z[0]),)

    def slope(self, z: Block, moved: Block, omega: Block) -> Block:
        return (self.group.right_jacobian_inv_apply(z[0], omega[0]),)

    def first_slope(self, y: Block, omega: Block) -> Block:
        return omega

    def sizes(self, before: Block, after: Block) -> Block:
        return (jnp.ones(self.group.dimension, before[0].dtype),)

    def tangent(self, z: Block) -> jax.Array:
        return z[0]

    def settle(self, moved: Block) -> Block:
        return (self.group.tighten(moved[0]),)
