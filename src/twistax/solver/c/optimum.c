/* What a point is to second order: whether it is a minimum, and by how much its cost may be above that of the minimum. */
#include "work.h"

/* The worth of violations at the present multipliers. */
static real worth_of_violations(const twx_work *w) {
  const twx_iterate *q = &w->iterate;
  real sum = 0;
  for (size_t i = 0; i < w->defects; i++) sum += fabs(q->lambda[i] * w->here.c[i]);
  for (size_t i = 0; i < w->rows; i++) sum += fabs(q->y[i] * (w->here.h[i] + q->s[i]));
  for (size_t i = 0; i < (size_t)w->ne; i++) sum += fabs(q->ye[i] * w->here.e[i]);
  return sum;
}

/* The largest change of the cost, to first order, where a state moves by as much as it reaches, but at most by its unit. */
static real worth_of_states(const twx_work *w) {
  real *const reach = w->t3, most = 0;
  FOR_STAGES(w, k, s)
    for (int32_t i = 0; i < s->nx; i++) reach[i] = 0;
  FOR_STAGES(w, k, s)
    for (int32_t i = 0; i < s->nx; i++) reach[i] = twx_max(reach[i], fabs(w->iterate.v[s->v + (size_t)i]));
  FOR_STAGES(w, k, s)
    for (int32_t i = 0; i < s->next; i++)
      most = twx_max(most, fabs(w->iterate.lambda[s->c + (size_t)i]) * (reach[i] > 0 ? twx_min(1, reach[i]) : 1));
  return most;
}

/* What moves of all variables by their units change of the cost at most, to first order. */
static real worth_of_moves(const twx_work *w) {
  real sum = 0;
  FOR_FREE(w, i) sum += fabs(w->gradient[i]);
  return sum;
}

/* Sets `minimum`, whether the linear system has the inertia of a minimum but for rounding, and `excess`, the slope of the
 * cost along Newton's step to a barrier of zero with the worth of violations: no unit changes it. Returns whether the
 * excess is small beside the cost, or beside what states are worth where the cost is near zero; where they are worth
 * nothing either, as at rest without a task, it is a small share of what moves by the units would change.
 * Source: S. Boyd and L. Vandenberghe, Convex Optimization (2004), 9.5.1, the square of Newton's decrement. */
int32_t twx_measure_optimum(twx_work *w) {
  const twx_options *o = w->options;
  twx_statistics *t = w->statistics;
  t->minimum = 0, t->excess = INFINITY;
  t->worth = twx_max(TWX_EPSILON * TWX_EPSILON, twx_max(fabs(w->here.cost), twx_min(1, worth_of_states(w))));
  t->worth = twx_max(t->worth, o->excess_floor * worth_of_moves(w));
  if (twx_differentiate_twice(w)) return 0;
  twx_right_side(w, 0);
  t->minimum = twx_factorize_weighted(w, 0);
  for (real identity = twx_max((real)1e-12, 8 * TWX_EPSILON); !(t->minimum > 0) && identity <= o->curvature; identity *= 100) t->minimum = twx_factorize_weighted(w, identity);
  if (t->minimum > 0 || twx_correct_inertia(w)) {
    twx_solve_system(w, &w->right, &w->step, 1);
    t->excess = fabs(twx_slope(w, &w->step)) + worth_of_violations(w);
  }
  const int32_t is_close = t->excess <= o->excess * t->worth;
  t->excess /= w->cost_scale, t->worth /= w->cost_scale;
  return is_close;
}
