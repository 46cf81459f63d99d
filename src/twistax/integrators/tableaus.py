"""Butcher tableaus of explicit methods: data that is checked when it is made; the tableaus themselves, by order."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..errors import ModelError

__all__ = [
    "ALL",
    "BOGACKI_SHAMPINE3",
    "DOP853",
    "DORMAND_PRINCE5",
    "DORMAND_PRINCE8",
    "EULER",
    "HEUN",
    "RK4",
    "TSIT5",
    "ButcherTableau",
]

#: Coefficients are given in double precision; a sum of them may be off by a few units in the last place.
_TOLERANCE = 1e-13


class Coefficients:
    """What the data of all methods share: a name, an order, numbers that are checked when it is made, and messages."""

    name: str
    order: int
    c: Any
    #: How messages call it.
    kind = "tableau"

    @property
    def stages(self) -> int:
        """How many there are, one for each node."""
        return len(self.c)

    def _read(self, field: str, shape: tuple[int, ...] | None = None) -> NDArray[Any]:
        """Make a field a read-only array of finite doubles, of that shape if one is given."""
        try:
            array = np.array(getattr(self, field), dtype=np.float64)
        except (TypeError, ValueError) as wrong:
            raise self._error(f"{field} is not an array of numbers: {wrong}") from None
        if not np.isfinite(array).all():
            raise self._error(f"{field} has entries that are not finite")
        if shape is not None and array.shape != shape:
            raise self._error(f"{field} must have shape {shape}, got {array.shape}")
        array.setflags(write=False)
        self._set(**{field: array})
        return array

    def _set(self, **values: Any) -> None:
        for field, value in values.items():
            object.__setattr__(self, field, value)

    def _check_order(self, field: str = "order") -> None:
        order = getattr(self, field)
        if isinstance(order, bool) or not isinstance(order, int) or order < 1:
            raise self._error(f"{field} must be a positive whole number, got {order!r}")

    def _error(self, sentence: str) -> ModelError:
        return ModelError(f"{self.kind} {self.name!r}: {sentence}")

    def __repr__(self) -> str:
        return f"{type(self).__name__}({self.name}, order {self.order}, {self.stages} stages)"


class Rows(NamedTuple):
    """Stages to run: a (n, n), strictly lower triangular, and c (n,)."""

    a: Any
    c: Any


@dataclasses.dataclass(frozen=True, eq=False, repr=False)
class ButcherTableau(Coefficients):
    """The coefficients of an explicit Runge-Kutta method with s stages. Arrays are read-only.

    For y' = f(t, y):  k_i = f(t + c_i h, y + h sum_j a_ij k_j),  y_1 = y + h sum_i b_i k_i.

    Attributes:
        name: how tables call it.
        order: the order of convergence of the solution made with b.
        a: (s, s), strictly lower triangular; rows sum to c.
        b, c: (s,); b sums to 1.
        embedded_order, b_embedded: for pairs, order and weights of the solution that estimates the error, else None.
        second_embedded_order, b_second_embedded: a second such solution, of lower order, for methods that weigh two
            estimates against each other.
        counted: the stages up to the last one that b counts; later ones serve the embedded solutions or the next step.

    Raises:
        ModelError: a wrong shape, a value that is not finite, an implicit stage, or a sum that is off.

    Source: Hairer, Norsett, Wanner, Solving Ordinary Differential Equations I (1993), section II.1.
    """

    name: str
    order: int
    a: Any
    b: Any
    c: Any
    embedded_order: int | None = None
    b_embedded: Any = None
    second_embedded_order: int | None = None
    b_second_embedded: Any = None
    counted: Rows = dataclasses.field(init=False)

    def __post_init__(self) -> None:
        b = self._read("b")
        if b.ndim != 1 or not b.size:
            raise self._error(f"b must be a vector, got shape {b.shape}")
        s = b.size
        self._read("a", (s, s))
        self._read("c", (s,))
        if np.triu(self.a).any():
            row = int(np.argmax(np.triu(self.a).any(axis=1)))
            raise self._error(f"row {row} of a has entries on or right of the diagonal: the method is not explicit")
        off = np.abs(self.a.sum(axis=1) - self.c)
        if off.max() > _TOLERANCE:
            row = int(np.argmax(off))
            raise self._error(f"row {row} of a sums to {self.a[row].sum():.16g}, but c[{row}] is {self.c[row]:.16g}")
        self._check_solution("order", "b")
        for order, weights in (("embedded_order", "b_embedded"), ("second_embedded_order", "b_second_embedded")):
            if (getattr(self, order) is None) != (getattr(self, weights) is None):
                raise self._error(f"a pair needs both {order} and {weights}")
            if getattr(self, order) is not None:
                self._check_solution(order, weights)
        if self.b_second_embedded is not None and self.b_embedded is None:
            raise self._error("a second embedded solution needs a first one")
        n = int(np.flatnonzero(b)[-1]) + 1
        self._set(counted=Rows(self.a[:n, :n], self.c[:n]))

    @property
    def to_the_end(self) -> Rows:
        """All stages, and as the last one the end of the step: the tableau's own where it has one, else one more."""
        if self.b[-1] == 0.0 and np.array_equal(self.a[-1], self.b):
            return Rows(self.a, self.c)
        wider = np.pad(np.vstack([self.a, self.b]), ((0, 0), (0, 1)))
        return Rows(wider, np.append(self.c, 1.0))

    @property
    def is_pair(self) -> bool:
        """Whether the method estimates its own error."""
        return self.b_embedded is not None

    @property
    def error_order(self) -> int:
        """The power of the step with which the estimated error of one step falls.

        With two embedded solutions the estimate is e1^2 / sqrt(e1^2 + e2^2 / 100), as in the program DOP853.

        Raises:
            ModelError: the method has no embedded solution.
        """
        if self.embedded_order is None:
            raise self._error("the method has no embedded solution, so it cannot choose its own steps")
        if self.second_embedded_order is None:
            return self.embedded_order + 1
        return 2 * (self.embedded_order + 1) - (self.second_embedded_order + 1)

    def _check_solution(self, order: str, weights: str) -> None:
        self._check_order(order)
        total = self._read(weights, self.b.shape).sum()
        if abs(total - 1.0) > _TOLERANCE:
            raise self._error(f"{weights} must sum to 1, it sums to {total:.16g}")


