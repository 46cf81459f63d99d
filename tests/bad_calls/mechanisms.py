"""Bad uses of mechanics: bodies, joints, chains, environment; of scenes."""

import functools

import numpy as np
from table import bad

import twistax as tx
from twistax.mechanics import Chain, Drive, Link, Mechanism, Mimic, SpatialInertia, chain_models, environment, joints

atmosphere, earth, gravity = environment.atmosphere, environment.earth, environment.gravity

q = tx.State("q", 2)
UNIT, ORIGIN = np.eye(3), np.eye(4)


def body(mass=1.0, inertia=UNIT, **other):
    return SpatialInertia(mass=mass, inertia=inertia, **other)


def link(joint=None, mount=ORIGIN, **other):
    return Link(joint or joints.Revolute("a", (0.0, 0.0, 1.0)), body(), mount, **other)


@functools.cache
def arm() -> Chain:
    return chain_models.equal_links(2)


def air(**changes):
    kept = {"bases": (0.0, 11e3), "lapses": (-6.5e-3, 0.0), "temperature_at_base": 288.15, "pressure_at_base": 1e5}
    rest = {"gravity": 9.8, "radius": 6.4e6, "molar_mass": 28.9, "gas_constant": 8314.0, "heat_ratio": 1.4}
    return atmosphere.LayeredAtmosphere(**(kept | rest | changes))


def scene(**changes):
    from twistax.scenes import Scene

    given = {"name": "s", "title": "", "summary": "", "source": "", "build": lambda: None, "start": {}, "duration": 1.0}
    return Scene(**(given | changes))


def known(name="heavy-top"):
    from twistax.scenes import SCENES

    return SCENES[name]


