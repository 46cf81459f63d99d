# tx.trajectory.TrajectoryResult tx.trajectory.Status
x, v, u = tx.State("x"), tx.State("v"), tx.Control("u", min=-1.0, max=1.0)
car = tx.compile(tx.System(rates={x: v, v: u}))
problem = tx.trajectory.Problem(
    car, tx.Minimize(running=u**2), nodes=11, final_time=4.0, initial={x: 0.0, v: 0.0}, final={x: 1.0, v: 0.0}
)
result = problem.solve()
result.status, result.cost

# tx.trajectory.WarmStart
result = problem.solve(warm=result.warm)
result.iterations

# tx.trajectory.Optimality tx.trajectory.Accuracy
result.optimality, result.accuracy.change

# tx.trajectory.Meshed
[(mesh.nodes, mesh.error) for mesh in problem.solve(refine=1e-2).meshes]

# tx.trajectory.TrajectoryResults
many = problem.solve_many(initial={x: np.array([0.0, 0.2, 0.4])})
many.cost

# tx.trajectory.Progress
problem.solve(progress=tx.trajectory.Progress(cost="effort {:.3f}", shown=False)).status

# tx.trajectory.Contact tx.trajectory.Friction
height, fall, slide = tx.State("height"), tx.State("fall"), tx.State("slide")
normal, drag = tx.Control("normal", min=0.0), tx.Control("drag")
ground = tx.trajectory.Contact(height, normal, tx.trajectory.Friction(0.3, force=drag, velocity=slide))
list(tx.System({height: fall, fall: normal - 9.81, slide: drag}, constraints={"ground": ground}).constraints)

# tx.trajectory.Strategy
problem.solve(strategies=[tx.trajectory.Strategy.RESCALING]).status

# tx.trajectory.Solution
optimum = tx.trajectory.solution(problem)
optimum().cost

# tx.trajectory.Objective
objective = tx.Minimize(x**2, running=u**2)  # of the end, and along the way
isinstance(objective, tx.trajectory.Objective)

# tx.trajectory.Minimum tx.trajectory.Maximum
tx.Minimize(tx.trajectory.Maximum(tx.Abs(u)))

# tx.trajectory.Rate tx.trajectory.Spline
tx.trajectory.Problem(
    car,
    tx.Minimize(running=tx.trajectory.Rate(u) ** 2),
    nodes=11,
    final_time=4.0,
    initial={x: 0.0, v: 0.0},
    final={x: 1.0, v: 0.0},
    controls={u: tx.trajectory.Spline(degree=2)},
).solve().cost

# tx.trajectory.Held
tx.trajectory.Problem(
    car,
    tx.Minimize(running=u**2),
    nodes=11,
    final_time=4.0,
    initial={x: 0.0},
    final={x: 1.0},
    controls={u: tx.trajectory.Held()},
)

# tx.trajectory.Collocation tx.trajectory.MultipleShooting
[
    tx.trajectory.Collocation(tx.tableaus.RADAU_IIA5),
    tx.trajectory.MultipleShooting(tx.RKMK(tx.tableaus.RK4), substeps=2),
]

# tx.trajectory.GaussNewton tx.trajectory.QuasiNewton
tx.trajectory.Problem(
    car,
    tx.Minimize(running=u**2),
    nodes=11,
    final_time=4.0,
    initial={x: 0.0},
    final={x: 1.0},
    hessian=tx.trajectory.GaussNewton(),
).solve().status

# tx.trajectory.IPOPT tx.trajectory.Fatrop
solver = tx.trajectory.IPOPT({"tol": 1e-8})  # problem.solve(solver=solver)
solver

# tx.trajectory.Discretization tx.trajectory.Linearization
tx.trajectory.linearize(car, 0.0, {"x": 0.0, "v": 0.0}, {"u": 0.0}).A

# tx.trajectory.PhasedResult tx.trajectory.PhasedResults
phases = [
    tx.trajectory.Phase(car, name="push", nodes=8, final_time=2.0, initial={x: 0.0, v: 0.0}),
    tx.trajectory.Phase(car, tx.Minimize(running=u**2), name="brake", nodes=8, final_time=2.0, final={x: 1.0, v: 0.0}),
]
tx.trajectory.Problem(phases).solve().durations

# tx.trajectory.Controller
regulator = tx.trajectory.Problem(
    car,
    tx.Minimize(10.0 * (x**2 + v**2), running=x**2 + v**2 + 0.1 * u**2),
    nodes=21,
    final_time=2.0,
    initial={x: 1.0, v: 0.0},
)
controller = regulator.controller(max_iterations=2)
controller.feedback({"x": 0.9, "v": -0.1})  # the controls of the first interval
controller.shift()  # an interval of the plan has passed
controller.feedback({"x": 0.885, "v": -0.2})

# tx.trajectory.exciting_problem
from twistax.mechanics import Chain, Drive, Link, SpatialInertia, joints

rod = SpatialInertia(mass=2.0, center_of_mass=(0.2, 0.0, 0.0), inertia=0.05 * np.eye(3))
hinge = Link(joints.Revolute("hinge", (0.0, 1.0, 0.0)), rod, np.eye(4), drive=Drive(speed=3.0, effort=10.0))
exciting = tx.trajectory.exciting_problem(Chain([hinge]), period=3.0, harmonics=2)
exciting.params["coefficients"]  # of the guess; exciting.solve(max_iterations=100) finds better ones

# tx.trajectory.ControllerLog tx.trajectory.StepRecord
log = controller.log
len(log), log.iterations, log[-1].status
