# tx.Add tx.Mul tx.Power
a, b = tx.State("a"), tx.State("b")
type(a + b).__name__, type(a * b).__name__, type(a**2).__name__

# tx.Bilerp
x, y = tx.State("x"), tx.State("y")
tx.Bilerp(x, y, [0.0, 1.0], [0.0, 1.0], [[0.0, 1.0], [2.0, 3.0]])

# tx.Linterp
height = tx.State("height")
density = tx.Linterp(height, [0.0, 1000.0, 2000.0], [1.225, 1.112, 1.007])
tx.lower(density)(0.0, {"height": 500.0}, {})

# tx.Constraint tx.Inequality tx.Equality
F = tx.Control("F", shape=(3,))
[type(constraint).__name__ for constraint in (tx.linalg.Norm(F) <= 10.0, F[2] == 0.0)]

# tx.Less
x = tx.State("x")
tx.Where(x < 0.0, -x, x)

# tx.Hstack tx.Stack
p, q = tx.State("p", shape=(3,)), tx.State("q", shape=(3,))
tx.Hstack(p, q).shape, tx.Stack(p, q).shape

# tx.Expr tx.to_expr
x = tx.State("x")
isinstance(x + 1.0, tx.Expr), tx.to_expr(2.0)

# tx.Leaf tx.Variable
[isinstance(tx.State("x"), kind) for kind in (tx.Leaf, tx.Variable)], isinstance(tx.Time(), tx.Variable)

# tx.Example
case = tx.Abs.example()[0]
case.expr, case.values, case.smooth

# tx.Rate
x, v = tx.State("x"), tx.State("v")
tx.Rate(x**2, {x: v})

# tx.Soft
p = tx.State("p", shape=(2,))
tx.Soft(tx.linalg.Norm(p) >= 1.0, l1=100.0)  # may be violated, at 100 a unit of length

# tx.Vmap
p = tx.State("p", shape=(2,))
posts = np.array([[0.0, 1.0], [2.0, 0.0]])
tx.Vmap(lambda post: tx.linalg.Norm(p - post), batch=posts).shape

# tx.tables.Linear tx.tables.MonotoneCubic tx.tables.Extrapolated
height = tx.State("height")
density = tx.Interp(
    height,
    axes=[[0.0, 1000.0, 2000.0]],
    values=[1.225, 1.112, 1.007],
    kind=tx.tables.MonotoneCubic(),
    outside=[tx.tables.Extrapolated()],
)
tx.lower(density)(0.0, {"height": 2500.0}, {})

# tx.Momentum
h = tx.State("h", (6,), kind=tx.Momentum("body"))  # N s and N m s
V = tx.State("V", (6,), kind=tx.Twist("body"))
try:
    tx.System(rates={h: V, V: np.zeros(6)})  # the rate of a momentum is a wrench
except tx.KindError as error:
    print(error)

# tx.Point
p = tx.State("p", (3,), kind=tx.Point("world"))  # m
v = tx.Control("v", (3,), kind=tx.FreeVector("body"), unit="m/s")
try:
    tx.System(rates={p: v})  # without the rotation from body to world
except tx.KindError as error:
    print(error)

# tx.kinds.Kind
[isinstance(kind, tx.kinds.Kind) for kind in (tx.Point("world"), tx.Wrench("body"))], tx.Point("world").frame

# tx.kinds.Unit
newton_metre = tx.kinds.Unit.of("N m")
newton_metre, newton_metre == tx.kinds.Unit.of("J"), newton_metre / tx.kinds.Unit.of("s")

# tx.kinds.declare
R, F = tx.State("R", group=tx.SO3), tx.Control("F", (3,))
in_body = tx.kinds.declare(R.T @ F, tx.FreeVector("body"), "N")
in_world = tx.kinds.declare(R @ in_body, tx.FreeVector("world"))
try:
    tx.System(rates={R: np.zeros(3)}, outputs={"f": in_body + in_world})
except tx.KindError as error:
    print(error)

# tx.kinds.FixedUnits
from twistax.expr.operations.elementwise import ElementwiseFunction


class Thinning(ElementwiseFunction):
    """The density of air over that at sea level, from the height in m."""

    function = staticmethod(lambda h: jnp.exp(-h / 8500.0))
    kinds = tx.kinds.FixedUnits(takes=(tx.kinds.Unit.of("m"),), gives=tx.kinds.Unit.of("1"))


speed = tx.State("speed", unit="m/s")
try:
    tx.System(rates={speed: Thinning(speed)})
except tx.KindError as error:
    print(error)

# tx.kinds.Rule
import dataclasses


@dataclasses.dataclass(frozen=True)
class Reciprocal(tx.kinds.Rule):
    """The unit of 1/x."""

    def unit(self, node, units, space):
        return None if units[0] is None else tx.kinds.Unit.of("1") / units[0]


class Inverse(ElementwiseFunction):
    function = staticmethod(lambda x: 1.0 / x)
    kinds = Reciprocal()


r = tx.State("r", unit="s")
try:
    tx.System(rates={r: Inverse(r)})  # 1/s, and the rate of a time has no unit
except tx.KindError as error:
    print(error)
