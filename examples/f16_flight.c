/* Case 11 of NASA/TM-2015-218675 by the C code of the F-16, which examples/f16.py makes a system of:
 *
 *     dynamics, level = trimmed(DIR / "f16")
 *     dynamics.to_c("out", name="f16", points=[(0.0, level.x, level.u, level.params)])
 *     cc -O1 -Iout f16_flight.c out/f16.c -lm -o f16_flight
 *
 * From stdin: the steps, the step in s, the pose (16), the twist (6), throttle and stick. To stdout: the inertial
 * position after every second, and at last the norm of the Jacobian there. Runge-Kutta of order 4 over the entries of
 * the pose, whose rate is g hat(V).
 */
#include <math.h>
#include <stdio.h>

#include "f16.h"

enum { POSE = 16, TWIST = 6, ALL = POSE + TWIST };

static const double off_course[1] = {0.0}, commands[5][1] = {{0.0}, {0.0}, {0.0}, {0.0}, {0.0}};
static double throttle[1], stick[1];

/* The arguments that all functions of the code take. */
#define ARGUMENTS(t, x) \
    t, x, x + POSE, off_course, commands[0], commands[1], commands[2], commands[3], commands[4], stick, \
        f16_default_p_on, f16_default_p_design_alpha, f16_default_p_design_pitch, throttle

static void rates(double t, const double *x, double *dx)
{
    double v[6], drift[1];
    f16_rates(ARGUMENTS(t, x), v, dx + POSE, drift);
    for (int i = 0; i < 4; i++) {
        const double *g = x + 4 * i;
        dx[4 * i] = g[1] * v[5] - g[2] * v[4];
        dx[4 * i + 1] = g[2] * v[3] - g[0] * v[5];
        dx[4 * i + 2] = g[0] * v[4] - g[1] * v[3];
        dx[4 * i + 3] = g[0] * v[0] + g[1] * v[1] + g[2] * v[2];
    }
}

static void step(double t, double h, double *x)
{
    static const double at[4] = {0.0, 0.5, 0.5, 1.0}, weight[4] = {1.0 / 6.0, 1.0 / 3.0, 1.0 / 3.0, 1.0 / 6.0};
    double k[ALL] = {0.0}, stage[ALL], sum[ALL] = {0.0};
    for (int s = 0; s < 4; s++) {
        for (int i = 0; i < ALL; i++) stage[i] = x[i] + at[s] * h * k[i];
        rates(t + at[s] * h, stage, k);
        for (int i = 0; i < ALL; i++) sum[i] += weight[s] * k[i];
    }
    for (int i = 0; i < ALL; i++) x[i] += h * sum[i];
}

int main(void)
{
    double x[ALL], h, by_x[13 * 13], by_u[13 * 5], norm = 0.0;
    int steps, second;
    if (scanf("%d %lf", &steps, &h) != 2) return 1;
    for (int i = 0; i < ALL; i++)
        if (scanf("%lf", x + i) != 1) return 1;
    if (scanf("%lf %lf", throttle, stick) != 2) return 1;
    second = (int)floor(1.0 / h + 0.5);
    for (int n = 1; n <= steps; n++) {
        step((n - 1) * h, h, x);
        if (n % second == 0) printf("%.17g %.17g %.17g\n", x[3], x[7], x[11]);
    }
    f16_jacobian(ARGUMENTS(steps * h, x), by_x, by_u);
    for (int i = 0; i < 13 * 13; i++) norm += by_x[i] * by_x[i];
    printf("%.17g\n", sqrt(norm));
    return 0;
}
