# tx.estimation.UnscentedKalman tx.estimation.FilterRun
p, v = tx.State("p"), tx.State("v")  # m, m/s
cart = tx.compile(tx.System(rates={p: v, v: tx.Noise("gusts", density=0.1)}))  # m/s2 per sqrt(Hz)
ranging = tx.Measurement("range", p, covariance=0.2**2)  # m2
kalman = tx.estimation.UnscentedKalman(cart, [ranging])
ts = np.arange(5.0)
run = kalman.run({"range": (ts, [0.1, 1.2, 1.9, 3.1, 4.0])}, {"p": 0.0, "v": 0.0}, P0=1.0)
run.xs["v"][-1], run.deviations()["v"][-1]

# tx.estimation.Filter
kalmans = [tx.estimation.ErrorStateKalman(cart, [ranging]), kalman]  # both have predict, update and run
[isinstance(one, tx.estimation.Filter) for one in kalmans]

# tx.estimation.Prediction
prediction = kalman.predict(0.0, {"p": 0.0, "v": 1.0}, np.diag([0.04, 0.01]), h=0.5)
prediction.x["p"], prediction.P, prediction.transition

# tx.estimation.Update
update = kalman.update("range", 0.5, prediction.x, prediction.P, 0.7)
update.x, update.residual, update.nis

# tx.estimation.Estimate
estimate = tx.estimation.Estimate(update.x, update.P)
estimate.x["p"], estimate.P

# tx.estimation.Innovations
innovations = run.innovations["range"]
innovations.residual[:, 0], innovations.nis, innovations.used

# tx.estimation.RauchTungStriebel tx.estimation.Smoothed
smoothed = run.smooth()  # by RauchTungStriebel().smooth
run.P[0, 1, 1], smoothed.P[0, 1, 1]  # of the speed at the start, before and after later ranges count

# tx.estimation.Observability
run.observability().rank, run.observability().unobservable

# tx.estimation.consistency tx.estimation.Consistency tx.estimation.Verdict
errors = 0.3 * np.random.default_rng(0).normal(size=(200, 50))  # of 200 runs at 50 times
print(tx.estimation.consistency(errors**2 / 0.3**2, freedom=1))  # the covariance is that of the errors
verdict = tx.estimation.consistency(errors**2 / 0.2**2, freedom=1).verdict  # the filter claims less than there is
verdict

# tx.estimation.SquareRootKalman
single = tx.estimation.SquareRootKalman(cart, [ranging])
run = single.run({"range": (ts, [0.1, 1.2, 1.9, 3.1, 4.0])}, {"p": np.float32(0.0), "v": np.float32(0.0)}, P0=1e4)
run.P.dtype, run.deviations()["v"][-1]

# tx.estimation.InvariantKalman tx.estimation.Invariance tx.estimation.GroupAffinity tx.estimation.group_affinity
R = tx.State("R", group=tx.SO3)
gyro = tx.Control("gyro", shape=(3,)) + tx.Noise("n", shape=(3,), density=1e-3)
attitude = tx.compile(tx.System(rates={R: gyro}))
field = tx.Measurement("field", R.T @ np.array([0.3, 0.0, 0.9]), covariance=1e-4)
kalman = tx.estimation.InvariantKalman(attitude, [field], invariance=tx.estimation.Invariance.RIGHT)
print(kalman.affinity())
print(tx.estimation.group_affinity(tx.compile(tx.System(rates={p: -(p**2)}))))

# tx.estimation.Preintegration tx.estimation.PreintegratedImu tx.estimation.InertialState
imu = tx.estimation.Preintegration(gyro=2e-4, accelerometer=2e-3)
rates, forces = np.tile([0.0, 0.0, 0.5], (100, 1)), np.tile([0.1, 0.0, 9.81], (100, 1))  # rad/s, m/s2
relative = imu.integrate(rates, forces, 0.01)  # one second
start = tx.estimation.InertialState(np.eye(3), np.zeros(3), np.zeros(3))
end = relative.predict(start, gravity=np.array([0.0, 0.0, -9.81]))
end.position, relative.corrected(np.array([0.0, 0.0, 0.01, 0.0, 0.0, 0.0])).rotation