ROWS = [
    bad("a negative mass", lambda: body(mass=-1.0), "mass", "-1"),
    bad("a mass of NaN", lambda: body(mass=np.nan), "mass", "nan"),
    bad("a mass of text", lambda: body(mass="1 kg"), "mass", "1 kg"),
    bad("a mass of None", lambda: body(mass=None), "mass", "None"),
    bad("masses", lambda: body(mass=[1.0, 2.0]), "mass", "(2,)"),
    bad("principal moments as a vector", lambda: body(inertia=[1.0, 1.0, 1.0]), "inertia", "(3,)", "np.diag"),
    bad("an inertia that is not symmetric", lambda: body(inertia=UNIT + np.eye(3, k=1)), "inertia", "symmetric"),
    bad("a negative moment", lambda: body(inertia=np.diag([1.0, 1.0, -1.0])), "moments", "-1.0"),
    bad("an inertia that no body has", lambda: body(inertia=np.diag([1.0, 1.0, 3.0])), "moments", "3.0"),
    bad("an infinite inertia", lambda: body(inertia=np.full((3, 3), np.inf)), "inertia", "inf"),
    bad("a centre of NaN", lambda: body(center_of_mass=[np.nan, 0.0, 0.0]), "center_of_mass", "nan"),
    bad("a centre of two", lambda: body(center_of_mass=[0.0, 0.0]), "center_of_mass", "(2,)"),
    bad(
        "a tensor too small for its distance",
        lambda: SpatialInertia.about_origin(mass=1.0, center_of_mass=[2.0, 0.0, 0.0], inertia=UNIT),
        "moments",
    ),
    bad("a body joined with a number", lambda: body().merge(3.0), "merge", "3.0"),
    bad("a body plus a number", lambda: body() + 3.0, "SpatialInertia", "3.0"),
    bad("a frame that is no pose", lambda: body().in_frame(2.0 * np.eye(4)), "in_frame", "T"),
    bad("a frame that is mirrored", lambda: body().in_frame(np.diag([1.0, 1.0, -1.0, 1.0])), "in_frame", "T"),
    bad("a frame a little off", lambda: body().in_frame(np.diag([1.0, 1.0, 1.001, 1.0])), "in_frame", "T"),
    bad("a frame with a last row", lambda: body().in_frame(np.eye(4) + 0.1 * np.eye(4, k=-3)), "in_frame", "T"),
    bad("a frame of NaN", lambda: body().in_frame(np.full((4, 4), np.nan)), "in_frame", "T", "nan"),
    bad("a weight at no pose", lambda: body().weight(2.0 * np.eye(4), np.zeros(3)), "weight", "T", "tx.pose"),
    bad("a frame that is a rotation", lambda: body().in_frame(UNIT), "in_frame", "T", "(3, 3)"),
    bad("a momentum of three", lambda: body().momentum(np.zeros(3)), "momentum", "V", "(3,)"),
    bad("a momentum of text", lambda: body().momentum("V"), "momentum", "V"),
    bad("a weight in two", lambda: body().weight(np.eye(4), [0.0, -9.8]), "weight", "gravity", "(2,)"),
    bad(
        "an acceleration of a point",
        lambda: body(inertia=0.0 * UNIT).acceleration(np.zeros(6), np.zeros(6)),
        "acceleration",
        "inertia",
        "0.0",
    ),
    bad("a power of three", lambda: tx.mechanics.power(np.zeros(3), np.zeros(6)), "power", "F", "(3,)"),
    # joints
    bad("a joint without a name", lambda: joints.Fixed(""), "Fixed", "''"),
    bad("an axis of zeros", lambda: joints.Revolute("a", (0.0, 0.0, 0.0)), "Revolute", "axis", "0.0"),
    bad("an axis of two", lambda: joints.Prismatic("a", (0.0, 1.0)), "Prismatic", "axis", "(2,)"),
    bad("an axis of NaN", lambda: joints.Revolute("a", (0.0, 0.0, np.nan)), "Revolute", "axis", "nan"),
    bad("an axis by name", lambda: joints.Revolute("a", "z"), "Revolute", "axis", "'z'"),
    bad("a force on a joint of three", lambda: joints.Revolute("a", (0.0, 0.0, 1.0)).actuation(np.zeros(3)), "(3,)"),
    # chains
    bad("a chain of nothing", lambda: Chain([]), "Chain", "none"),
    bad("a chain of bodies", lambda: Chain([body()]), "Chain", "SpatialInertia"),
    bad("a chain of a number", lambda: Chain(3), "Chain", "3"),
    bad("a link without a joint", lambda: Link(None, body(), np.eye(4)), "Link", "None"),
    bad("a link with a number as body", lambda: Link(joints.Fixed("a"), 3.0, np.eye(4)), "Link", "3.0"),
    bad(
        "a chain without mass",
        lambda: Chain([Link(joints.Revolute("a", (0.0, 0.0, 1.0)), None, np.eye(4))]).system(),
        "'a'",
    ),
    bad("a follower of nothing", lambda: Mechanism([link(mimic=Mimic("b"))]), "'a'", "'b'"),
    bad("a ratio of text", lambda: Mimic("b", ratio="half"), "Mimic", "ratio", "half"),
    bad("a negative damping", lambda: Drive(damping=-1.0), "Drive", "damping", "-1.0"),
    bad("a stiffness of text", lambda: Drive(stiffness="soft"), "Drive", "stiffness", "soft"),
    bad("bounds the wrong way round", lambda: Drive(lower=1.0, upper=-1.0), "lower", "1.0"),
    bad("a frame that is not there", lambda: arm().pose("tip"), "'tip'", "joint0"),
    bad(
        "derivatives of a word",
        lambda: tx.mechanics.forward_dynamics_derivatives("arm"),
        "forward_dynamics_derivatives",
        "str",
    ),
    bad(
        "derivatives at two accelerations",
        lambda: tx.mechanics.inverse_dynamics_derivatives(arm(), q, q, np.zeros(9)),
        "inverse_dynamics_derivatives",
        "qdd",
        "(9,)",
    ),
    bad("axes by name", lambda: tx.mechanics.frame_jacobian(arm(), "joint1", q, "world"), "axes", "'world'"),
    bad(
        "a wrench of three",
        lambda: tx.mechanics.aba(arm(), q, q, q, wrenches={"joint0": np.zeros(3)}),
        "joint0",
        "(3,)",
    ),
    bad("wrenches in a list", lambda: tx.mechanics.aba(arm(), q, q, q, wrenches=[np.zeros(6)]), "wrenches", "list"),
    bad("motors of nobody", lambda: arm().system(controls=["joint9"]), "'joint9'", "joint1"),
    bad("a mount that is no pose", lambda: link(mount=np.zeros((4, 4))), "Link", "mount"),
    bad("a mount of three", lambda: link(mount=UNIT), "Link", "mount", "(3, 3)"),
    bad("gravity as a number", lambda: Chain([link()], gravity=-9.81), "Chain", "gravity", "()"),
    bad("gravity of NaN", lambda: Chain([link()], gravity=[0.0, 0.0, np.nan]), "Chain", "gravity", "nan"),
    bad(
        "a force of three on a body", lambda: body().acceleration(np.zeros(6), np.zeros(3)), "acceleration", "F", "(3,)"
    ),
    bad("positions of another number", lambda: tx.mechanics.rnea(arm(), q, q, tx.State("a", 3)), "qdd", "(2,)", "(3,)"),
    bad("dynamics of a list of links", lambda: tx.mechanics.aba([link()], q, q, q), "forward_dynamics", "list"),
    bad("a mass matrix of one", lambda: tx.mechanics.mass_matrix(arm(), tx.State("a")), "q", "(2,)", "()"),
    bad("half a link", lambda: chain_models.equal_links(1.5), "equal_links", "1.5"),
    bad("a half quarter turn", lambda: chain_models.modified_dh(0.0, 0.0, 0.5), "quarter_turns", "0.5"),
    # environment
    bad("a negative GM", lambda: gravity.PointMass(-1.0), "PointMass", "gm", "-1.0"),
    bad("a GM of text", lambda: gravity.PointMass("earth"), "PointMass", "gm", "'earth'"),
    bad("a radius of zero", lambda: gravity.J2(1.0, 0.0, 0.0), "J2", "radius", "0.0"),
    bad(
        "a torque without a GM",
        lambda: gravity.gradient_torque(-1.0, np.ones(3), UNIT),
        "gradient_torque",
        "gm",
        "-1.0",
    ),
    bad("a J2 of NaN", lambda: gravity.J2(1.0, 1.0, np.nan), "J2", "j2", "nan"),
    bad("a J2 of text", lambda: gravity.J2(1.0, 1.0, "small"), "J2", "j2", "'small'"),
    bad("a place of a pose", lambda: gravity.EARTH_J2.acceleration(tx.State("g", group=tx.SE3)), "position", "(4, 4)"),
    bad("a flattening of 298", lambda: earth.Ellipsoid(6.4e6, 298.0, 0.0), "flattening", "298.0", "1/f"),
    bad("a negative radius", lambda: earth.Ellipsoid(-1.0, 0.0, 0.0), "Ellipsoid", "radius", "-1.0"),
    bad("a flattening of text", lambda: earth.Ellipsoid(6.4e6, "flat", 0.0), "flattening", "'flat'"),
    bad("a rate of NaN", lambda: earth.Ellipsoid(6.4e6, 0.0, np.nan), "rate", "nan"),
    bad("latitudes of a place", lambda: earth.WGS84.position([0.1, 0.2], 0.0, 0.0), "position", "latitude", "(2,)"),
    bad("altitudes of a place", lambda: earth.WGS84.position(0.0, 0.0, [1.0]), "position", "altitude", "(1,)"),
    bad("longitudes", lambda: earth.north_east_down(0.0, [0.1]), "north_east_down", "longitude", "(1,)"),
    bad("times of a turn", lambda: earth.WGS84.to_inertial([0.0]), "to_inertial", "t", "(1,)"),
    bad("where a number is", lambda: earth.WGS84.geodetic(tx.State("z")), "geodetic", "position", "()"),
    bad("air at a speed of two", lambda: earth.WGS84.air_velocity(np.ones(3), q), "air_velocity", "velocity", "(2,)"),
    bad("latitudes", lambda: earth.north_east_down(q, 0.0), "latitude", "(2,)"),
    bad("layers that fall", lambda: air(bases=(11e3, 0.0)), "bases", "(11000.0, 0.0)"),
    bad("a lapse too few", lambda: air(lapses=(0.0,)), "2 bases", "1 lapses"),
    bad("air without pressure", lambda: air(pressure_at_base=0.0), "pressure_at_base", "0.0"),
    bad("a layer of text", lambda: air(bases=("ground", 11e3)), "bases", "'ground'"),
    # scenes
    bad("a duration of zero", lambda: scene(duration=0.0), "'s'", "duration", "0.0"),
    bad("a duration of text", lambda: scene(duration="long"), "'s'", "duration", "'long'"),
    bad("a truth at another time", lambda: known().truth(0.1234), "'heavy-top'", "0.1234"),
    bad("an error of half a state", lambda: known().error({}), "'heavy-top'", "missing"),
    bad(
        "an error of a trajectory",
        lambda: known("euler-top").error({"R": np.zeros((5, 3, 3)), "L": np.zeros(3)}, 0.0),
        "'euler-top'",
        "(5, 3, 3)",
    ),
]
