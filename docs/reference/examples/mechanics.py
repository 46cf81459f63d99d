# tx.mechanics.mass_matrix tx.mechanics.bias_forces tx.mechanics.coriolis_forces tx.mechanics.gravity_forces
from twistax import mechanics

arm = mechanics.chain_models.panda()
terms = {
    "M": mechanics.mass_matrix(arm),
    "b": mechanics.bias_forces(arm),
    "c": mechanics.coriolis_forces(arm),
    "g": mechanics.gravity_forces(arm),
}
values = tx.lower(terms)(0.0, {"q": 0.1 * np.arange(7.0), "qd": 0.1 * np.ones(7)}, {})
{name: value.shape for name, value in values.items()}

# tx.mechanics.kinetic_energy tx.mechanics.potential_energy
arm = tx.mechanics.chain_models.panda()
energy = tx.mechanics.kinetic_energy(arm) + tx.mechanics.potential_energy(arm)
tx.lower(energy)(0.0, {"q": np.zeros(7), "qd": np.ones(7)}, {})  # J

# tx.mechanics.center_of_mass tx.mechanics.total_mass tx.mechanics.centroidal_matrix
arm = tx.mechanics.chain_models.panda()
tx.lower(tx.mechanics.center_of_mass(arm))(0.0, {"q": np.zeros(7)}, {}), tx.mechanics.centroidal_matrix(arm).shape

# tx.mechanics.frame_twist tx.mechanics.frame_jacobian_rate
arm = tx.mechanics.chain_models.equal_links(2)
last = list(arm.frames)[-1]
tx.mechanics.frame_twist(arm, last).shape, tx.mechanics.frame_jacobian_rate(arm, last).shape

# tx.mechanics.forward_dynamics_derivatives tx.mechanics.inverse_dynamics_derivatives
arm = tx.mechanics.chain_models.equal_links(2)
[part.shape for part in tx.mechanics.inverse_dynamics_derivatives(arm)]

# tx.mechanics.closed_dynamics tx.mechanics.loops.PoseLoop tx.mechanics.loops.Loop tx.mechanics.loops.Metric
from twistax import mechanics
from twistax.mechanics import Link, Mechanism, SpatialInertia, joints, loops

rod = SpatialInertia(mass=1.0, center_of_mass=[0.5, 0.0, 0.0], inertia=np.diag([0.01, 0.1, 0.1]))
along, y = tx.pose(position=[1.0, 0.0, 0.0]), [0.0, 1.0, 0.0]
links = [
    Link(joints.Revolute("upper", y), rod, np.eye(4)),
    Link(joints.Revolute("lower", y), rod, along, parent="upper"),
    Link(joints.Fixed("tip"), None, along, parent="lower"),
    Link(joints.Prismatic("slider", [1.0, 0.0, 0.0]), rod, np.eye(4)),
]
tied = Mechanism(links, loops=[loops.PointLoop("pin", "tip", "slider")])
qdd, wrenches = mechanics.closed_dynamics(tied)
qdd.shape, list(wrenches)

# tx.mechanics.power
F, V = tx.State("F", shape=(6,)), tx.State("V", shape=(6,))
tx.mechanics.power(F, V)

# tx.mechanics.Mimic
tx.mechanics.Mimic("left_finger", ratio=-1.0)

# tx.mechanics.chain_models.equal_links tx.mechanics.chain_models.modified_dh
chain = tx.mechanics.chain_models.equal_links(3)
list(chain.frames), tx.mechanics.chain_models.modified_dh(a=0.1, d=0.2, quarter_turns=1)

# tx.mechanics.joints.Joint tx.mechanics.joints.Screws
elbow = tx.mechanics.joints.Revolute("elbow", [0.0, 0.0, 1.0])
elbow.screws.motion_subspace, elbow.screws.constraint_basis.shape

# tx.mechanics.joints.Cylindrical tx.mechanics.joints.Helical tx.mechanics.joints.Planar
from twistax.mechanics import joints

z = [0.0, 0.0, 1.0]
[joints.Cylindrical("sleeve", z), joints.Helical("lead_screw", z, pitch=0.001), joints.Planar("puck")]

