"""A body held to a slowly moving attitude by a stiff spring and a stiff damper."""

from __future__ import annotations

import numpy as np

import twistax as tx

from .arrays import about
from .scene import Scene

__all__ = ["AXIS", "INERTIA", "RATES", "STIFF_ATTITUDE", "SWING", "scene", "system"]

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
        rates={R: w, w: (tx.linalg.Cross(J * w, w) - k * (e + w)) / J},
        outputs={"error": tx.linalg.Norm(e)},
    )


#: Values of k for which the end is known.
RATES = tuple(10.0**n for n in range(2, 9))
#: As `python -m twistax.scenes.references stiff-attitude` finds them, by k: R row by row, w.
_ENDS = {
    1e2: (
        [
            [0.9337925378834209, 0.28607182635259937, -0.21492884022515027],
            [-0.28695165033373154, 0.9575419428224254, 0.027788092892512127],
            [0.2137527697223777, 0.03572587162188263, 0.9762343036038372],
        ],
        [-0.003999761541923165, -0.13047075701617805, -0.17432024907944962],
    ),
    1e3: (
        [
            [0.9344358765662779, 0.2844371939458843, -0.21430136557195162],
            [-0.28542665782662163, 0.9580204723336853, 0.026988841980850307],
            [0.2129817259478768, 0.035947980328998576, 0.9763946574631232],
        ],
        [-0.004355730839036943, -0.12730731610035936, -0.16782065848017744],
    ),
    1e4: (
        [
            [0.9345031588252378, 0.2842658693571748, -0.2142352950945802],
            [-0.2852658479332257, 0.9580706037369839, 0.026909371192746778],
            [0.21290195430899644, 0.03596712073075752, 0.9764113498304642],
        ],
        [-0.004392234340904905, -0.126994909335442, -0.1671830323775086],
    ),
    1e5: (
        [
            [0.9345099151440112, 0.28424866149384, -0.21422865573142524],
            [-0.28524968712084436, 0.9580756385172141, 0.02690142890801348],
            [0.21289395128794422, 0.03596900497362781, 0.9764130254079026],
        ],
        [-0.004395892703588677, -0.12696370793657386, -0.16711939348125301],
    ),
    1e6: (
        [
            [0.9345105910554455, 0.2842469399566284, -0.21422799147285734],
            [-0.28524807024461923, 0.9580761422105066, 0.02690063472771646],
            [0.21289315072806486, 0.03596919310084834, 0.976413193028828],
        ],
        [-0.0043962586189573594, -0.126960588189353, -0.16711303082903123],
    ),
    1e7: (
        [
            [0.9345106586493832, 0.28424676779540164, -0.2142279250437789],
            [-0.2852479085490501, 0.9580761925819874, 0.026900555310168755],
            [0.21289307066949997, 0.03596921191060063, 0.9764132097915522],
        ],
        [-0.0043962952112842095, -0.12696027621855743, -0.16711239457618332],
    ),
    1e8: (
        [
            [0.9345106654088049, 0.2842467505792039, -0.21422791840083885],
            [-0.28524789237941367, 0.958076197619157, 0.026900547368418806],
            [0.21289306266361774, 0.03596921379154616, 0.9764132114678309],
        ],
        [-0.004396298870524793, -0.12696024502151715, -0.16711233095102226],
    ),
}


def scene(rate: float = 1e5) -> Scene:
    """The scene with this k. The true end is known for those of `RATES`."""
    end = {name: np.array(value) for name, value in zip(("R", "w"), _ENDS.get(rate, ()))}
    return Scene(
        name="stiff-attitude",
        title="stiff attitude hold",
        summary=(
            "A body with moments 1, 2 and 3 kg m2 is held to a swinging attitude for 5 s, by a spring of "
            f"{rate:.0e} N m/rad beside a damper of as many N m s/rad: its rate settles in some {1.0 / rate:.0e} s, "
            "its attitude in some seconds."
        ),
        source="written for this scene; Euler's equations",
        build=system,
        start={"R": about((1.0, 0.0, 0.0), 0.6), "w": np.zeros(3)},
        duration=5.0,
        params={"k": rate},
        reference=end or None,
    )


STIFF_ATTITUDE = scene()
