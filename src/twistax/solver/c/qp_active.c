/* Steps with a guess of the active bounds: a primal-dual active set, which is a semismooth Newton method.
 * Source: M. Hintermueller, K. Ito, K. Kunisch, The primal-dual active set strategy as a semismooth Newton method, SIAM
 * J. Optimization 13 (2003). It need not converge; where it does, it ends with an exact solution.
 */
#include "qp_work.h"

/* A bound is active where its multiplier, over its size, is larger than its slack. */
void twx_qp_guess(const twx_qp_work *w, const twx_qp_point *q, const double *t, int32_t *active) {
  for (int32_t i = 0; i < w->k; i++) {
    const double z = q->z[i] * q->X, Z = q->Z;
    active[i] = 0;
    if (w->kind[i] != TWX_QP_BOUNDED) continue;
    if (z > (w->upper[i] - t[i]) * Z) active[i] = 1;
    else if (-z > (t[i] - w->lower[i]) * Z) active[i] = -1;
  }
}

/* Solve H x + g + G'z = 0 with the active bounds met, from `trial`: steps with one factor, as long as they help. */
static int32_t qp_solve_with_active(twx_qp_work *w) {
  const twx_qp_options *o = w->options;
  twx_qp_point *const q = &w->trial;
  for (int32_t i = 0; i < w->k; i++) {
    const int32_t active = w->kind[i] == TWX_QP_FIXED || w->active[i];
    w->weights[i] = active ? 1 / twx_qp_softness(w, i) : 0;
    if (!active) q->z[i] = 0;
  }
  if (!twx_qp_factorize_regularized(w)) return 0;
  double before = INFINITY;
  for (int32_t pass = 0; pass < (int32_t)o->corrections; pass++) {
    twx_qp_measure(w, q);
    double error = q->stationarity;
    for (int32_t i = 0; i < w->k; i++) {
      w->r[i] = w->dz0[i] = 0;
      if (w->weights[i] == 0) continue;
      w->r[i] = q->t[i] - (w->active[i] > 0 ? w->upper[i] : w->lower[i]);
      if (w->r[i] != 0) error = twx_max(error, fabs(w->r[i]) / q->X);
    }
    if (pass && (!(error < o->correction_decrease * before) || error < o->rounding * o->tolerance)) break;
    before = pass ? error : INFINITY;
    twx_qp_step(w, q);
    for (int32_t j = 0; j < w->n; j++) q->x[j] += w->dx[j];
    for (int32_t i = 0; i < w->k; i++) q->z[i] += w->dz[i];
  }
  return isfinite(q->error);
}

/* The set of bounds that the point asks for; how many differ. */
static int32_t qp_change_active(twx_qp_work *w) {
  const twx_qp_point *q = &w->trial;
  const double small = w->options->tolerance;
  int32_t changes = 0;
  for (int32_t i = 0; i < w->k; i++) {
    if (w->kind[i] != TWX_QP_BOUNDED) continue;
    const int32_t before = w->active[i];
    int32_t now = before;
    if (before * q->z[i] < -small * q->Z) now = 0;
    if (!before && q->t[i] - w->upper[i] > small * q->X) now = 1;
    if (!before && w->lower[i] - q->t[i] > small * q->X) now = -1;
    w->active[i] = now, changes += now != before;
  }
  return changes;
}

/* From x and z in `trial` and the guess in `active`. 1 where that becomes a solution, which `point` then is.
 *
 * Where the set is right and its equations are not solved, the cost has less curvature along the rows than rounding makes
 * of their weights: more softness makes the weights smaller.
 */
int32_t twx_qp_active_set(twx_qp_work *w, int32_t changes) {
  const double softness = w->softness, largest = w->options->softness_largest;
  for (int32_t change = 0; change <= changes && qp_solve_with_active(w); change++) {
    if (w->trial.error <= w->options->tolerance) {
      const twx_qp_point solution = w->trial;
      w->trial = w->point, w->point = solution;
      return 1;
    }
    const int32_t changed = qp_change_active(w);
    if (!changed && !(w->softness < largest)) break;
    if (changed) w->statistics->changes++;
    else w->softness = largest;
  }
  w->softness = softness;
  return 0;
}
