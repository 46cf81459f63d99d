/* The start of a solve: fixed variables, scales, the push into the bounds, first slacks and multipliers. */
#include "work.h"

/* Which variables are fixed; 0 where bounds cannot be. A state after the first is fixed by an equality, not by bounds. */
static int32_t read_bounds(twx_work *w) {
  const twx_problem *p = w->problem;
  for (size_t i = 0; i < w->variables; i++) {
    if (w->ones) w->ones[i] = 1;
    if (!(w->size[i] > 0) || !isfinite(w->size[i]) || !(p->lower[i] <= p->upper[i])) return 0;
    w->free[i] = p->lower[i] < p->upper[i];
    w->lower[i] = p->lower[i] / w->size[i], w->upper[i] = p->upper[i] / w->size[i];
  }
  for (int32_t k = 1; k <= w->N; k++)
    for (int32_t i = 0; i < w->stages[k].nx; i++)
      if (w->free[w->stages[k].v + (size_t)i] == 0) return 0;
  return 1;
}

/* The least slack of a start: at most that which the multiplier of a warm start has on the central path. */
static real least_slack(const twx_work *w, real push, real multiplier) {
  return w->options->warm_start > 0 && multiplier > 0 ? twx_min(push, w->barrier / multiplier) : push;
}

/* A value at a distance from its bounds. Source: [WB] 3.6. */
static real pushed(const twx_work *w, size_t i) {
  const twx_options *o = w->options;
  const real lower = w->lower[i], upper = w->upper[i], share = o->bound_share * (upper - lower);
  const real scale = w->cost_scale * w->size[i]; /* of multipliers, which are in the problem's units still */
  real v = w->iterate.v[i];
  if (twx_has(lower))
    v = twx_max(v, lower + least_slack(w, twx_min(o->bound_push * twx_max(1, fabs(lower)), share), scale * w->iterate.zl[i]));
  if (twx_has(upper))
    v = twx_min(v, upper - least_slack(w, twx_min(o->bound_push * twx_max(1, fabs(upper)), share), scale * w->iterate.zu[i]));
  return v;
}

/* Bounds relaxed relative to themselves, so that none at zero changes the sign of what is divided by; and the start moved
 * inside of them. */
static int32_t push_inside(twx_work *w) {
  const twx_options *o = w->options;
  real *const d = w->step.v, *const v = w->iterate.v;
  memset(d, 0, sizeof(real) * w->variables);
  for (size_t i = 0; i < w->variables; i++) {
    if (w->free[i] == 0) {
      d[i] = w->lower[i] - v[i];
      continue;
    }
    if (twx_has(w->lower[i])) w->lower[i] -= o->bound_relaxation * fabs(w->lower[i]);
    if (twx_has(w->upper[i])) w->upper[i] += o->bound_relaxation * fabs(w->upper[i]);
    d[i] = pushed(w, i) - v[i];
  }
  memset(w->step.s, 0, sizeof(real) * w->rows);
  memcpy(w->trial.z, w->here.z, sizeof(real) * w->points); /* what is reported where the move fails */
  const int32_t bad = twx_move(w, &w->step, 1);
  memcpy(v, w->trial.v, sizeof(real) * w->variables);
  if (!bad) twx_take_values(w);
  return bad;
}

/* The units of the problem; 0 where one is not positive. */
static int32_t read_units(twx_work *w) {
  const twx_problem *p = w->problem;
  int32_t good = p->cost_size > 0 && isfinite(p->cost_size);
  w->cost_scale = 1 / p->cost_size;
  for (size_t i = 0; i < w->rows; i++) {
    w->row_scale[i] = p->row_size ? 1 / p->row_size[i] : 1;
    good = good && w->row_scale[i] > 0 && isfinite(w->row_scale[i]);
  }
  for (size_t i = 0; i < (size_t)w->ne; i++) {
    w->equality_scale[i] = p->equality_size ? 1 / p->equality_size[i] : 1;
    good = good && w->equality_scale[i] > 0 && isfinite(w->equality_scale[i]);
  }
  return good;
}

