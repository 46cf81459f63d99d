# tx.CommutatorFree tx.tableaus.CommutatorFreeTableau
R, w = tx.State("R", group=tx.SO3), tx.State("w", shape=(3,))
spin = tx.compile(tx.System(rates={R: w, w: -0.1 * w}))
start = {"R": np.eye(3), "w": [0.0, 0.0, 1.0]}
tx.integrate(spin, start, t1=1.0, dt=0.1, method=tx.CommutatorFree(tx.tableaus.CF4)).xs["R"][-1]

# tx.tableaus.CollocationTableau
tx.tableaus.RADAU_IIA5

# tx.FreeParticle tx.compositions.Composition
p, v = tx.State("p"), tx.State("v")
pendulum = tx.compile(tx.System(rates={p: v, v: -tx.Sin(p)}))
method = tx.Splitting(tx.compositions.STRANG, tx.FreeParticle(p, v))
tx.integrate(pendulum, {"p": 1.0, "v": 0.0}, t1=1.0, dt=0.1, method=method).xs["p"][-1]

# tx.Solution tx.Result
x = tx.State("x")
decay = tx.compile(tx.System(rates={x: -x}))
solution = tx.integrate(decay, {"x": 1.0}, t1=2.0, dt=0.1, save_at=[0.0, 1.0, 2.0])
solution.xs["x"], solution.result

# tx.Crossings
x, v = tx.State("x"), tx.State("v")
swing = tx.compile(tx.System(rates={x: v, v: -x}))
zero = tx.Event(x, terminal=False)
tx.integrate(swing, {"x": 1.0, "v": 0.0}, t1=7.0, rtol=1e-5, event=zero, max_crossings=4).crossings.ts

# tx.StepControl
x = tx.State("x")
decay = tx.compile(tx.System(rates={x: -x}))
control = tx.StepControl(dtmax=0.5, max_steps=1000)
tx.integrate(decay, {"x": 1.0}, t1=2.0, rtol=1e-5, control=control).stats

# tx.PiecewisePolynomial
x, u = tx.State("x"), tx.Control("u")
pushed = tx.compile(tx.System(rates={x: u}))
ramp = tx.PiecewisePolynomial([0.0, 1.0], [[0.0, 2.0], [2.0, 0.0]])  # 2 t, then 2
tx.integrate(pushed, {"x": 0.0}, t1=2.0, dt=0.1, u={"u": ramp}).xs["x"][-1]

# tx.PhasedSolution
x = tx.State("x")
up, down = (tx.compile(tx.System(rates={x: rate + 0.0 * x})) for rate in (1.0, -1.0))
phases = [tx.Phase(up, duration=1.0), tx.Phase(down, duration=2.0)]
tx.integrate_phases(phases, {"x": 0.0}, dt=0.1).phases[-1].xs["x"][-1]

# tx.Simulator
x = tx.State("x")
decay = tx.compile(tx.System(rates={x: -x}))
simulate = tx.simulator(decay, {"x": 1.0}, t1=1.0, dt=0.1)
simulate({"x": 3.0}).xs["x"][-1]

# tx.charts.Chart tx.charts.Coordinates tx.charts.Ambient tx.charts.SplitExponential
[tx.RKMK(tx.tableaus.RK4, chart) for chart in (tx.charts.Ambient(), tx.charts.SplitExponential())]

# tx.columns.Layout tx.columns.Rotations tx.columns.Column
R, w = tx.State("R", group=tx.SO3), tx.State("w", shape=(3,))
spin = tx.compile(tx.System(rates={R: w, w: -0.1 * w}))
solution = tx.integrate(spin, {"R": np.eye(3), "w": [0.0, 0.0, 1.0]}, t1=1.0, dt=0.1, save_at=[0.0, 1.0])
layout = tx.columns.Columns(units={"w": "rad/s"}, rotations=tx.columns.EULER)
[f"{column.name} [{column.unit}]" for column in layout.columns(solution)]

# tx.diffrax.LieTerm tx.diffrax.LieController
x = tx.State("x")
decay = tx.compile(tx.System(rates={x: -x}))
term, control = tx.diffrax.lie_term(decay), tx.diffrax.controller(rtol=1e-5, atol=1e-8)
type(term).__name__, type(control).__name__

# tx.diffrax.AmbientTerm tx.diffrax.ambient_term
g, V = tx.State("g", group=tx.SE3), tx.State("V", shape=(6,))
body = tx.compile(tx.System(rates={g: V, V: 0.0 * V}))
term = tx.diffrax.ambient_term(body)
term.to_ambient({"g": tx.pose(), "V": np.ones(6)})  # quaternion and position
