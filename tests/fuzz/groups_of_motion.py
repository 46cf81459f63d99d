"""Maps of SO(3) and SE(3), against exponentials of matrices."""

from collections.abc import Callable
from random import Random
from typing import Any

import numpy as np
import scipy.linalg
from plans import MAKERS, Plan, finite, maker, summed
from scipy.spatial.transform import Rotation
from term import Shape


def _skew(w: Any) -> Any:
    return np.cross(np.eye(3), w)


def _hat(xi: Any) -> Any:
    v, w = xi[:3], xi[3:]
    return np.block([[_skew(w), v[:, None]], [np.zeros((1, 4))]])


def _adjoint(xi: Any) -> Any:
    v, w = _skew(xi[:3]), _skew(xi[3:])
    return np.block([[w, v], [np.zeros((3, 3)), w]])


def _dual(xi: Any) -> Any:
    return -_adjoint(xi).T


def bracket(code: str, matrix: Callable[[Any], Any], *shapes: Shape) -> Plan:
    """Of two vectors: linear in the second one by a matrix of the first."""
    args = (*shapes, (6,), (6,))[:2]
    return Plan(code, lambda a, b: matrix(a) @ b, args, rounding=lambda a, b: summed(np.matmul)(matrix(a), b))


def _exp(xi: Any) -> Any:
    return scipy.linalg.expm(np.asarray(_hat(xi), float))


def _big_adjoint(xi: Any) -> Any:
    return scipy.linalg.expm(np.asarray(_adjoint(xi), float))


def _phi(A: Any) -> Any:
    """sum A^k / (k + 1)!, by the exponential of a larger matrix."""
    n = len(A)
    whole = np.block([[np.asarray(A, float), np.eye(n)], [np.zeros((n, 2 * n))]])
    return scipy.linalg.expm(whole)[:n, n:]


@maker
def lie(source: Random, shape: Shape) -> Plan | None:
    """Against exponentials of matrices, on twists of at most one radian.

    A product with an adjoint is computed as its action, p x (R w) + R v: of infinite vectors it is NaN in other entries
    than the product of the matrix.
    """
    small = "tx.Tanh({0})"
    tanh = np.tanh
    found: dict[Shape, list[Plan]] = {
        (6,): [
            bracket("tx.lie.Adjoint({0}, {1})", _adjoint),
            bracket("tx.lie.AdjointDual({0}, {1})", _dual),
            Plan(
                f"(tx.lie.SE3Adjoint(tx.lie.SE3Exp({small})) @ {{1}})",
                lambda a, b: _big_adjoint(tanh(a)) @ finite(b),
                ((6,), (6,)),
            ),
            Plan(
                f"(tx.lie.SE3AdjointDual(tx.lie.SE3Exp({small})) @ {{1}})",
                lambda a, b: np.linalg.inv(_big_adjoint(tanh(a))).T @ finite(b),
                ((6,), (6,)),
            ),
            Plan(f"tx.lie.SE3Log(tx.lie.SE3Exp({small}))", lambda a: tanh(a), ((6,),)),
            *(
                bracket(
                    f"tx.lie.{name}(tx.lie.twist(linear=np.zeros(3), angular={{0}}, order={order}), "
                    f"{{1}}, order={order})",
                    lambda a, matrix=matrix, roll=roll: np.roll(matrix(np.append(np.zeros(3), a)), roll, (0, 1)),
                    (3,),
                )
                for name, matrix in (("Adjoint", _adjoint), ("AdjointDual", _dual))
                for order, roll in (("tx.LINEAR_FIRST", 0), ("tx.ANGULAR_FIRST", 3))
            ),
            *(
                bracket(
                    f"tx.lie.{name}({{0}}, {{1}}, order=tx.ANGULAR_FIRST)",
                    lambda a, matrix=matrix: np.roll(matrix(np.roll(a, 3)), 3, (0, 1)),
                )
                for name, matrix in (("Adjoint", _adjoint), ("AdjointDual", _dual))
            ),
            Plan(
                f"tx.linalg.Solve(tx.lie.SE3Adjoint(tx.lie.SE3Exp({small})), {{1}})",
                lambda a, b: np.linalg.solve(_big_adjoint(tanh(a)), finite(b)),
                ((6,), (6,)),
            ),
            Plan("tx.lie.twist(linear={0}, angular={1})", lambda a, b: np.concatenate([a, b]), ((3,), (3,))),
        ],
        (3,): [
            bracket("tx.linalg.Cross({0}, {1})", _skew, (3,), (3,)),
            bracket("np.cross({0}, {1})", _skew, (3,), (3,)),
            Plan(
                f"tx.lie.Act(tx.lie.SE3Exp({small}), {{1}})",
                lambda a, b: _exp(tanh(a))[:3, :3] @ b + _exp(tanh(a))[:3, 3],
                ((6,), (3,)),
            ),
            Plan(f"tx.lie.SO3Log(tx.lie.SO3Exp({small}))", tanh, ((3,),)),
            Plan("tx.lie.linear({0})", lambda a: a[:3], ((6,),)),
            Plan("tx.lie.angular({0})", lambda a: a[3:], ((6,),)),
        ],
        (3, 3): [
            Plan(
                "tx.pose(euler={0}, sequence='ZXZ')[:3, :3]",
                lambda a: Rotation.from_euler("ZXZ", a).as_matrix(),
                ((3,),),
            ),
            Plan(
                "tx.lie.EulerRotation(tx.lie.euler(tx.lie.SO3Exp({0})))",
                lambda a: Rotation.from_rotvec(a).as_matrix(),
                ((3,),),
            ),
            Plan(
                f"tx.lie.SO3Exp({small})",
                lambda a: scipy.linalg.expm(np.asarray(np.cross(np.eye(3), tanh(a)), float)),
                ((3,),),
            ),
        ],
        (4, 4): [
            Plan(f"tx.lie.SE3Exp({small})", lambda a: _exp(tanh(a)), ((6,),)),
            Plan(
                f"tx.lie.Inverse(tx.lie.SE3Exp({small}))",
                lambda a: np.linalg.inv(_exp(tanh(a))),
                ((6,),),
            ),
            Plan("tx.lie.Hat({0})", _hat, ((6,),)),
        ],
        (6, 6): [
            Plan(
                f"(tx.lie.LeftJacobian({small}) @ tx.lie.LeftJacobianInverse({small}))",
                lambda a: np.eye(6),
                ((6,),),
            ),
            Plan(f"tx.lie.RightJacobian({small})", lambda a: _phi(-_adjoint(tanh(a))), ((6,),)),
            Plan(f"tx.lie.LeftJacobian({small})", lambda a: _phi(_adjoint(tanh(a))), ((6,),)),
            Plan(f"tx.lie.SE3Adjoint(tx.lie.SE3Exp({small}))", lambda a: _big_adjoint(tanh(a)), ((6,),)),
        ],
    }
    return source.choice(found[shape]) if shape in found else None


MAKERS.extend([lie, lie])  # of the shapes that it gives few come