# tx.mechanics.GivenForces
from twistax import mechanics
from twistax.mechanics import Link, Mechanism, SpatialInertia, joints

box = SpatialInertia(mass=2.0, center_of_mass=[0.0, 0.0, 0.0], inertia=np.diag([0.1, 0.1, 0.1]))
hopper = Mechanism([Link(joints.Prismatic("leg", [0.0, 0.0, 1.0]), box, np.eye(4))])
given = mechanics.given_forces(hopper, ["leg"], friction=0.6)
list(given.controls), list(given.cones)

# tx.mechanics.Bristles
from twistax import mechanics
from twistax.mechanics import Ground, Link, Mechanism, SpatialInertia, joints

box = SpatialInertia(mass=2.0, center_of_mass=[0.0, 0.0, 0.0], inertia=np.diag([0.1, 0.1, 0.1]))
block = Mechanism([Link(joints.Free("block"), box, np.eye(4))])
grip = Ground(friction=0.6).bristles(block, ["block"])
[state.name for state in grip.rates], list(grip.wrenches)

# tx.mechanics.inverse_dynamics_regressor tx.mechanics.Regressor
from twistax import mechanics

arm = mechanics.chain_models.equal_links(2)
regressor = mechanics.inverse_dynamics_regressor(arm)
regressor.matrix.shape, regressor.names[:2]

# tx.mechanics.base_parameters tx.mechanics.BaseParameters
from twistax import mechanics

arm = mechanics.chain_models.equal_links(2)
mechanics.base_parameters(arm).names[0]

# tx.mechanics.identifiable_combinations
W = np.array([[1.0, 2.0, 0.0], [2.0, 4.0, 0.0]])
combinations = tx.mechanics.identifiable_combinations(W, ["a", "b", "c"])
combinations.names, combinations.without_effect

# tx.mechanics.identify tx.mechanics.Identification tx.mechanics.IdentificationStatus
from twistax.mechanics import Link, Mechanism, SpatialInertia, joints

rod = SpatialInertia(mass=1.0, center_of_mass=[0.5, 0.0, 0.0], inertia=0.1 * np.eye(3))
pendulum = Mechanism([Link(joints.Revolute("hinge", [0.0, 1.0, 0.0]), rod, np.eye(4))])
q, qd, qdd = np.random.default_rng(0).normal(size=(3, 50, 1))
tau = 0.35 * qdd - 4.9 * np.cos(q)
result = tx.mechanics.identify(pendulum, {"q": q, "qd": qd, "qdd": qdd, "tau": tau}, noise=0.01)
result.status, result.names, result.estimate("hinge.Iyy")

# tx.mechanics.physical_inertia tx.mechanics.log_cholesky
from twistax.mechanics import SpatialInertia

ten = tx.mechanics.log_cholesky(SpatialInertia(mass=2.0, inertia=np.eye(3)))
tx.mechanics.physical_inertia(ten)

# tx.mechanics.reach tx.mechanics.ReachResult tx.mechanics.ReachStatus
arm = tx.mechanics.chain_models.equal_links(3)
result = tx.mechanics.reach(arm, {"joint2": np.array([0.3, 0.1, 0.05])}, seeds=2)
tx.mechanics.ReachStatus(int(result.status)), result.x["q"], result.distance

# tx.mechanics.signed_distance tx.mechanics.HalfSpace
from twistax.mechanics import HalfSpace, chain_models, signed_distance

arm = chain_models.panda()
height = signed_distance(tx.view.Sphere(0.1), HalfSpace(), arm.pose("joint7"))
tx.lower(height)(0.0, {"q": np.zeros(7)})  # m

# tx.mechanics.witness_points tx.mechanics.WitnessPoints
from twistax.mechanics import HalfSpace, chain_models, witness_points

arm = chain_models.panda()
near = witness_points(tx.view.Cylinder(0.05, 0.2), HalfSpace(), arm.pose("joint7"))
tx.lower(near.on_b)(0.0, {"q": np.zeros(7)})  # on the ground

# tx.mechanics.fitted_capsule tx.mechanics.fitted_spheres
from twistax.mechanics import fitted_capsule, fitted_spheres

