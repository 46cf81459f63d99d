/* How far a point is from the optimality conditions, and what proves that there is no solution. All measures are those
 * of the equilibrated problem, over the size of the quantities that they are sums of: they do not depend on units.
 */
#include "qp_work.h"

static double qp_largest(int32_t count, const double *a, double least) {
  for (int32_t i = 0; i < count; i++) least = twx_max(least, fabs(a[i]));
  return least;
}

static double qp_over(double a, double size) { return a > 0 ? a / size : a; } /* 0 / 0 is 0 */

/* What depends on x and z, then errors.
 *
 *   stationarity     max |H x + g + G'z + z| / Z          Z = max(|H x|, |g|, |z|, |H x| at the start)
 *   violation        max (distance of t from its bounds) / X      X = max(|x|, |G x|), with what equalities want
 *   complementarity  max of min(|z| / Z, (distance of t from the bound of z's sign) / X)
 */
void twx_qp_measure(const twx_qp_work *w, twx_qp_point *q) {
  const int32_t n = w->n, m = w->m;
  double stationarity = 0, violation = 0, complementarity = 0;
  memcpy(q->t, q->x, sizeof(double) * (size_t)n);
  memset(q->t + n, 0, sizeof(double) * (size_t)m), memset(q->Hx, 0, sizeof(double) * (size_t)n);
  memset(q->Gz, 0, sizeof(double) * (size_t)n);
  for (int32_t i = n; w->soft > 0 && i < w->k; i++) q->t[i] = -w->soft * q->z[i];
  twx_add_apply(m, n, w->G, m, q->x, q->t + n);
  twx_add_apply(n, n, w->H, n, q->x, q->Hx);
  twx_add_apply(n, m, w->Gt, n, q->z + n, q->Gz);
  for (int32_t j = 0; j < n; j++) {
    q->residual[j] = q->Hx[j] + w->g[j] + q->Gz[j] + q->z[j];
    stationarity = twx_max(stationarity, fabs(q->residual[j]));
  }
  q->X = qp_largest(w->k, q->t, 0);
  for (int32_t i = 0; i < w->k; i++) if (w->kind[i] == TWX_QP_FIXED) q->X = twx_max(q->X, fabs(w->lower[i]));
  q->Z = qp_largest(w->k, q->z, qp_largest(n, q->Hx, qp_largest(n, w->g, w->first_gradient)));
  const double least = w->options->rounding * qp_largest(n, w->g, 0); /* H is about 1: x without constraints */
  const double X = twx_max(q->X, least), Z = twx_max(q->Z, w->options->rounding * q->X);
  for (int32_t i = 0; i < w->k; i++) {
    const double below = w->lower[i] - q->t[i], above = q->t[i] - w->upper[i];
    violation = twx_max(violation, twx_max(below, above));
    if (w->kind[i] == TWX_QP_FIXED || q->z[i] == 0) continue;
    const double slack = q->z[i] > 0 ? -above : -below;
    complementarity = twx_max(complementarity, twx_min(qp_over(fabs(q->z[i]), Z), qp_over(slack, X)));
  }
  q->stationarity = qp_over(stationarity, Z), q->violation = qp_over(violation, X);
  q->complementarity = complementarity;
  q->error = twx_max(complementarity, twx_max(q->violation, q->stationarity));
  if (!isfinite(stationarity + q->X)) q->error = INFINITY;
}

void twx_qp_copy(const twx_qp_work *w, twx_qp_point *to, const twx_qp_point *from) {
  memcpy(to->x, from->x, sizeof(double) * (size_t)w->n), memcpy(to->z, from->z, sizeof(double) * (size_t)w->k);
}

/* By Farkas: with multipliers z of rows, G'z = v, and bounds of variables that cancel what they can of v, every x has
 *   0 >= gap - sum of left |x|,      gap = -(sum over rows and bounds of z times the bound of its sign).
 * Where gap > 0 no x with max |x| < gap / (sum of left) is feasible. Returned: the size of the point over that radius;
 * infinite where nothing is proved. Multipliers of variables are written, so that they cancel v.
 */
double twx_qp_infeasible(twx_qp_work *w, const twx_qp_point *q) {
  double gap = 0, left = 0, size = 0, *const z = w->dz;
  memset(z, 0, sizeof(double) * (size_t)w->n);
  for (int32_t i = w->n; i < w->k; i++) z[i] = isfinite(q->z[i] > 0 ? w->upper[i] : w->lower[i]) ? q->z[i] : 0;
  twx_add_apply(w->n, w->m, w->Gt, w->n, z + w->n, z);
  for (int32_t i = 0; i < w->k; i++) {
    if (i < w->n) z[i] = -z[i];
    const double bound = z[i] > 0 ? w->upper[i] : w->lower[i];
    if (z[i] != 0 && isfinite(bound)) gap -= z[i] * bound, size += fabs(z[i] * bound);
    else left += fabs(z[i]), z[i] = 0;
  }
  return gap > w->options->cancellation * size ? left * q->X / gap : INFINITY;
}

/* x as a direction d, max |d| = 1: |H d| and how fast d leaves constraints, over the slope -g'd / |g|. */
double twx_qp_unbounded(const twx_qp_work *w, const twx_qp_point *q) {
  const double size = qp_largest(w->n, q->x, 0), H = qp_largest(w->n * w->n, w->H, 0);
  double slope = 0, g = 0, left = 0;
  for (int32_t j = 0; j < w->n; j++) {
    slope -= w->g[j] * q->x[j], g += fabs(w->g[j]);
    left = twx_max(left, qp_over(fabs(q->Hx[j]), H));
  }
  for (int32_t i = 0; i < w->k; i++) {
    if (isfinite(w->lower[i])) left = twx_max(left, -q->t[i]);
    if (isfinite(w->upper[i])) left = twx_max(left, q->t[i]);
  }
  return slope > 0 && size > 0 ? left * g / slope : INFINITY;
}