# tx.estimation.PreintegratedNavigation
navigation = tx.estimation.PreintegratedNavigation(imu, gravity=[0.0, 0.0, -9.81])
fixes = tx.Measurement("fixes", navigation.position, covariance=1.0)
inertial = tx.estimation.ErrorStateKalman(navigation, [fixes])
held = {
    "gyro": tx.ZeroOrderHold([0.0], [[0.0, 0.0, 0.5]]),
    "accelerometer": tx.ZeroOrderHold([0.0], [[0.0, 0.0, 9.81]]),
}
at_rest = {"rotation": np.eye(3), **{name: np.zeros(3) for name in ("velocity", "position")}}
at_rest |= {name: np.zeros(3) for name in ("gyro_bias", "accelerometer_bias")}
inertial.run({"fixes": ([0.0, 1.0], np.zeros((2, 3)))}, at_rest, P0=0.1, u=held).xs["rotation"][-1]

# tx.estimation.allan tx.estimation.AllanVariance
rng = np.random.default_rng(0)
rates = 2e-3 / np.sqrt(0.01) * rng.normal(size=100_000) + 5e-4 * np.sqrt(0.01) * rng.normal(size=100_000).cumsum()
variance = tx.estimation.allan(rates, 0.01)
variance.density, variance.walk  # of the white noise and of the Noise that drives the bias

# tx.estimation.FixedLagSmoother
lagged = run.smooth(tx.estimation.FixedLagSmoother(lag=2))
lagged.xs["v"]

# tx.estimation.BatchSmoother tx.estimation.BatchEstimate tx.estimation.HuberLoss tx.estimation.CauchyLoss
losses = {"range": tx.estimation.HuberLoss()}  # or CauchyLoss()
batch = tx.estimation.BatchSmoother(cart, [ranging], losses=losses)
estimate = batch.run({"range": (ts, [0.1, 1.2, 9.0, 3.1, 4.0])}, {"p": 0.0, "v": 0.0}, P0=1.0)
estimate.xs["p"], estimate.weights["range"]  # the third range hardly counts

# tx.estimation.RobustLoss
isinstance(tx.estimation.CauchyLoss(2.0), tx.estimation.RobustLoss)

# tx.estimation.Trapezoidal tx.estimation.VanLoan
rules = [tx.estimation.VanLoan(), tx.estimation.Trapezoidal()]
filters = [tx.estimation.ErrorStateKalman(cart, [ranging], noise=rule) for rule in rules]
[one.predict(0.0, {"p": 0.0, "v": 0.0}, 0.0, h=0.1).P[0, 0] for one in filters]  # h^3 / 3 and h^3 / 2

# tx.estimation.NoiseDiscretization
all(isinstance(rule, tx.estimation.NoiseDiscretization) for rule in rules)

# tx.fit tx.estimation.Experiment tx.estimation.ParameterEstimate
mass = tx.Parameter("mass", value=1.0)  # kg
pushed = tx.compile(tx.System(rates={p: v, v: 2.0 / mass}))
experiment = tx.estimation.Experiment({"range": (ts, 0.7 * ts**2)}, x0={"p": 0.0, "v": 0.0}, P0=0.0)
fitted = tx.fit(pushed, experiment, free={mass: (0.1, 10.0)}, measurements=[ranging], segments=1)
fitted.result, fitted.params["mass"], fitted.deviations()["mass"]

# tx.estimation.Combination
[(one.name, one.value, one.deviation) for one in fitted.combinations]

# tx.estimation.MaximumLikelihood
likely = tx.estimation.MaximumLikelihood(pushed, [ranging], free=["mass"], segments=1)
likely.run(experiment).params["mass"]
