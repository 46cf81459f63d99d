/* The linear system of a step. With a weight for each constraint, t = (x, G x) given r and dz0, it is
 *
 *   H dx + G'dz + dz = -residual,     dz = weight (dt + r) + dz0,     (M = H + weights of variables + G' weights G)
 *
 * so that M dx = -residual - (1, G')(weight r + dz0). A weight is Sigma / (1 + softness Sigma) with the barrier's
 * second derivative Sigma = z / s, which is infinite at an equality: constraints that depend on each other do no harm.
 */
#include "qp_work.h"

/* Of a constraint, in the linear system: that of the problem, and enough that rows may depend on each other. */
double twx_qp_softness(const twx_qp_work *w, int32_t i) {
  return i < w->n ? w->softness : w->softness + w->soft;
}

/* The factor of M + identity I in w->M; 0 where that is not positive definite. */
int32_t twx_qp_factorize(twx_qp_work *w, double identity) {
  const int32_t n = w->n, m = w->m;
  double *const weighted = w->scratch;
  w->statistics->factorizations++;
  memcpy(w->M, w->H, sizeof(double) * (size_t)n * (size_t)n);
  for (int32_t j = 0; j < n; j++) {
    const size_t corner = (size_t)j + (size_t)j * (size_t)n;
    const double *const column = w->G + (size_t)j * (size_t)m;
    w->M[corner] += w->weights[j] + identity;
    for (int32_t i = 0; i < m; i++) weighted[i] = w->weights[n + i] * column[i];
    twx_add_product(n - j, 1, m, w->Gt + j, n, weighted, m, w->M + corner, n);
  }
  return twx_cholesky(n, w->M, n);
}

/* With the smallest identity, of a few, that makes it positive definite. */
int32_t twx_qp_factorize_regularized(twx_qp_work *w) {
  const twx_qp_options *o = w->options;
  double identity = o->regularization;
  for (; identity <= o->regularization_largest; identity *= o->regularization_increase)
    if (twx_qp_factorize(w, identity)) return 1;
  return 0;
}

/* dx, dt and dz by the factor, r and dz0. */
void twx_qp_step(twx_qp_work *w, const twx_qp_point *at) {
  const int32_t n = w->n, m = w->m;
  for (int32_t i = 0; i < w->k; i++) w->dz0[i] += w->weights[i] * w->r[i];
  memset(w->dx, 0, sizeof(double) * (size_t)n), memset(w->dt, 0, sizeof(double) * (size_t)w->k);
  twx_add_apply(n, m, w->Gt, n, w->dz0 + n, w->dx);
  for (int32_t j = 0; j < n; j++) w->dx[j] = -at->residual[j] - w->dz0[j] - w->dx[j];
  twx_solve_lower(n, w->M, n, 1, w->dx, n);
  twx_solve_lower_transposed(n, w->M, n, 1, w->dx, n);
  memcpy(w->dt, w->dx, sizeof(double) * (size_t)n);
  twx_add_apply(m, n, w->G, m, w->dx, w->dt + n);
  for (int32_t i = 0; i < w->k; i++) w->dz[i] = w->weights[i] * w->dt[i] + w->dz0[i];
}
