"""A body that a stiff spring and damper hold at a slowly moving attitude."""

import numpy as np

import twistax as tx

from ..scene import Scene, about, said, stored_end

#: Moments of inertia, kg m2.
INERTIA = (1.0, 2.0, 3.0)
#: The attitude to follow is Exp(SWING sin(t) AXIS): the angle, rad, at 1 rad/s, and a unit axis in the world.
SWING, AXIS = 0.6, (0.0, 0.6, 0.8)


def system() -> tx.System:
    """R' = R [w]x and J w' = (J w) x w - k (e + w). States R (body to world) and w (3,), rad/s; parameter k.

    e is the vee of the skew part of D' R, D = Exp(SWING sin(t) AXIS) the attitude to follow: a spring of k N m/rad
    and a damper of k N m s/rad in parallel. Rates die away at k / J, in 1/s, down to w = -e; then the attitude closes
    in at about 1/s, however large k is. Output: error, |e|.
    """
    R, w, k = tx.State("R", group=tx.SO3), tx.State("w", shape=(3,)), tx.Parameter("k")
    J = np.array(INERTIA)
    D = tx.lie.SO3Exp(SWING * tx.Sin(tx.Time()) * np.array(AXIS))
    between = D.T @ R
    e = 0.5 * tx.lie.Vee(between - between.T)
    return tx.System(
        rates={R: w, w: (tx.linalg.Cross(J * w, w) - k * (e + w)) / J}, outputs={"error": tx.linalg.Norm(e)}
    )


#: Values of k for which the end is known.
RATES = tuple(10.0**n for n in range(2, 9))


def scene(rate: float = 1e5) -> Scene:
    """The scene with this k. The exact final state is known for those of `RATES`."""
    return Scene(
        **said("stiff-attitude", rate=f"{rate:.0e}", time=f"{1.0 / rate:.0e}"),
        build=system,
        start={"R": about((1.0, 0.0, 0.0), 0.6), "w": np.zeros(3)},
        duration=5.0,
        params={"k": rate},
        reference=stored_end("stiff-attitude", k=rate),
    )


STIFF_ATTITUDE = scene()
