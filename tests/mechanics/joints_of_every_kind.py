"""A tree with joints of every kind, and Lagrange's equations of its point masses."""

import functools
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from mechanics_oracles import Cloud, body_of, pose
from scipy.linalg import expm

from oracles import hat
from twistax.mechanics import Drive, Link, Mechanism, Mimic, joints

GRAVITY = np.array([0.7, -1.1, -9.6])
AXIS = np.array([0.6, 0.0, -0.8])


class Tree:
    """A mechanism, and where its points are, by matrix exponentials along the motions of its joints."""

    def __init__(self, mimic: Mimic | None = None, **drives: Drive) -> None:
        rng = np.random.default_rng(7)
        one, two = joints.universal("cardan", (0.0, 1.0, 0.0), AXIS)
        #: A joint, what it sits on, and whether its link has mass.
        plan = [
            (joints.Free("root"), None, True),
            (joints.Cylindrical("rod", AXIS), "root", True),
            (joints.Spherical("ball"), "rod", True),
            (joints.Helical("screw", (0.0, -1.0, 0.0), 0.3), "ball", True),
            (joints.Planar("table"), "root", True),
            (one, "table", False),
            (two, "cardan_1", True),
            (joints.Prismatic("slide", AXIS), "table", True),
            (joints.Revolute("hinge", (1.0, 0.0, 0.0)), "slide", True),
            (joints.Fixed("tool"), "ball", True),
        ]
        self.plan = [
            (joint, parent, pose(rng), Cloud.random(rng, 4) if heavy else None) for joint, parent, heavy in plan
        ]
        links = [
            Link(
                joint,
                None if cloud is None else body_of(cloud),
                mount,
                parent=parent,
                drive=drives.get(joint.name, Drive()),
                mimic=mimic if joint.name == "hinge" else None,
            )
            for joint, parent, mount, cloud in self.plan
        ]
        self.mechanism, self.mimic = Mechanism(reversed(links), GRAVITY), mimic
        self.start = {
            "q": rng.normal(size=self.mechanism.q["q"].shape),
            "root": pose(rng),
            "ball": pose(rng)[:3, :3],
        }

    def placement(self, joint: joints.Joint) -> np.ndarray:
        """The pose of a joint at the start."""
        H, at = np.asarray(joint.motion_subspace.value), self.mechanism.segment_of(joint.name).coordinates
        if joint.name in ("root", "ball"):
            T = np.eye(4)
            T[: len(self.start[joint.name]), : len(self.start[joint.name])] = self.start[joint.name]
            return T
        q = self.start["q"][at]
        if joint.name == "table":
            T = np.array(expm(hat(np.array([0.0, 0.0, 0.0, 0.0, 0.0, q[2]]))))
            T[:2, 3] = q[:2]
            return T
        if self.mimic is not None and joint.name == "hinge":
            q = self.mimic.ratio * q + self.mimic.offset
        return np.array(expm(hat(H @ q)))

    def poses(self, d: jax.Array) -> dict[str, jax.Array]:
        """T of every link when each joint has moved by Exp(H d) from the start."""
        found: dict[str | None, Any] = {None: jnp.eye(4)}
        units = np.stack([hat(unit) for unit in np.eye(6)])
        for joint, parent, mount, _ in self.plan:
            T = found[parent] @ mount
            if joint.dofs:
                own = d[np.array(self.mechanism.segment_of(joint.name).freedoms)]
                if self.mimic is not None and joint.name == "hinge":
                    own = self.mimic.ratio * own
                xi = jnp.tensordot(joint.motion_subspace.value @ own, units, 1)
                # Exp(xi) to third order: what is asked of it are derivatives at zero.
                T = T @ self.placement(joint) @ (np.eye(4) + xi + xi @ xi / 2.0 + xi @ xi @ xi / 6.0)
            found[joint.name] = T
        return found  # type: ignore[return-value]

    def points(self, d: jax.Array) -> tuple[np.ndarray, jax.Array]:
        poses = self.poses(d)
        parts = [(poses[joint.name], cloud) for joint, _, _, cloud in self.plan if cloud is not None]
        places = [cloud.points @ T[:3, :3].T + T[:3, 3][None] for T, cloud in parts]
        return np.concatenate([cloud.masses for _, cloud in parts]), jnp.concatenate(places)

    @functools.partial(jax.jit, static_argnums=0)
    def lagrange(self, qd: jax.Array, qdd: jax.Array) -> jax.Array:
        """d/dt dL/dd' - dL/dd at d = 0, where the rates of d are the velocities to second order."""

        def lagrangian(d: jax.Array, rate: jax.Array) -> jax.Array:
            place, velocity = jax.jvp(lambda d: self.points(d)[1], (d,), (rate,))
            return self.points(d)[0] @ (0.5 * jnp.sum(velocity**2, axis=1) + place @ GRAVITY)

        momentum, d = jax.grad(lagrangian, 1), jnp.zeros(self.mechanism.dofs)
        return jax.jvp(momentum, (d, qd), (qd, qdd))[1] - jax.grad(lagrangian, 0)(d, qd)

    def inputs(self, **others: Any) -> dict[str, Any]:
        names = {"q": "q", "root": "root_position", "ball": "ball_position"}
        return {**{names[name]: value for name, value in self.start.items()}, **others}

    def moved(self, qd: np.ndarray, time: float) -> dict[str, Any]:
        """The inputs a time later at this velocity."""
        found = {name: np.array(value) for name, value in self.start.items()}
        for joint, _, _, _ in self.plan:
            if not joint.dofs:
                continue
            segment = self.mechanism.segment_of(joint.name)
            by = time * qd[np.array(segment.freedoms)]
            T = self.placement(joint) @ expm(hat(np.asarray(joint.motion_subspace.value) @ by))
            if segment.coordinates is None:
                found[joint.name] = T[: len(found[joint.name]), : len(found[joint.name])]
            elif joint.name == "table":
                found["q"][segment.coordinates] = [*T[:2, 3], self.start["q"][segment.coordinates][2] + by[2]]
            else:
                found["q"][segment.coordinates] = self.start["q"][segment.coordinates] + by
        names = {"q": "q", "root": "root_position", "ball": "ball_position"}
        return {"qd": qd, **{names[name]: value for name, value in found.items()}}


@functools.cache
def free_tree() -> Tree:
    return Tree()


@functools.cache
def mimicking_tree() -> Tree:
    return Tree(Mimic("slide", ratio=-1.7, offset=0.4))
