/* An INS filter of 15 states written by hand: errors of attitude, velocity, position and of both biases.
   One Euler step of the mean, the trapezoidal rule for the noise, Joseph's form, the reset of the attitude. */
#include <math.h>
#include <string.h>

#define N 15

static void hat(const double w[3], double s, double W[9]) {
    W[0] = W[4] = W[8] = 0.0;
    W[1] = -s * w[2]; W[2] = s * w[1]; W[3] = s * w[2];
    W[5] = -s * w[0]; W[6] = -s * w[1]; W[7] = s * w[0];
}

static void mul3(const double a[9], const double b[9], double c[9]) {
    for (int i = 0; i < 3; i++)
        for (int j = 0; j < 3; j++) c[3 * i + j] = a[3 * i] * b[j] + a[3 * i + 1] * b[3 + j] + a[3 * i + 2] * b[6 + j];
}

/* E = Exp(w), J its right Jacobian. */
static void rotation(const double w[3], double E[9], double J[9]) {
    double x = w[0] * w[0] + w[1] * w[1] + w[2] * w[2], t = sqrt(x), a, b, c, W[9], V[9];
    if (x < 1e-4) {
        a = 1.0 - x / 6.0 * (1.0 - x / 20.0 * (1.0 - x / 42.0));
        b = 0.5 - x / 24.0 * (1.0 - x / 30.0 * (1.0 - x / 56.0));
        c = 1.0 / 6.0 - x / 120.0 * (1.0 - x / 42.0 * (1.0 - x / 72.0));
    } else {
        a = sin(t) / t; b = (1.0 - cos(t)) / x; c = (1.0 - a) / x;
    }
    hat(w, 1.0, W);
    mul3(W, W, V);
    for (int i = 0; i < 9; i++) {
        double one = i % 4 == 0;
        E[i] = one + a * W[i] + b * V[i];
        J[i] = one - b * W[i] + c * V[i];
    }
}

/* x: R (9), v, p, bg, ba; d: variances of the noise of attitude, velocity, gyro drift and accelerometer drift. */
static void predict(double x[21], double P[N][N], const double gyro[3], const double acc[3], const double d[4], double h) {
    double w[3], a[3], E[9], J[9], R[9], A[9], RA[9], F[N][N], T[N][N], D[N];
    for (int i = 0; i < 3; i++) {
        w[i] = h * (gyro[i] - x[15 + i]);
        a[i] = acc[i] - x[18 + i];
        D[i] = 0.5 * h * d[0]; D[3 + i] = 0.5 * h * d[1]; D[6 + i] = 0.0;
        D[9 + i] = 0.5 * h * d[2]; D[12 + i] = 0.5 * h * d[3];
    }
    rotation(w, E, J);
    memcpy(R, x, sizeof R);
    hat(a, 1.0, A);
    mul3(R, A, RA);
    memset(F, 0, sizeof F);
    for (int i = 0; i < N; i++) F[i][i] = 1.0;
    for (int i = 0; i < 3; i++)
        for (int j = 0; j < 3; j++) {
            F[i][j] = E[3 * j + i];
            F[i][9 + j] = -h * J[3 * i + j];
            F[3 + i][j] = -h * RA[3 * i + j];
            F[3 + i][12 + j] = -h * R[3 * i + j];
            F[6 + i][3 + j] = h * (i == j);
        }
    for (int i = 0; i < N; i++) P[i][i] += D[i];
    for (int i = 0; i < N; i++)
        for (int j = 0; j < N; j++) {
            double s = 0.0;
            for (int k = 0; k < N; k++) s += F[i][k] * P[k][j];
            T[i][j] = s;
        }
    for (int i = 0; i < N; i++)
        for (int j = 0; j <= i; j++) {
            double s = 0.0;
            for (int k = 0; k < N; k++) s += T[i][k] * F[j][k];
            P[i][j] = P[j][i] = s;
        }
    for (int i = 0; i < N; i++) P[i][i] += D[i];
    mul3(R, E, x);
    for (int i = 0; i < 3; i++) {
        double f = R[3 * i] * a[0] + R[3 * i + 1] * a[1] + R[3 * i + 2] * a[2];
        x[12 + i] += h * x[9 + i];
        x[9 + i] += h * (f + (i == 2) * 9.81);
    }
}

static void update(double x[21], double P[N][N], const double z[3], double r) {
    double S[9], I[9], K[N][3], L[N][N], T[N][N], d[N], e[3], E[9], J[9], Q[9];
    for (int i = 0; i < 3; i++) {
        e[i] = z[i] - x[12 + i];
        for (int j = 0; j < 3; j++) S[3 * i + j] = P[6 + i][6 + j] + r * (i == j);
    }
    I[0] = S[4] * S[8] - S[5] * S[7]; I[1] = S[2] * S[7] - S[1] * S[8]; I[2] = S[1] * S[5] - S[2] * S[4];
    I[3] = S[5] * S[6] - S[3] * S[8]; I[4] = S[0] * S[8] - S[2] * S[6]; I[5] = S[2] * S[3] - S[0] * S[5];
    I[6] = S[3] * S[7] - S[4] * S[6]; I[7] = S[1] * S[6] - S[0] * S[7]; I[8] = S[0] * S[4] - S[1] * S[3];
    double det = S[0] * I[0] + S[1] * I[3] + S[2] * I[6];
    for (int i = 0; i < N; i++) {
        d[i] = 0.0;
        for (int j = 0; j < 3; j++) {
            K[i][j] = (P[i][6] * I[j] + P[i][7] * I[3 + j] + P[i][8] * I[6 + j]) / det;
            d[i] += K[i][j] * e[j];
        }
    }
    for (int i = 0; i < N; i++) /* (I - K H) P */
        for (int j = 0; j < N; j++) T[i][j] = P[i][j] - K[i][0] * P[6][j] - K[i][1] * P[7][j] - K[i][2] * P[8][j];
    for (int i = 0; i < N; i++)
        for (int j = 0; j < N; j++)
            L[i][j] = T[i][j] - (T[i][6] - r * K[i][0]) * K[j][0] - (T[i][7] - r * K[i][1]) * K[j][1]
                      - (T[i][8] - r * K[i][2]) * K[j][2];
    rotation(d, E, J);
    for (int j = 0; j < N; j++) /* the reset of the attitude, on both sides */
        for (int i = 0; i < 3; i++) T[i][j] = J[3 * i] * L[0][j] + J[3 * i + 1] * L[1][j] + J[3 * i + 2] * L[2][j];
    for (int i = 0; i < 3; i++) memcpy(L[i], T[i], sizeof L[i]);
    for (int i = 0; i < N; i++) {
        for (int j = 0; j < 3; j++) e[j] = L[i][0] * J[3 * j] + L[i][1] * J[3 * j + 1] + L[i][2] * J[3 * j + 2];
        memcpy(L[i], e, sizeof e);
    }
    memcpy(P, L, sizeof L);
    mul3(x, E, Q);
    memcpy(x, Q, sizeof Q);
    for (int i = 0; i < 12; i++) x[9 + i] += d[3 + i];
}

/* Steps of the filter with constant readings and measurements. */
void by_hand(double *x, double *P, const double *gyro, const double *acc, const double *d, double h, const double *z,
             double r, long steps) {
    for (long k = 0; k < steps; k++) {
        predict(x, (double(*)[N])P, gyro, acc, d, h);
        update(x, (double(*)[N])P, z, r);
    }
}
