# tx.lie.so3.exp tx.lie.so3.log
w = np.array([0.0, 0.0, np.pi / 2])  # rad
R = tx.lie.so3.exp(w)
tx.lie.so3.log(R)  # w

# tx.lie.so3.compose tx.lie.so3.inverse
R = tx.lie.so3.exp(np.array([0.3, 0.0, 0.0]))
tx.lie.so3.compose(R, tx.lie.so3.inverse(R))  # the identity

# tx.lie.so3.act
tx.lie.so3.act(tx.lie.so3.exp(np.array([0.0, 0.0, np.pi / 2])), np.array([1.0, 0.0, 0.0]))

# tx.lie.so3.hat tx.lie.so3.vee
W = tx.lie.so3.hat(np.array([1.0, 2.0, 3.0]))
tx.lie.so3.vee(W)

# tx.lie.so3.ad tx.lie.so3.bracket
x, y = np.array([1.0, 0.0, 0.0]), np.array([0.0, 1.0, 0.0])
tx.lie.so3.ad(x) @ y, tx.lie.so3.bracket(x, y)  # both the cross product

# tx.lie.so3.ad_dual tx.lie.so3.coad
w, L = np.array([0.0, 0.0, 1.0]), np.array([1.0, 0.0, 0.0])  # rad/s, N m s
tx.lie.so3.ad_dual(w) @ L, tx.lie.so3.coad(w, L)

# tx.lie.so3.Ad tx.lie.so3.Ad_dual
R = tx.lie.so3.exp(np.array([0.0, 0.0, np.pi / 2]))
tx.lie.so3.Ad(R) @ np.array([1.0, 0.0, 0.0])  # a rate in body axes, in those of the world

# tx.lie.so3.left_jacobian tx.lie.so3.left_jacobian_inv
w = np.array([0.0, 0.0, 1.0])
tx.lie.so3.left_jacobian(w) @ tx.lie.so3.left_jacobian_inv(w)

# tx.lie.so3.right_jacobian tx.lie.so3.right_jacobian_inv tx.lie.so3.right_jacobian_inv_apply
w, rate = np.array([0.0, 0.0, 1.0]), np.array([0.1, 0.0, 0.0])
tx.lie.so3.right_jacobian(w) @ tx.lie.so3.right_jacobian_inv_apply(w, rate)  # rate

# tx.lie.se3.exp tx.lie.se3.log
xi = np.array([1.0, 0.0, 0.0, 0.0, 0.0, np.pi / 2])  # [v; w]
T = tx.lie.se3.exp(xi)
tx.lie.se3.log(T)  # xi

# tx.lie.se3.compose tx.lie.se3.inverse tx.lie.se3.between
a = tx.pose(position=[1.0, 0.0, 0.0])
b = tx.pose(position=[1.0, 2.0, 0.0])
tx.lie.se3.compose(tx.lie.se3.inverse(a), b), tx.lie.se3.between(a, b)  # the pose of b seen from a, twice

# tx.lie.se3.act
tx.lie.se3.act(tx.pose(position=[1.0, 0.0, 0.0]), np.array([0.0, 2.0, 0.0]))

# tx.lie.se3.hat tx.lie.se3.vee
tx.lie.se3.vee(tx.lie.se3.hat(np.arange(6.0)))

# tx.lie.se3.ad tx.lie.se3.bracket
xi, eta = np.array([1.0, 0.0, 0.0, 0.0, 0.0, 1.0]), np.array([0.0, 1.0, 0.0, 0.0, 0.0, 0.0])
tx.lie.se3.ad(xi) @ eta, tx.lie.se3.bracket(xi, eta)

# tx.lie.se3.ad_dual tx.lie.se3.coad
V, momentum = np.array([1.0, 0.0, 0.0, 0.0, 0.0, 1.0]), np.array([2.0, 0.0, 0.0, 0.0, 0.0, 0.5])
tx.lie.se3.ad_dual(V) @ momentum, tx.lie.se3.coad(V, momentum)

# tx.lie.se3.Ad tx.lie.se3.Ad_dual
T = tx.pose(position=[0.0, 0.0, 1.0])
wrench = np.array([1.0, 0.0, 0.0, 0.0, 0.0, 0.0])  # a force of 1 N at the origin of the body
tx.lie.se3.Ad_dual(T) @ wrench  # about the origin of the world it has a torque of 1 N m

# tx.lie.se3.left_jacobian tx.lie.se3.left_jacobian_inv
xi = np.array([1.0, 0.0, 0.0, 0.0, 0.0, 1.0])
np.round(tx.lie.se3.left_jacobian(xi) @ tx.lie.se3.left_jacobian_inv(xi), 6)

# tx.lie.se3.right_jacobian tx.lie.se3.right_jacobian_inv_apply
xi, rate = np.array([1.0, 0.0, 0.0, 0.0, 0.0, 1.0]), np.array([0.0, 1.0, 0.0, 0.0, 0.0, 0.0])
tx.lie.se3.right_jacobian(xi) @ tx.lie.se3.right_jacobian_inv_apply(xi, rate)  # rate

# tx.lie.rotation
tx.lie.rotation(tx.lie.so3.exp(np.array([0.0, 0.0, np.pi / 2])))

# tx.lie.EulerAngles
R = tx.State("R", group=tx.SO3)
tx.lie.EulerAngles(R, "zyx")  # yaw, pitch, roll

# tx.lie.SE3Log
g = tx.State("g", group=tx.SE3)
tx.lie.SE3Log(g)

# tx.spatial.Quaternion
R = tx.State("R", group=tx.SO3)
tx.spatial.Quaternion(R)
