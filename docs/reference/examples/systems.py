# tx.Order
tx.LINEAR_FIRST, tx.ANGULAR_FIRST

# tx.Product
two = tx.Product({"g": tx.SE3, "h": tx.SO3})
two

# tx.tangent_grad
T = tx.pose(position=[0.0, 0.0, 1.0])
tx.tangent_grad(lambda pose: pose[2, 3])(T)  # (6,): the height rises along the body's z

# tx.JAX
x = tx.State("x")
tx.compile(tx.System(rates={x: -x}), backend=tx.JAX()).backend

# tx.Dynamics
x = tx.State("x")
decay = tx.compile(tx.System(rates={x: -x}))
decay(0.0, {"x": 2.0}, {})

# tx.Trim tx.Mode
x, v, u = tx.State("x"), tx.State("v"), tx.Control("u")
spring = tx.compile(tx.System(rates={x: v, v: u - 4.0 * x - 0.4 * v}))
steady = tx.trim(spring, {"x": 1.0, "v": 0.0}, u={"u": 0.0}, free=["u"], zero=["v"])
steady.u, [mode.eigenvalue for mode in steady.linearize().modes()]

# tx.Sweep tx.Statistics
x, rate = tx.State("x"), tx.Parameter("rate", value=1.0)
decay = tx.compile(tx.System(rates={x: -rate * x}))


def run(rate):
    solution = tx.integrate(decay, {"x": 1.0}, t1=1.0, dt=0.1, params={"rate": rate})
    return solution, {"end": solution.xs["x"][-1]}


runs = tx.sweep(run, lambda key: 1.0 + 0.1 * jax.random.normal(key), count=20, seed=0)
runs.statistics

# tx.TwistaxError tx.InputError
x = tx.State("x")
decay = tx.compile(tx.System(rates={x: -x}))
try:
    decay(0.0, {"y": 1.0}, {})
except tx.InputError as error:
    print(error)

# tx.ShapeError
try:
    (tx.State("x", shape=(3,)) @ tx.State("y", shape=(2,))).shape
except tx.ShapeError as error:
    print(error)

# tx.ModelError
try:
    tx.System(rates={})
except tx.ModelError as error:
    print(error)

# tx.OperationError
try:
    tx.State("x", shape=(3,)).mean()
except tx.OperationError as error:
    print(error)

# tx.OrderError
V, U = tx.State("V", shape=(6,)), tx.State("U", shape=(6,))
momentum = tx.lie.AdjointDual(V, U)  # [v; w]
try:
    tx.System(rates={V: momentum, U: tx.lie.Adjoint(momentum, V, order=tx.ANGULAR_FIRST)})
except tx.OrderError as error:
    print(error)

# tx.ImmutableError
try:
    tx.State("x").name = "y"
except tx.ImmutableError as error:
    print(error)

# tx.IntegrationError
x = tx.State("x")
blow_up = tx.compile(tx.System(rates={x: x**2}))
try:
    tx.integrate(blow_up, {"x": 1.0}, t1=2.0, rtol=1e-5)
except tx.IntegrationError as error:
    print(error)

# tx.TrajectoryError
try:
    tx.trajectory.MultipleShooting(tx.tableaus.RK4)
except tx.TrajectoryError as error:
    print(error)

# tx.units.Quantity
from twistax.units import feet, seconds

speed = 300.0 * feet / seconds
float(speed), speed  # in m/s

# tx.units.same_unit tx.units.taken
from twistax import units

units.taken("my_function: height", 100.0 * units.feet, units.metres)
