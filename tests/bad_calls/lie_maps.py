"""Bad uses of the numeric maps of the groups, of poses, and of groups themselves."""

import jax.numpy as jnp
import numpy as np
from table import bad

import twistax as tx

so3, se3 = tx.lie.so3, tx.lie.se3
EYE, MIRROR = np.eye(4), np.diag([1.0, 1.0, -1.0])
product = tx.Product({"g": tx.SE3, "x": tx.Euclidean(2)})

ROWS = [
    # maps of arrays
    bad("a logarithm of a reflection", lambda: so3.log(MIRROR), "so3.log", "R", "det", "-1"),
    bad("a logarithm of zeros", lambda: so3.log(np.zeros((3, 3))), "so3.log", "R"),
    bad("a logarithm of NaN", lambda: so3.log(np.full((3, 3), np.nan)), "so3.log", "nan"),
    bad("a logarithm of a scaled rotation", lambda: so3.log(3.0 * np.eye(3)), "so3.log", "R"),
    bad("a logarithm of a pose for a rotation", lambda: so3.log(EYE), "so3.log", "(3, 3)", "(4, 4)"),
    bad("a logarithm of a reflected pose", lambda: se3.log(np.diag([1.0, 1.0, -1.0, 1.0])), "se3.log", "T"),
    bad("a logarithm of a pose of zeros", lambda: se3.log(np.zeros((4, 4))), "se3.log", "T"),
    bad("a logarithm of a pose of NaN", lambda: se3.log(EYE * np.nan), "se3.log", "nan"),
    bad(
        "a logarithm of a pose with another last row",
        lambda: se3.log(EYE + np.eye(4)[[3]].T @ np.ones((1, 4))),
        "se3.log",
        "T",
    ),
    bad(
        "a logarithm of a position that is infinite",
        lambda: se3.log(tx.lie.se3.transform(np.eye(3), np.array([np.inf, 0.0, 0.0]))),
        "se3.log",
        "T",
    ),
    bad("a logarithm in the group", lambda: tx.SE3.log(np.zeros((4, 4))), "log", "T"),
    bad("a logarithm of text", lambda: so3.log("R"), "so3.log", "'R'"),
    bad("a logarithm of None", lambda: so3.log(None), "so3.log", "None"),
    bad(
        "a logarithm of an expression",
        lambda: so3.log(tx.State("R", group=tx.SO3)),
        "so3.log",
        "State",
        "tx.lower",
    ),
    bad("a complex rotation vector", lambda: so3.exp([1j, 0.0, 0.0]), "so3.exp", "w", "complex"),
    bad("an exponential of six", lambda: so3.exp(np.zeros(6)), "so3.exp", "(3,)", "(6,)"),
    bad("an exponential of text", lambda: se3.exp("xi"), "se3.exp", "'xi'"),
    bad("an exponential of a dict", lambda: se3.exp({"v": 0.0}), "se3.exp", "dict"),
    bad("an exponential of a ragged list", lambda: se3.exp([[1.0], 2.0]), "se3.exp", "[[1.0], 2.0]"),
    bad("a batch of twists", lambda: se3.exp(np.zeros((5, 6))), "se3.exp", "(5, 6)", "jax.vmap"),
    bad("an action on two", lambda: se3.act(EYE, np.zeros(2)), "se3.act", "(2,)"),
    bad("a hat of four", lambda: so3.hat(np.zeros(4)), "so3.hat", "(4,)"),
    bad("an adjoint of three", lambda: se3.Ad(np.eye(3)), "se3.Ad", "(4, 4)", "(3, 3)"),
    bad("a bracket of a vector and a twist", lambda: se3.bracket(np.zeros(3), np.zeros(6)), "se3.bracket", "(3,)"),
    # poses
    bad(
        "two attitudes", lambda: tx.pose(euler=[0.0, 0.0, 0.0], quaternion=[1.0, 0.0, 0.0, 0.0]), "quaternion", "euler"
    ),
    bad("a zero quaternion", lambda: tx.pose(quaternion=np.zeros(4)), "quaternion", "[0.0, 0.0, 0.0, 0.0]"),
    bad("a quaternion of NaN", lambda: tx.pose(quaternion=[np.nan, 0.0, 0.0, 1.0]), "quaternion", "nan"),
    bad("a quaternion of three", lambda: tx.pose(quaternion=[1.0, 0.0, 0.0]), "quaternion", "(4,)", "(3,)"),
    bad("a rotation that is none", lambda: tx.pose(rotation=2.0 * np.eye(3)), "rotation", "tx.SO3.normalize"),
    bad("a reflection", lambda: tx.pose(rotation=MIRROR), "rotation", "-1"),
    bad("a rotation of NaN", lambda: tx.pose(rotation=np.nan * np.eye(3)), "rotation", "nan"),
    bad("angles of NaN", lambda: tx.pose(euler=[np.nan, 0.0, 0.0]), "euler", "nan"),
    bad("infinite angles", lambda: tx.pose(euler=[0.0, np.inf, 0.0]), "euler", "inf"),
    bad("a position of NaN", lambda: tx.pose(position=[np.nan, 0.0, 0.0]), "position", "nan"),
    bad("an infinite position", lambda: tx.pose(position=[0.0, -np.inf, 0.0]), "position", "inf"),
    bad("a position of two", lambda: tx.pose(position=[1.0, 2.0]), "position", "(3,)", "(2,)"),
    bad("a position of text", lambda: tx.pose(position="origin"), "position", "'origin'"),
    bad(
        "a position of two, an expression", lambda: tx.pose(position=tx.State("p", 2)).shape, "position", "(3,)", "(2,)"
    ),
    bad(
        "two attitudes, one an expression",
        lambda: tx.pose(euler=tx.State("p", 3), quaternion=EYE[0]),
        "quaternion",
        "euler",
    ),
    bad(
        "a sequence that stays",
        lambda: tx.pose(euler=[0.0, 0.0, 0.0], sequence="zzx"),
        "sequence",
        "repetition",
        "'zzx'",
    ),
    bad("a sequence of both cases", lambda: tx.lie.euler(EYE, "zYx"), "sequence", "capital", "'zYx'"),
    bad("a sequence of an expression", lambda: tx.lie.euler(tx.State("R", (3, 3)), "zy"), "sequence", "'zy'"),
    bad(
        "angles of an expression that is no rotation", lambda: tx.lie.euler(tx.State("q", 4)).shape, "rotation", "(4,)"
    ),
    bad("a quaternion of a reflection", lambda: tx.lie.quaternion(MIRROR), "quaternion", "R", "-1"),
    bad("a quaternion of zeros", lambda: tx.lie.quaternion(np.zeros((3, 3))), "quaternion", "R"),
    bad("a quaternion of a pose of NaN", lambda: tx.lie.quaternion(EYE * np.nan), "quaternion", "nan"),
    bad("angles of a reflection", lambda: tx.lie.euler(MIRROR), "euler", "R", "-1"),
    bad("angles of zeros", lambda: tx.lie.euler(np.zeros((3, 3))), "euler", "R"),
    bad("angles of a quaternion", lambda: tx.lie.euler([1.0, 0.0, 0.0, 0.0]), "euler", "(4,)"),
    # groups
    bad("a negative size", lambda: tx.Euclidean(-1), "Euclidean", "-1"),
    bad("a size of text", lambda: tx.Euclidean("3"), "Euclidean", "'3'"),
    bad("a factor by name", lambda: tx.Product({"g": "SE3"}), "Product", "'g'", "str"),
    bad("factors as a list", lambda: tx.Product([tx.SE3]), "Product", "list"),
    bad("a product without a part", lambda: product.log({"g": EYE}), "Product.log", "'x'"),
    bad("a product with another part", lambda: product.log({"g": EYE, "y": np.zeros(2)}), "Product.log", "'y'"),
    bad("a product of an array", lambda: product.log(EYE), "Product.log", "dict"),
    bad(
        "a part of another shape",
        lambda: product.join({"g": np.zeros(6), "x": np.zeros(3)}),
        "Product.join",
        "x",
        "(3,)",
    ),
    bad("a tangent of another length", lambda: product.exp(np.zeros(7)), "Product.split", "(8,)", "(7,)"),
    bad("a nearest rotation to zeros", lambda: tx.SO3.normalize(np.zeros((3, 3))), "normalize", "R"),
    bad("a nearest rotation to NaN", lambda: tx.SO3.normalize(jnp.nan * jnp.eye(3)), "normalize", "nan"),
    bad("a nearest pose to a vector", lambda: tx.SE3.normalize(np.zeros(6)), "normalize", "(6,)"),
    bad("an order of a truth value", lambda: tx.SE3.with_order("angular"), "order", "'angular'"),
]