def lower_triangle(rows: Sequence[Any]) -> NDArray[Any]:
    """The square matrix a of the rows below its first one: row i + 1 has entries 0 to i, and the rest is zero."""
    a = np.zeros((len(rows) + 1, len(rows) + 1))
    for i, row in enumerate(rows, start=1):
        a[i, :i] = row
    return a


#: Euler's method.
EULER = ButcherTableau("Euler", 1, a=[[0.0]], b=[1.0], c=[0.0])

#: Heun's method of order 2, the explicit trapezoidal rule.
HEUN = ButcherTableau("Heun", 2, a=[[0.0, 0.0], [1.0, 0.0]], b=[0.5, 0.5], c=[0.0, 1.0])

#: The pair 3(2) of Bogacki and Shampine; its last stage is the first of the next step.
#: Source: Bogacki, Shampine, A 3(2) pair of Runge-Kutta formulas, Applied Mathematics Letters 2 (1989).
BOGACKI_SHAMPINE3 = ButcherTableau(
    "Bogacki-Shampine 3(2)",
    3,
    a=lower_triangle([[1 / 2], [0, 3 / 4], [2 / 9, 1 / 3, 4 / 9]]),
    b=[2 / 9, 1 / 3, 4 / 9, 0],
    c=[0, 1 / 2, 3 / 4, 1],
    embedded_order=2,
    b_embedded=[7 / 24, 1 / 4, 1 / 3, 1 / 8],
)

#: The classical method of Runge and Kutta.
#: Source: Hairer, Norsett, Wanner, Solving Ordinary Differential Equations I (1993), section II.1.
RK4 = ButcherTableau(
    "RK4", 4, a=lower_triangle([[1 / 2], [0, 1 / 2], [0, 0, 1]]), b=[1 / 6, 1 / 3, 1 / 3, 1 / 6], c=[0, 1 / 2, 1 / 2, 1]
)

