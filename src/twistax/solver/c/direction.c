/* The right side of a step, the steps of the multipliers of bounds, and the lengths that stay inside the bounds. */
#include "work.h"

/* Gradients of the barrier function by v and s, second derivatives of its primal-dual form, and the residuals.
 * Source: [WB] (9) to (13). */
void twx_right_side(twx_work *w, real barrier) {
  const twx_iterate *q = &w->iterate;
  twx_residual *r = &w->right;
  const real damping = w->options->damping * barrier;
  memset(w->Sv, 0, sizeof(real) * w->variables);
  memcpy(r->v, w->gradient, sizeof(real) * w->variables);
  FOR_FREE(w, i) {
    const int low = twx_has(w->lower[i]), high = twx_has(w->upper[i]);
    if (low) {
      const real slack = twx_below(w, q->v, i);
      w->Sv[i] += q->zl[i] / slack, r->v[i] += (high ? 0 : damping) - barrier / slack;
    }
    if (high) {
      const real slack = twx_above(w, q->v, i);
      w->Sv[i] += q->zu[i] / slack, r->v[i] += barrier / slack - (low ? 0 : damping);
    }
  }
  for (size_t i = 0; i < w->rows; i++) {
    w->Ss[i] = q->zs[i] / q->s[i], r->s[i] = damping - barrier / q->s[i];
    r->h[i] = w->here.h[i] + q->s[i];
  }
  memcpy(r->c, w->here.c, sizeof(real) * w->defects);
  memcpy(r->e, w->here.e, sizeof(real) * (size_t)w->ne);
}

/* Source: [WB] (12). */
void twx_step_of_bounds(twx_work *w, twx_iterate *d) {
  const twx_iterate *q = &w->iterate;
  memset(d->zl, 0, sizeof(real) * w->variables), memset(d->zu, 0, sizeof(real) * w->variables);
  FOR_FREE(w, i) {
    if (twx_has(w->lower[i])) {
      const real slack = twx_below(w, q->v, i);
      d->zl[i] = w->barrier / slack - q->zl[i] - q->zl[i] / slack * d->v[i];
    }
    if (twx_has(w->upper[i])) {
      const real slack = twx_above(w, q->v, i);
      d->zu[i] = w->barrier / slack - q->zu[i] + q->zu[i] / slack * d->v[i];
    }
  }
  for (size_t i = 0; i < w->rows; i++) d->zs[i] = w->barrier / q->s[i] - q->zs[i] - q->zs[i] / q->s[i] * d->s[i];
}

/* Source: [WB] (15a); and no entry moves by more than its largest step. To a bound at zero goes no step by more than the
 * least fraction: what is divided by it changes by as large a factor, and no derivative says what then is. */
real twx_primal_length(const twx_work *w, const twx_iterate *d) {
  const twx_iterate *q = &w->iterate;
  const real *const largest = w->problem->largest_step;
  real length = 1;
  FOR_FREE(w, i) {
    const real bound = d->v[i] < 0 ? w->lower[i] : w->upper[i];
    const real distance = d->v[i] < 0 ? twx_below(w, q->v, i) : twx_above(w, q->v, i);
    const real fraction = bound == 0 ? w->options->boundary_fraction : w->fraction;
    if (d->v[i] != 0 && twx_has(bound)) length = twx_min(length, fraction * distance / fabs(d->v[i]));
    if (!largest) continue;
    const real limit = largest[i] > 0 ? largest[i] / w->size[i] : -largest[i] * fabs(q->v[i]);
    if (fabs(d->v[i]) > limit) length = twx_min(length, limit / fabs(d->v[i]));
  }
  for (size_t i = 0; i < w->rows; i++)
    if (d->s[i] < 0) length = twx_min(length, -w->fraction * q->s[i] / d->s[i]);
  return length;
}

/* Source: [WB] (15b). */
real twx_dual_length(const twx_work *w, const twx_iterate *d) {
  const twx_iterate *q = &w->iterate;
  real length = 1;
  for (size_t i = 0; i < w->variables; i++) {
    if (d->zl[i] < 0) length = twx_min(length, -w->fraction * q->zl[i] / d->zl[i]);
    if (d->zu[i] < 0) length = twx_min(length, -w->fraction * q->zu[i] / d->zu[i]);
  }
  for (size_t i = 0; i < w->rows; i++)
    if (d->zs[i] < 0) length = twx_min(length, -w->fraction * q->zs[i] / d->zs[i]);
  return length;
}

/* The directional derivative of the barrier function. */
real twx_slope(const twx_work *w, const twx_iterate *d) {
  real slope = 0;
  FOR_FREE(w, i) slope += w->right.v[i] * d->v[i];
  for (size_t i = 0; i < w->rows; i++) slope += w->right.s[i] * d->s[i];
  return slope;
}