corners, triangles = tx.view.Box((0.1, 0.15, 0.4)).mesh()
capsule = fitted_capsule(tx.view.Mesh((corners, triangles)))
capsule.radius, [ball.radius for ball in fitted_spheres(corners, 3)]

# tx.mechanics.soft_distance
from twistax.mechanics import chain_models, signed_distance, soft_distance

arm, hand, shelf = chain_models.panda(), tx.view.Box((0.1, 0.2, 0.1)), tx.view.Box((0.4, 1.0, 0.02), at=(0.6, 0.0, 0.4))
pairs = [signed_distance(hand, shelf, arm.pose("joint7")), soft_distance(hand, shelf, 0.002, arm.pose("joint7"))]
[tx.lower(distance)(0.0, {"q": np.zeros(7)}) for distance in pairs]  # m, the second one less by at most 4.2 x 0.002

# tx.mechanics.fourier_motion
from twistax.mechanics import fourier_motion

fourier_motion([[0.3, 1.0, 0.5, 0.0, -0.5]], 2.0, np.linspace(0.0, 2.0, 5))["q"]  # of one joint, two harmonics

# tx.mechanics.ConvexPolytope tx.mechanics.DistanceGrid
from twistax.mechanics import ConvexPolytope, DistanceGrid, HalfSpace, chain_models, signed_distance

arm, corners = chain_models.panda(), [[0.1, 0.0, 0.0], [0.0, 0.1, 0.0], [0.0, 0.0, 0.1], [0.0, 0.0, -0.1]]
height = signed_distance(ConvexPolytope(corners), HalfSpace(), arm.pose("joint7"))
axis = np.linspace(-1.0, 1.0, 5)
x, y, z = np.meshgrid(axis, axis, axis, indexing="ij")
ball = DistanceGrid((axis, axis, axis), np.sqrt(x**2 + y**2 + z**2) - 0.3)
gap = signed_distance(tx.view.Sphere(0.1), ball, arm.pose("joint7"))
tx.lower(height)(0.0, {"q": np.zeros(7)}), tx.lower(gap)(0.0, {"q": np.zeros(7)})  # m

# tx.mechanics.Task tx.mechanics.RelativeFrameTask tx.mechanics.LookAtTask tx.mechanics.OrientationTask
from twistax import mechanics

arm = mechanics.chain_models.panda()
tasks = [
    mechanics.PositionTask("joint7", [0.4, 0.1, 0.5]),
    mechanics.OrientationTask("joint7", np.diag([1.0, -1.0, -1.0]), weight=0.1),
    mechanics.RelativeFrameTask("joint7", "joint3", weight=0.0),
    mechanics.LookAtTask("joint5", target=[1.0, 0.0, 0.0], weight=0.1),
]
[isinstance(task, mechanics.Task) for task in tasks], tasks[0].error(arm), tasks[0].jacobian(arm).shape

# tx.mechanics.CenterOfMassTask tx.mechanics.MomentumTask
from twistax import mechanics

arm = mechanics.chain_models.panda()
tasks = [mechanics.CenterOfMassTask([0.0, 0.0, 0.4], weight=1e-2), mechanics.MomentumTask(np.zeros(6), weight=1e-2)]
[task.jacobian(arm).shape for task in tasks]

# tx.mechanics.JointLimitTask tx.mechanics.ManipulabilityTask
from twistax import mechanics

arm = mechanics.chain_models.equal_links(3)
arm = arm.replace(drives={name: mechanics.Drive(lower=-1.0, upper=1.0) for name in arm.joints})
tasks = [mechanics.JointLimitTask(weight=1e-2), mechanics.ManipulabilityTask("joint2", weight=1e-2)]
[task.error(arm).shape for task in tasks]

# tx.mechanics.OperationalSpace tx.mechanics.DifferentialStep
from twistax import mechanics

arm, q = mechanics.chain_models.panda(), np.array([0.0, -0.6, 0.0, -2.2, 0.0, 1.6, 0.8])
space = mechanics.operational_space(arm, mechanics.PositionTask("joint7", [0.4, 0.1, 0.5]).jacobian(arm))
controller = mechanics.DifferentialController(arm, [mechanics.PostureTask(q)], dt=0.01)
step = controller({"q": np.zeros(7)})
tx.lower(space.inertia)(0.0, {"q": q}), step.qd