# fmt: off
#: The pair 5(4) of Dormand and Prince; its last stage is the first of the next step.
#: Source: Hairer, Norsett, Wanner, Solving Ordinary Differential Equations I (1993), table II.5.2.
DORMAND_PRINCE5 = ButcherTableau(
    "Dormand-Prince 5(4)",
    5,
    a=lower_triangle(
        [[1 / 5], [3 / 40, 9 / 40], [44 / 45, -56 / 15, 32 / 9],
         [19372 / 6561, -25360 / 2187, 64448 / 6561, -212 / 729],
         [9017 / 3168, -355 / 33, 46732 / 5247, 49 / 176, -5103 / 18656],
         [35 / 384, 0, 500 / 1113, 125 / 192, -2187 / 6784, 11 / 84]]
    ),
    b=[35 / 384, 0, 500 / 1113, 125 / 192, -2187 / 6784, 11 / 84, 0],
    c=[0, 1 / 5, 3 / 10, 4 / 5, 8 / 9, 1, 1],
    embedded_order=4,
    b_embedded=[5179 / 57600, 0, 7571 / 16695, 393 / 640, -92097 / 339200, 187 / 2100, 1 / 40],
)

#: The pair 5(4) of Tsitouras; its last stage is the first of the next step.
#: Source: Tsitouras, Runge-Kutta pairs of order 5(4) satisfying only the first column simplifying assumption,
#: Computers and Mathematics with Applications 62 (2011), table 1, to double precision.
TSIT5 = ButcherTableau(
    "Tsitouras 5(4)",
    5,
    a=lower_triangle(
        [[0.161], [-0.008480655492356989, 0.335480655492357],
         [2.8971530571054935, -6.359448489975075, 4.3622954328695815],
         [5.325864828439257, -11.748883564062828, 7.4955393428898365, -0.09249506636175525],
         [5.86145544294642, -12.92096931784711, 8.159367898576159, -0.071584973281401, -0.028269050394068383],
         [0.09646076681806523, 0.01, 0.4798896504144996, 1.379008574103742, -3.290069515436081, 2.324710524099774]]
    ),
    b=[0.09646076681806523, 0.01, 0.4798896504144996, 1.379008574103742, -3.290069515436081, 2.324710524099774, 0],
    c=[0, 0.161, 0.327, 0.9, 0.9800255409045097, 1, 1],
    embedded_order=4,
    b_embedded=[0.09468075576583945, 0.009183565540343254, 0.4877705284247616, 1.234297566930479, -2.7077123499835256,
                1.866628418170587, 0.015151515151515152],
)

#: DOP853: order 8 with estimates of order 5 and 3, the second of which keeps the first from being too hopeful.
#: Source: Hairer, Norsett, Wanner, Solving Ordinary Differential Equations I (1993), section II.5 and program DOP853,
#: to double precision.
DOP853 = ButcherTableau(
    "DOP853",
    8,
    a=lower_triangle(
        [
            [0.05260015195876773],
            [0.0197250569845379, 0.0591751709536137],
            [0.02958758547680685, 0, 0.08876275643042054],
            [0.2413651341592667, 0, -0.8845494793282861, 0.924834003261792],
            [1 / 27, 0, 0, 0.17082860872947386, 0.12546768756682242],
            [0.037109375, 0, 0, 0.17025221101954405, 0.06021653898045596, -0.017578125],
            [0.03709200011850479, 0, 0, 0.17038392571223998, 0.10726203044637328, -0.015319437748624402,
             0.008273789163814023],
            [0.6241109587160757, 0, 0, -3.3608926294469414, -0.868219346841726, 27.59209969944671, 20.154067550477894,
             -43.48988418106996],
            [0.47766253643826434, 0, 0, -2.4881146199716677, -0.590290826836843, 21.230051448181193,
             15.279233632882423, -33.28821096898486, -0.020331201708508627],
            [-0.9371424300859873, 0, 0, 5.186372428844064, 1.0914373489967295, -8.149787010746927, -18.52006565999696,
             22.739487099350505, 2.4936055526796523, -3.0467644718982196],
            [2.273310147516538, 0, 0, -10.53449546673725, -2.0008720582248625, -17.9589318631188, 27.94888452941996,
             -2.8589982771350235, -8.87285693353063, 12.360567175794303, 0.6433927460157636],
        ]
    ),
    b=[0.054293734116568765, 0, 0, 0, 0, 4.450312892752409, 1.8915178993145003, -5.801203960010585,
       0.3111643669578199, -0.1521609496625161, 0.20136540080403034, 0.04471061572777259],
    c=[0, 0.05260015195876773, 0.0789002279381516, 0.1183503419072274, 0.2816496580927726, 1 / 3, 1 / 4, 4 / 13,
       127 / 195, 3 / 5, 6 / 7, 1],
    embedded_order=5,
    b_embedded=[0.04117368912237389, 0, 0, 0, 0, 5.675469339128614, 2.3872768489717506, -7.465581142465571,
                0.6614932157077935, -0.48634006837553356, 0.11944219431891463, 0.06706592359165889],
    second_embedded_order=3,
    b_second_embedded=[0.2440944881889764, 0, 0, 0, 0, 0, 0, 0, 0.7338466882816118, 0, 0, 0.022058823529411766],
)

