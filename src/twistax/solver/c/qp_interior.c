/* The interior point: Mehrotra's predictor and corrector with two-sided bounds. Source: [M], [NW] Algorithm 16.4.
 *
 * v follows t and stays strictly inside of its bounds, with slacks sl = v - lower, su = upper - v and their multipliers
 * zl, zu. Slacks have arrays: computed from v, rounding would make them 0. A step satisfies
 *
 *   dv = dt + (t - v) - softness dz,     sl dzl + zl dv = -cl,     su dzu - zu dv = -cu.
 */
#include "qp_work.h"

static double qp_push(double t, double l, double u, double distance, double share) {
  if (isfinite(l) && isfinite(u)) distance = twx_min(distance, share * (u - l));
  return twx_min(twx_max(t, l + distance), u - distance);
}

/* x: a step towards the constraints, each with weight 1; v as far inside as x is large; products s z all the same. */
static int32_t qp_start(twx_qp_work *w) {
  const twx_qp_options *o = w->options;
  twx_qp_point *const q = &w->point;
  for (int32_t j = 0; j < w->n; j++) q->x[j] = twx_min(twx_max(0, w->lower[j]), w->upper[j]);
  memset(q->z, 0, sizeof(double) * (size_t)w->k), w->first_gradient = 0;
  twx_qp_measure(w, q);
  for (int32_t i = 0; i < w->k; i++) {
    w->weights[i] = w->kind[i] == TWX_QP_FIXED ? 1 / twx_qp_softness(w, i) : w->kind[i] == TWX_QP_BOUNDED ? 1 : 0;
    w->r[i] = q->t[i] - twx_min(twx_max(q->t[i], w->lower[i]), w->upper[i]), w->dz0[i] = 0;
  }
  if (!twx_qp_factorize_regularized(w)) return 0;
  twx_qp_step(w, q);
  for (int32_t j = 0; j < w->n; j++) q->x[j] = twx_min(twx_max(q->x[j] + w->dx[j], w->lower[j]), w->upper[j]);
  twx_qp_measure(w, q);
  for (int32_t j = 0; j < w->n; j++) w->first_gradient = twx_max(w->first_gradient, fabs(q->Hx[j]));
  const double size = q->X * twx_max(1, q->violation), X = size > 0 ? size : q->Z > 0 ? q->Z : 1;
  const double distance = o->start_push * X;
  for (int32_t j = 0; j < w->n; j++)
    if (w->kind[j] == TWX_QP_BOUNDED) q->x[j] = qp_push(q->x[j], w->lower[j], w->upper[j], distance, o->start_share);
  const double Z = q->Z > 0 ? q->Z : X;
  for (int32_t i = 0; i < w->k; i++) {
    w->v[i] = q->t[i], w->zl[i] = w->zu[i] = w->dv[i] = w->dzl[i] = w->dzu[i] = 0;
    if (w->kind[i] != TWX_QP_BOUNDED) continue;
    w->v[i] = qp_push(q->t[i], w->lower[i], w->upper[i], distance, o->start_share);
    w->sl[i] = w->v[i] - w->lower[i], w->su[i] = w->upper[i] - w->v[i];
    if (isfinite(w->lower[i])) w->zl[i] = Z * distance / w->sl[i];
    if (isfinite(w->upper[i])) w->zu[i] = Z * distance / w->su[i];
    q->z[i] = w->zu[i] - w->zl[i];
  }
  twx_qp_measure(w, q);
  return 1;
}

/* The mean of the products s z after a step of a length. */
static double qp_mean(const twx_qp_work *w, double length) {
  double sum = 0;
  int32_t count = 0;
  for (int32_t i = 0; i < w->k; i++) {
    if (w->kind[i] != TWX_QP_BOUNDED) continue;
    if (isfinite(w->lower[i])) sum += (w->sl[i] + length * w->dv[i]) * (w->zl[i] + length * w->dzl[i]), count++;
    if (isfinite(w->upper[i])) sum += (w->su[i] - length * w->dv[i]) * (w->zu[i] + length * w->dzu[i]), count++;
  }
  return count ? sum / count : 0;
}

/* The longest step that keeps slacks and multipliers at 0 or more. */
static double qp_longest(const twx_qp_work *w) {
  double inverse = 0;
  for (int32_t i = 0; i < w->k; i++) {
    if (w->kind[i] != TWX_QP_BOUNDED) continue;
    if (isfinite(w->lower[i])) {
      inverse = twx_max(inverse, -w->dv[i] / w->sl[i]);
      inverse = twx_max(inverse, -w->dzl[i] / w->zl[i]);
    }
    if (isfinite(w->upper[i])) {
      inverse = twx_max(inverse, w->dv[i] / w->su[i]);
      inverse = twx_max(inverse, -w->dzu[i] / w->zu[i]);
    }
  }
  return inverse > 0 ? 1 / inverse : INFINITY;
}

static void qp_weigh(twx_qp_work *w) {
  for (int32_t i = 0; i < w->k; i++) {
    const double softness = twx_qp_softness(w, i);
    double sigma = 0;
    if (w->kind[i] == TWX_QP_BOUNDED && isfinite(w->lower[i])) sigma += w->zl[i] / w->sl[i];
    if (w->kind[i] == TWX_QP_BOUNDED && isfinite(w->upper[i])) sigma += w->zu[i] / w->su[i];
    w->weights[i] = w->kind[i] == TWX_QP_FIXED ? 1 / softness : sigma / (1 + softness * sigma);
  }
}

