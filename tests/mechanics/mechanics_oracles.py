"""Independent references for joints and bodies: 4x4 matrices, and clouds of point masses summed one by one."""

from __future__ import annotations

import dataclasses

import numpy as np
from scipy.spatial.transform import Rotation

from oracles import hat
from twistax.mechanics import SpatialInertia


def pose(rng: np.random.Generator) -> np.ndarray:
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = Rotation.from_quat(rng.normal(size=4)).as_matrix(), rng.normal(size=3)
    return T


@dataclasses.dataclass(frozen=True)
class Cloud:
    """Point masses, in some frame."""

    points: np.ndarray
    masses: np.ndarray

    @classmethod
    def random(cls, rng: np.random.Generator, count: int = 6) -> Cloud:
        return cls(rng.normal(size=(count, 3)), rng.uniform(0.5, 2.0, size=count))

    def moved(self, T: np.ndarray) -> Cloud:
        return Cloud(self.points @ T[:3, :3].T + T[:3, 3], self.masses)

    def with_other(self, other: Cloud) -> Cloud:
        return Cloud(np.concatenate([self.points, other.points]), np.concatenate([self.masses, other.masses]))

    @property
    def mass(self) -> float:
        return float(self.masses.sum())

    @property
    def center(self) -> np.ndarray:
        return self.masses @ self.points / self.mass

    def tensor_about(self, place: np.ndarray) -> np.ndarray:
        total = np.zeros((3, 3))
        for m, r in zip(self.masses, self.points - place, strict=True):
            total += m * ((r @ r) * np.eye(3) - np.outer(r, r))
        return total

    def velocities(self, xi: np.ndarray) -> np.ndarray:
        return np.stack([(hat(xi) @ np.append(r, 1.0))[:3] for r in self.points])

    def momentum(self, xi: np.ndarray) -> np.ndarray:
        carried = self.masses[:, None] * self.velocities(xi)
        return np.concatenate([carried.sum(axis=0), np.cross(self.points, carried).sum(axis=0)])

    def kinetic_energy(self, xi: np.ndarray) -> float:
        return float(0.5 * self.masses @ np.sum(self.velocities(xi) ** 2, axis=1))

    def mass_matrix(self) -> np.ndarray:
        return np.stack([self.momentum(unit) for unit in np.eye(6)], axis=1)

    def weight(self, T: np.ndarray, gravity: np.ndarray) -> np.ndarray:
        forces = self.masses[:, None] * (T[:3, :3].T @ gravity)
        return np.concatenate([forces.sum(axis=0), np.cross(self.points, forces).sum(axis=0)])


def body_of(cloud: Cloud) -> SpatialInertia:
    return SpatialInertia(mass=cloud.mass, center_of_mass=cloud.center, inertia=cloud.tensor_about(cloud.center))