#: The pair 8(7) of Prince and Dormand with thirteen stages, RK8(7)13M.
#: Source: Prince, Dormand, High order embedded Runge-Kutta formulae, Journal of Computational and Applied Mathematics 7
#: (1981), table 2.
DORMAND_PRINCE8 = ButcherTableau(
    "Dormand-Prince 8(7)",
    8,
    a=lower_triangle(
        [
            [1 / 18],
            [1 / 48, 1 / 16],
            [1 / 32, 0, 3 / 32],
            [5 / 16, 0, -75 / 64, 75 / 64],
            [3 / 80, 0, 0, 3 / 16, 3 / 20],
            [29443841 / 614563906, 0, 0, 77736538 / 692538347, -28693883 / 1125000000, 23124283 / 1800000000],
            [16016141 / 946692911, 0, 0, 61564180 / 158732637, 22789713 / 633445777, 545815736 / 2771057229,
             -180193667 / 1043307555],
            [39632708 / 573591083, 0, 0, -433636366 / 683701615, -421739975 / 2616292301, 100302831 / 723423059,
             790204164 / 839813087, 800635310 / 3783071287],
            [246121993 / 1340847787, 0, 0, -37695042795 / 15268766246, -309121744 / 1061227803, -12992083 / 490766935,
             6005943493 / 2108947869, 393006217 / 1396673457, 123872331 / 1001029789],
            [-1028468189 / 846180014, 0, 0, 8478235783 / 508512852, 1311729495 / 1432422823,
             -10304129995 / 1701304382, -48777925059 / 3047939560, 15336726248 / 1032824649,
             -45442868181 / 3398467696, 3065993473 / 597172653],
            [185892177 / 718116043, 0, 0, -3185094517 / 667107341, -477755414 / 1098053517, -703635378 / 230739211,
             5731566787 / 1027545527, 5232866602 / 850066563, -4093664535 / 808688257, 3962137247 / 1805957418,
             65686358 / 487910083],
            [403863854 / 491063109, 0, 0, -5068492393 / 434740067, -411421997 / 543043805, 652783627 / 914296604,
             11173962825 / 925320556, -13158990841 / 6184727034, 3936647629 / 1978049680, -160528059 / 685178525,
             248638103 / 1413531060, 0],
        ]
    ),
    b=[14005451 / 335480064, 0, 0, 0, 0, -59238493 / 1068277825, 181606767 / 758867731, 561292985 / 797845732,
       -1041891430 / 1371343529, 760417239 / 1151165299, 118820643 / 751138087, -528747749 / 2220607170, 1 / 4],
    c=[0, 1 / 18, 1 / 12, 1 / 8, 5 / 16, 3 / 8, 59 / 400, 93 / 200, 5490023248 / 9719169821, 13 / 20,
       1201146811 / 1299019798, 1, 1],
    embedded_order=7,
    b_embedded=[13451932 / 455176623, 0, 0, 0, 0, -808719846 / 976000145, 1757004468 / 5645159321,
                656045339 / 265891186, -3867574721 / 1518517206, 465885868 / 322736535, 53011238 / 667516719, 2 / 45,
                0],
)
# fmt: on

#: Every explicit tableau, by order.
ALL: tuple[ButcherTableau, ...] = (EULER, HEUN, BOGACKI_SHAMPINE3, RK4, DORMAND_PRINCE5, TSIT5, DOP853, DORMAND_PRINCE8)
