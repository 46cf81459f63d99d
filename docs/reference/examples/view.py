# tx.view.Shape tx.view.Capsule tx.view.Ellipsoid
arm = tx.view.Capsule(radius=0.05, length=0.4, at=(0.0, 0.0, 0.2), color=(220, 120, 40))
body = tx.view.Ellipsoid((0.3, 0.2, 0.1), opacity=0.5)
[arm, body]

# tx.view.Scene tx.view.Body
g, V = tx.State("g", group=tx.SE3), tx.State("V", shape=(6,))
drift = tx.compile(tx.System(rates={g: V, V: 0.0 * V}))
start = {"g": tx.pose(), "V": [1.0, 0.0, 0.0, 0.0, 0.0, 1.0]}
solution = tx.integrate(drift, start, t1=2.0, dt=0.1, save_at=np.linspace(0.0, 2.0, 21))
scene = solution.show("drift.html", bodies={"g": tx.view.Box((0.4, 0.2, 0.1))})
[body.name for body in scene.bodies], scene.duration

# tx.view.Mesh
corners = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]])  # m
wedge = tx.view.Mesh((corners, [[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]]))
hull = tx.view.Mesh("hull.stl", scale=0.001)  # a file in mm, read when it is drawn
wedge.mesh()[1].shape

# tx.testing.check_gradients
x, v = tx.State("x"), tx.State("v")
pendulum = tx.compile(tx.System(rates={x: v, v: -9.81 * tx.Sin(x)}))


def end(start):
    return tx.integrate(pendulum, start, t1=1.0, dt=0.1).last


tx.testing.check_gradients(end, {"x": 0.3, "v": 0.0})  # raises LawError if a derivative is wrong

# tx.testing.LawError
try:
    tx.testing.check_tableau(tx.tableaus.ButcherTableau("wrong", 2, [[0.0, 0.0], [1.0, 0.0]], [0.5, 0.5], [0.0, 1.0]))
except tx.testing.LawError as error:
    print(error)