/* A step whose products are to become `target`; with products of the step before as second order where `corrected`. */
static void qp_direction(twx_qp_work *w, double target, int32_t corrected) {
  for (int32_t i = 0; i < w->k; i++) {
    double cl = 0, cu = 0, q = 0;
    w->r[i] = w->kind[i] == TWX_QP_FREE ? 0 : w->point.t[i] - (w->kind[i] == TWX_QP_FIXED ? w->lower[i] : w->v[i]);
    if (w->kind[i] == TWX_QP_BOUNDED) {
      const double sl = w->sl[i], su = w->su[i];
      if (isfinite(sl)) cl = sl * w->zl[i] - target + (corrected ? w->dv[i] * w->dzl[i] : 0), q += cl / sl;
      if (isfinite(su)) cu = su * w->zu[i] - target - (corrected ? w->dv[i] * w->dzu[i] : 0), q -= cu / su;
    }
    w->dzl[i] = cl, w->dzu[i] = cu;
    w->dz0[i] = q * (1 - twx_qp_softness(w, i) * w->weights[i]); /* q / (1 + softness Sigma) */
  }
  twx_qp_step(w, &w->point);
  for (int32_t i = 0; i < w->k; i++) {
    if (w->kind[i] != TWX_QP_BOUNDED) continue;
    const double sl = w->sl[i], su = w->su[i];
    const double dv = w->dv[i] = w->dt[i] + w->r[i] - twx_qp_softness(w, i) * w->dz[i];
    w->dzl[i] = isfinite(sl) ? -(w->dzl[i] + w->zl[i] * dv) / sl : 0;
    w->dzu[i] = isfinite(su) ? -(w->dzu[i] - w->zu[i] * dv) / su : 0;
  }
}

static double qp_advance(twx_qp_work *w) {
  const double mean = qp_mean(w, 0);
  qp_direction(w, 0, 0);
  const double affine = twx_min(1, qp_longest(w)), ratio = mean > 0 ? qp_mean(w, affine) / mean : 0;
  if (mean > 0) qp_direction(w, mean * pow(twx_max(ratio, 0), w->options->centering_power), 1);
  const twx_qp_options *o = w->options;
  const double fraction = twx_max(o->boundary_fraction, twx_min(1 - ratio, o->boundary_largest));
  const double length = twx_min(1, fraction * qp_longest(w));
  twx_qp_point *const q = &w->point;
  for (int32_t j = 0; j < w->n; j++) q->x[j] += length * w->dx[j];
  for (int32_t i = 0; i < w->k; i++) {
    if (w->kind[i] == TWX_QP_FIXED) q->z[i] += length * w->dz[i];
    if (w->kind[i] != TWX_QP_BOUNDED) continue;
    w->v[i] += length * w->dv[i], w->sl[i] += length * w->dv[i], w->su[i] -= length * w->dv[i];
    w->zl[i] += length * w->dzl[i], w->zu[i] += length * w->dzu[i];
    q->z[i] = w->zu[i] - w->zl[i];
  }
  twx_qp_measure(w, q);
  return length;
}

/* The equations of the bounds that the iterate approaches, once these stay the same or the iterate is a solution. */
static int32_t qp_finish(twx_qp_work *w) {
  twx_qp_guess(w, &w->point, w->v, w->active);
  int32_t same = 1;
  for (int32_t i = 0; i < w->k; i++) same &= w->active[i] == w->tried[i], w->tried[i] = w->active[i];
  if (!same && w->point.error > w->options->tolerance) return 0;
  twx_qp_copy(w, &w->trial, &w->point);
  return twx_qp_active_set(w, (int32_t)w->options->finish_changes);
}

twx_qp_status twx_qp_interior(twx_qp_work *w) {
  const twx_qp_options *o = w->options;
  twx_qp_statistics *const s = w->statistics;
  const twx_qp_status failed = o->convexity > 0 ? TWX_QP_STALLED : TWX_QP_NOT_CONVEX; /* H was tested, or was not */
  if (!qp_start(w)) return failed;
  for (int32_t i = 0; i < w->k; i++) w->tried[i] = 2; /* no set of bounds */
  double best = INFINITY;
  for (int32_t shorter = 0, end = s->iterations + (int32_t)o->iterations; s->iterations < end; s->iterations++) {
    if (!w->proving && w->point.error < best) {
      best = w->point.error;
      twx_qp_copy(w, &w->best, &w->point);
    }
    if (qp_finish(w) || w->point.error <= o->tolerance) return TWX_QP_SOLVED;
    if (!w->proving && twx_qp_infeasible(w, &w->point) <= o->suspicion) {
      twx_qp_copy(w, &w->best, &w->point);
      return TWX_QP_INFEASIBLE;
    }
    if (twx_qp_unbounded(w, &w->point) <= (w->proving ? o->certificate : o->suspicion)) return TWX_QP_UNBOUNDED;
    qp_weigh(w);
    if (!twx_qp_factorize_regularized(w)) return failed;
    shorter = qp_advance(w) < o->shortest_step ? shorter + 1 : 0;
    if (shorter > 2) return TWX_QP_STALLED;
  }
  return w->point.error <= o->tolerance ? TWX_QP_SOLVED : TWX_QP_MAX_ITERATIONS;
}