/* Rows with large derivatives are divided further, as in [WB] 3.8, with their slacks and multipliers unless these are NULL. */
static int32_t scale_rows(const twx_work *w, const twx_stage *s, int32_t rows, const real *J, real *scale, real *y, real *slack) {
  int32_t scaled = 0;
  for (int32_t i = 0; i < rows; i++) {
    real most = 0;
    for (int32_t j = 0; j < s->n; j++) {
      const size_t variable = j < s->nv ? s->v + (size_t)j : w->variables - (size_t)(s->n - j);
      if (w->free[variable] != 0) most = twx_max(most, fabs(J[i + (size_t)j * (size_t)rows]));
    }
    if (!(most > w->options->row_gradient)) continue;
    const real factor = twx_max(w->options->row_gradient / most, (real)1e-8);
    scale[i] *= factor, scaled = 1;
    if (y) y[i] /= factor;
    if (y && slack) slack[i] *= factor;
  }
  return scaled;
}

/* The functions and their derivatives at the start, scaled; `early`: with multipliers, which are in the core's units. */
static int32_t scale_functions(twx_work *w, int32_t early) {
  twx_iterate *q = &w->iterate;
  const real limit = w->options->objective_gradient;
  real most = 0;
  if (early ? twx_differentiate_both(w) : twx_differentiate(w)) return 1;
  FOR_FREE(w, i) most = twx_max(most, fabs(w->gradient[i]));
  int32_t scaled = limit > 0 && most > limit;
  if (scaled) w->cost_scale *= twx_max(limit / most, (real)1e-8);
  FOR_STAGES(w, k, s) {
    scaled |= scale_rows(w, s, s->nh, w->Jh + s->Jh, w->row_scale + s->h, early ? q->y + s->h : NULL, q->s + s->h);
    scaled |= scale_rows(w, s, s->ne, w->Je + s->Je, w->equality_scale + s->e, early ? q->ye + s->e : NULL, NULL);
  }
  return scaled && (twx_evaluate(w, &w->here) || twx_differentiate(w));
}

static real within(real a, real low, real high) { return twx_max(twx_min(a, high), low); }

/* First slacks, and multipliers of bounds: barrier over slack or a constant; of a warm start those that it has. */
static void start_bounds(twx_work *w) {
  const twx_options *o = w->options;
  twx_iterate *q = &w->iterate;
  const real constant = o->multiplier_start, range = o->warm_range;
  const int warm = o->warm_start > 0;
  for (size_t i = 0; i < w->rows; i++) {
    q->s[i] = twx_max(twx_max(warm ? q->s[i] : 0, -w->here.h[i]), least_slack(w, o->slack_push, q->y[i]));
    const real central = w->barrier / q->s[i];
    q->zs[i] = warm ? within(q->y[i], central / range, central * range) : constant > 0 ? constant : central;
  }
  for (size_t i = 0; i < w->variables; i++) {
    const real low = w->barrier / twx_below(w, q->v, i), high = w->barrier / twx_above(w, q->v, i);
    const int has_low = w->free[i] != 0 && twx_has(w->lower[i]), has_high = w->free[i] != 0 && twx_has(w->upper[i]);
    q->zl[i] = !has_low ? 0 : warm ? within(q->zl[i], low / range, low * range) : constant > 0 ? constant : low;
    q->zu[i] = !has_high ? 0 : warm ? within(q->zu[i], high / range, high * range) : constant > 0 ? constant : high;
  }
}

