/* Where the interior point found no solution: why there is none. Each proof is a quadratic program that has a solution.
 * Where there is no proof, there are two last attempts.
 *
 *   Infeasible:  minimise |violation of rows|^2 / 2 within the bounds of variables. Its multipliers are the violations;
 *                where they are not 0 they are a certificate.
 *   Unbounded:   minimise |d + g|^2 / 2 + d'H d / (2 curvature) over directions d that leave no constraint. Where d is
 *                not 0 and H d is, the cost falls along d without end: g'd = -|d|^2.
 *
 * Source: S. Boyd, L. Vandenberghe, Convex Optimization (2004), section 5.8.
 */
#include "qp_work.h"

static int32_t qp_certify_infeasible(twx_qp_work *w) {
  w->statistics->certificate = twx_qp_infeasible(w, &w->point);
  memcpy(w->point.z, w->dz, sizeof(double) * (size_t)w->k);
  return w->statistics->certificate <= w->options->certificate;
}

static int32_t qp_prove_infeasible(twx_qp_work *w) {
  const size_t n = (size_t)w->n;
  memset(w->H, 0, sizeof(double) * n * n), memset(w->g, 0, sizeof(double) * n);
  w->soft = 1;
  twx_qp_interior(w);
  return qp_certify_infeasible(w);
}

static int32_t qp_prove_unbounded(twx_qp_work *w) {
  for (int32_t i = 0; i < w->n * w->n; i++) w->H[i] /= w->options->curvature;
  for (int32_t j = 0; j < w->n; j++) w->H[j + j * w->n] += 1;
  for (int32_t i = 0; i < w->k; i++) {
    w->lower[i] = isfinite(w->lower[i]) ? 0 : -INFINITY, w->upper[i] = isfinite(w->upper[i]) ? 0 : INFINITY;
    if (w->lower[i] == w->upper[i]) w->kind[i] = TWX_QP_FIXED;
  }
  twx_qp_interior(w);
  twx_qp_reload(w);
  twx_qp_measure(w, &w->point);
  w->statistics->certificate = twx_qp_unbounded(w, &w->point);
  return w->statistics->certificate <= w->options->certificate;
}

/* Once more with other softness. Much of it keeps rounding errors of rows out of directions of small curvature; with
 * little of it multipliers of rows that almost depend on each other are found in fewer steps. */
static int32_t qp_solve_otherwise(twx_qp_work *w) {
  const double attempts[] = {w->options->softness_largest, w->options->softness_smallest};
  for (int32_t i = 0; i < 2; i++) {
    w->softness = attempts[i];
    if (twx_qp_interior(w) == TWX_QP_SOLVED) return 1;
  }
  return 0;
}

/* Neither: the best point, which may be a certificate itself. */
static twx_qp_status qp_give_up(twx_qp_work *w, twx_qp_status status) {
  twx_qp_copy(w, &w->point, &w->best);
  if (status != TWX_QP_INFEASIBLE && status != TWX_QP_UNBOUNDED) return status;
  twx_qp_measure(w, &w->point);
  if (status == TWX_QP_INFEASIBLE && qp_certify_infeasible(w)) return status;
  return TWX_QP_STALLED;
}

/* The status, with the point that belongs to it in `point`. */
twx_qp_status twx_qp_prove(twx_qp_work *w, twx_qp_status status) {
  w->proving = 1;
  if (qp_prove_infeasible(w)) status = TWX_QP_INFEASIBLE;
  else if (twx_qp_reload(w), qp_prove_unbounded(w)) status = TWX_QP_UNBOUNDED;
  else if (twx_qp_reload(w), qp_solve_otherwise(w)) status = TWX_QP_SOLVED;
  else status = qp_give_up(w, status);
  twx_qp_reload(w);
  twx_qp_measure(w, &w->point);
  if (status != TWX_QP_INFEASIBLE && status != TWX_QP_UNBOUNDED) w->statistics->certificate = INFINITY;
  return status;
}
