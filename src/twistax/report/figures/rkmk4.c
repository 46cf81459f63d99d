/* The classical Runge-Kutta-Munthe-Kaas method on one SE(3) body, as one would write it by hand.

   State y = [q (4), p (3), v (3), w (3)]: unit quaternion, position, body velocities. Coordinates around the start of a
   step are z = [eta_v (3), eta_w (3), v (3), w (3)]. Series and their lengths are those of tx.charts.Exponential(2). */

#define STATE 13
#define TANGENT 12

typedef double real;

static const real GRAVITY[3] = {0.0, 0.0, -9.81}; /* m/s^2 */
static const real INERTIA[3] = {1.0, 2.0, 3.0};   /* kg m^2 */
static const real DRAG = 0.1;                     /* 1/s */
static const real TWELFTH = 1.0 / 12.0;

/* cos(t/2) and sin(t/2)/t as series in t^2/4, (t - sin t)/t^3 in t^2: 1/(2j)!, 1/(2j + 1)!, 1/(2j + 3)!, signs in turn. */
static const real COSINE[11] = {
    1.0, -1.0 / 2.0, 1.0 / 24.0, -1.0 / 720.0, 1.0 / 40320.0, -1.0 / 3628800.0, 1.0 / 479001600.0,
    -1.0 / 87178291200.0, 1.0 / 20922789888000.0, -1.0 / 6402373705728000.0, 1.0 / 2432902008176640000.0};
static const real SINE[11] = {
    1.0, -1.0 / 6.0, 1.0 / 120.0, -1.0 / 5040.0, 1.0 / 362880.0, -1.0 / 39916800.0, 1.0 / 6227020800.0,
    -1.0 / 1307674368000.0, 1.0 / 355687428096000.0, -1.0 / 121645100408832000.0, 1.0 / 51090942171709440000.0};
static const real THIRD[13] = {
    1.0 / 6.0, -1.0 / 120.0, 1.0 / 5040.0, -1.0 / 362880.0, 1.0 / 39916800.0, -1.0 / 6227020800.0,
    1.0 / 1307674368000.0, -1.0 / 355687428096000.0, 1.0 / 121645100408832000.0, -1.0 / 51090942171709440000.0,
    1.0 / 25852016738884976640000.0, -1.0 / 15511210043330985984000000.0, 1.0 / 10888869450418352160768000000.0};

static inline real horner(const real *c, int n, real x) {
    real value = c[n - 1];
    for (int i = n - 2; i >= 0; i--) value = value * x + c[i];
    return value;
}

static inline real dot(const real *a, const real *b) { return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]; }

static inline void cross(const real *a, const real *b, real *out) {
    out[0] = a[1] * b[2] - a[2] * b[1];
    out[1] = a[2] * b[0] - a[0] * b[2];
    out[2] = a[0] * b[1] - a[1] * b[0];
}

/* R(s, u) a for the unit quaternion (s, u). */
static inline void rotate(real s, const real *u, const real *a, real *out) {
    real once[3], twice[3];
    cross(u, a, once);
    for (int i = 0; i < 3; i++) once[i] *= 2.0;
    cross(u, once, twice);
    for (int i = 0; i < 3; i++) out[i] = a[i] + s * once[i] + twice[i];
}

/* The state with coordinates z around y: g Exp(eta), and what is added to. */
static inline void move(const real *y, const real *z, real *out) {
    const real *v = z, *w = z + 3, *u = y + 1;
    real x = dot(w, w), c = horner(COSINE, 11, 0.25 * x), s = 0.5 * horner(SINE, 11, 0.25 * x);
    real third = horner(THIRD, 13, x), second = 2.0 * s * s;
    real once[3], twice[3], swept[3], shift[3], n[3] = {s * w[0], s * w[1], s * w[2]}, un[3];
    cross(w, v, once);
    cross(w, once, twice);
    for (int i = 0; i < 3; i++) swept[i] = v[i] + second * once[i] + third * twice[i];
    rotate(y[0], u, swept, shift);
    cross(u, n, un);
    out[0] = y[0] * c - dot(u, n);
    for (int i = 0; i < 3; i++) out[1 + i] = y[0] * n[i] + c * u[i] + un[i];
    for (int i = 0; i < 3; i++) out[4 + i] = y[4 + i] + shift[i];
    for (int i = 0; i < 6; i++) out[7 + i] = y[7 + i] + z[6 + i];
}

/* v' = R'gravity - w x v - drag v and J w' = J w x w, after the body velocity itself. */
static inline void rate(const real *y, real *out) {
    const real *v = y + 7, *w = y + 10;
    real back[3] = {-y[1], -y[2], -y[3]}, weight[3], turned[3], turning[3];
    real spin[3] = {INERTIA[0] * w[0], INERTIA[1] * w[1], INERTIA[2] * w[2]};
    rotate(y[0], back, GRAVITY, weight);
    cross(w, v, turned);
    cross(spin, w, turning);
    for (int i = 0; i < 6; i++) out[i] = y[7 + i];
    for (int i = 0; i < 3; i++) out[6 + i] = weight[i] - DRAG * v[i] - turned[i];
    for (int i = 0; i < 3; i++) out[9 + i] = turning[i] / INERTIA[i];
}

/* eta' = omega + [eta, omega]/2 + [eta, [eta, omega]]/12 in place of the body velocity omega. */
static inline void pull_back(const real *z, real *omega) {
    const real *v = z, *w = z + 3;
    real *y = omega, *u = omega + 3;
    real turn[3], sweep[3], carried[3], arm[3], slide[3], a[3], b[3], d[3];
    cross(w, u, turn);
    cross(w, y, sweep);
    cross(v, u, carried);
    for (int i = 0; i < 3; i++) {
        arm[i] = 0.5 * u[i] + TWELFTH * turn[i];
        slide[i] = 0.5 * y[i] + TWELFTH * (sweep[i] + carried[i]);
    }
    cross(w, slide, a);
    cross(v, arm, b);
    cross(w, arm, d);
    for (int i = 0; i < 3; i++) {
        y[i] += a[i] + b[i];
        u[i] += d[i];
    }
}

static inline void slope(const real *y, const real *before, real length, real *k) {
    real z[TANGENT], moved[STATE];
    for (int i = 0; i < TANGENT; i++) z[i] = length * before[i];
    move(y, z, moved);
    rate(moved, k);
    pull_back(z, k);
}

static inline void step(real *y, real h) {
    real k1[TANGENT], k2[TANGENT], k3[TANGENT], k4[TANGENT], z[TANGENT], end[STATE];
    rate(y, k1);
    slope(y, k1, 0.5 * h, k2);
    slope(y, k2, 0.5 * h, k3);
    slope(y, k3, h, k4);
    for (int i = 0; i < TANGENT; i++) z[i] = h / 6.0 * (k1[i] + 2.0 * k2[i] + 2.0 * k3[i] + k4[i]);
    move(y, z, end);
    real tighten = 1.5 - 0.5 * (end[0] * end[0] + dot(end + 1, end + 1));
    for (int i = 0; i < 4; i++) y[i] = tighten * end[i];
    for (int i = 4; i < STATE; i++) y[i] = end[i];
}

/* Move y, in place, by so many steps of h seconds. */
void integrate(real *y, real h, long steps) {
    for (long i = 0; i < steps; i++) step(y, h);
}