/* Multipliers of c, h and e that make the Lagrangian's gradient least; zero where they are large. Source: [WB] (36). */
void twx_least_squares_multipliers(twx_work *w) {
  twx_iterate *q = &w->iterate, *d = &w->step;
  twx_residual *r = &w->right;
  real most = 0;
  for (size_t i = 0; i < w->variables; i++) w->Sv[i] = 1, r->v[i] = w->gradient[i] - q->zl[i] + q->zu[i];
  for (size_t i = 0; i < w->rows; i++) w->Ss[i] = 1, r->s[i] = -q->zs[i], r->h[i] = 0;
  memset(r->c, 0, sizeof(real) * w->defects), memset(r->e, 0, sizeof(real) * (size_t)w->ne);
  int32_t good = twx_factorize(w, 0, 0);
  if (good) {
    twx_solve_system(w, r, d, 0);
    for (size_t i = 0; i < w->defects; i++) most = twx_max(most, fabs(d->lambda[i]));
    for (size_t i = 0; i < w->rows; i++) most = twx_max(most, fabs(d->y[i]));
    for (size_t i = 0; i < (size_t)w->ne; i++) most = twx_max(most, fabs(d->ye[i]));
    good = most <= w->options->least_squares_limit;
  }
  for (size_t i = 0; i < w->defects; i++) q->lambda[i] = good ? d->lambda[i] : 0;
  for (size_t i = 0; i < w->rows; i++) q->y[i] = good ? d->y[i] : 0;
  for (size_t i = 0; i < (size_t)w->ne; i++) q->ye[i] = good ? d->ye[i] : 0;
  w->has_hessian = 0;
}

static void set_barrier(twx_work *w) {
  const twx_options *o = w->options;
  w->exactness = 1, w->acceptable_age = 0, w->barrier = o->barrier_start, w->fraction = twx_max(o->boundary_fraction, 1 - w->barrier);
  w->identity = w->last_identity = w->softness = 0, w->weight = 0, w->filter_rows = 0;
}

/* A warm start's multipliers, from the problem's units to the core's. */
static void scale_multipliers(twx_work *w) {
  twx_iterate *q = &w->iterate;
  for (int32_t k = 0; k < w->N; k++)
    for (int32_t i = 0; i < w->stages[k].next; i++)
      q->lambda[w->stages[k].c + (size_t)i] *= w->cost_scale * w->size[w->stages[k + 1].v + (size_t)i];
  for (size_t i = 0; i < w->rows; i++) q->y[i] *= w->cost_scale / w->row_scale[i], q->s[i] *= w->row_scale[i];
  for (size_t i = 0; i < (size_t)w->ne; i++) q->ye[i] *= w->cost_scale / w->equality_scale[i];
  for (size_t i = 0; i < w->variables; i++) q->zl[i] *= w->cost_scale * w->size[i], q->zu[i] *= w->cost_scale * w->size[i];
}

/* Bounds and units, and the multipliers of the iterate in these; 0 where they cannot be. */
int32_t twx_read_problem(twx_work *w) {
  set_barrier(w);
  if (!read_bounds(w) || !read_units(w)) return 0;
  scale_multipliers(w);
  return 1;
}

twx_status twx_start(twx_work *w) {
  const twx_options *o = w->options;
  twx_iterate *q = &w->iterate;
  if (!read_bounds(w) || !read_units(w)) return TWX_BAD_PROBLEM;
  for (size_t i = 0; i < w->variables; i++) q->v[i] /= w->size[i];
  set_barrier(w);
  const int32_t warm = o->warm_start > 0, early = warm && !(o->objective_gradient > 0);
  if (push_inside(w)) return TWX_NON_FINITE;
  if (early) scale_multipliers(w);
  if (scale_functions(w, early)) return TWX_NON_FINITE;
  w->statistics->cost_scale = w->cost_scale;
  twx_place_equalities(w);
  if (warm && !early) scale_multipliers(w);
  start_bounds(w);
  if (!warm) {
    memset(q->lambda, 0, sizeof(real) * w->defects), memset(q->y, 0, sizeof(real) * w->rows);
    memset(q->ye, 0, sizeof(real) * (size_t)w->ne);
    if (o->least_squares_limit > 0) twx_least_squares_multipliers(w);
  }
  const real violation = twx_max(1, twx_violation(w, &w->here, 0));
  w->violation_small = o->violation_small * violation, w->violation_large = o->violation_large * violation;
  return TWX_SOLVED;
}
