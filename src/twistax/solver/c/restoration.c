/* Feasibility restoration: least squares of the rows h + s and e, with the dynamics as constraints.
 *
 *   minimise  |h + s|^2 / 2 + |e|^2 / 2 + a barrier for bounds and slacks + zeta |v - v_here|^2 / 2   subject to  c = 0
 *
 * by Gauss-Newton steps of the same Riccati recursion, in which the rows have the softness 1. It ends where the filter
 * accepts the point, or at a stationary point of the violation, which the status INFEASIBLE reports.
 */
#include "work.h"

#define BARRIER_LEAST twx_max((real)1e-9, 8 * TWX_EPSILON) /* of the phase; there its stationary point is one of the violation */
#define BARRIER_DECREASE ((real)0.1)
#define LENGTH_LEAST twx_max((real)1e-12, 8 * TWX_EPSILON)
#define PENALTY_LEAST 1       /* multipliers that vanish would leave the defects free */
#define SLOPE_NEAR ((real)1e-2) /* over the least barrier; over others [WB] (7), kappa_epsilon */
#define SLOPE_STEEP ((real)1e-3) /* relative to the same: more is none, though rounding may hide the decrease */
#define SLOPE_LEAST twx_max((real)1e-8, 1024 * TWX_EPSILON) /* relative to the squares and the defects: less is a stationary point */

typedef struct {
  real barrier, penalty, slope, merit; /* penalty: of the l1 norm of the defects */
  real bounds;                         /* the barrier's part of the merit */
} phase;

static real merit_of(twx_work *w, const phase *f, const twx_values *at) {
  real merit = twx_barrier_of_bounds(w, at, f->barrier);
  for (size_t i = 0; i < w->defects; i++) merit += f->penalty * fabs(at->c[i]);
  for (size_t i = 0; i < w->rows; i++) merit += (at->h[i] + at->s[i]) / 2 * (at->h[i] + at->s[i]);
  for (size_t i = 0; i < (size_t)w->ne; i++) merit += at->e[i] / 2 * at->e[i];
  return merit;
}

/* The right side of the barrier function without the cost, its primal second derivatives, and the proximal term. */
static void restoring_right_side(twx_work *w, real barrier) {
  const real proximity = sqrt(w->barrier) * twx_min(1, barrier); /* [WB] 3.3.1, zeta */
  memset(w->gradient, 0, sizeof(real) * w->variables); /* restored by twx_differentiate after the step */
  twx_right_side(w, barrier);
  for (size_t i = 0; i < w->variables; i++) w->Sv[i] = proximity / twx_max(1, w->iterate.v[i] * w->iterate.v[i]);
  FOR_FREE(w, i) {
    const real low = twx_below(w, w->iterate.v, i), high = twx_above(w, w->iterate.v, i);
    if (twx_has(w->lower[i])) w->Sv[i] += barrier / (low * low);
    if (twx_has(w->upper[i])) w->Sv[i] += barrier / (high * high);
  }
  for (size_t i = 0; i < w->rows; i++) w->Ss[i] = barrier / (w->iterate.s[i] * w->iterate.s[i]);
}

static int32_t factorize_restoring(twx_work *w) {
  for (real identity = 0; !twx_factorize(w, identity, 0);) {
    identity = identity > 0 ? w->options->inertia_increase_first * identity : w->options->inertia_first * (real)1e-4;
    if (identity > w->options->inertia_largest) return 0;
  }
  return 1;
}

/* The merit function's slope along the step: rows change by y - r and ye - r, the defects vanish. */
static void measure_step(twx_work *w, phase *f) {
  const twx_iterate *d = &w->step;
  real defects = 0;
  f->slope = twx_slope(w, d);
  for (size_t i = 0; i < w->defects; i++) {
    f->penalty = twx_max(f->penalty, 2 * fabs(d->lambda[i]));
    defects += fabs(w->here.c[i]);
  }
  for (size_t i = 0; i < w->rows; i++) {
    const real row = w->here.h[i] + w->iterate.s[i];
    f->slope += row * (d->y[i] - row);
  }
  for (size_t i = 0; i < (size_t)w->ne; i++) f->slope += w->here.e[i] * (d->ye[i] - w->here.e[i]);
  f->slope -= f->penalty * defects;
  f->merit = merit_of(w, f, &w->here), f->bounds = twx_barrier_of_bounds(w, &w->here, f->barrier);
}

static int32_t is_lower(twx_work *w, const phase *f, real length) {
  return merit_of(w, f, &w->trial) <= f->merit + (real)1e-4 * length * f->slope + 10 * TWX_EPSILON * fabs(f->merit);
}

/* A second-order correction of the dynamics at the trial, as in [WB]: without one the penalty of curved dynamics
 * rejects all but short steps. */
static int32_t correct_defects(twx_work *w, const phase *f, real length) {
  twx_residual *r = &w->correction;
  memcpy(r->v, w->right.v, sizeof(real) * w->variables), memcpy(r->s, w->right.s, sizeof(real) * w->rows);
  memcpy(r->h, w->right.h, sizeof(real) * w->rows), memcpy(r->e, w->right.e, sizeof(real) * (size_t)w->ne);
  for (size_t i = 0; i < w->defects; i++) r->c[i] = length * w->right.c[i] + w->trial.c[i];
  twx_solve_system(w, r, &w->corrected, 0);
  w->statistics->corrections++;
  return !twx_move(w, &w->corrected, twx_primal_length(w, &w->corrected)) && is_lower(w, f, length);
}

static real search_merit(twx_work *w, const phase *f) {
  const real longest = twx_primal_length(w, &w->step);
  for (real length = longest; length > LENGTH_LEAST; length /= 2) {
    if (twx_move(w, &w->step, length)) continue;
    if (is_lower(w, f, length) || (length == longest && correct_defects(w, f, length))) return length;
  }
  return 0;
}

static void accept_restoring(twx_work *w) {
  memset(w->step.zl, 0, sizeof(real) * w->variables), memset(w->step.zu, 0, sizeof(real) * w->variables);
  memset(w->step.zs, 0, sizeof(real) * w->rows);
  twx_accept(w, 0, 0, w->barrier);
  w->statistics->restoration_iterations++;
}

/* TWX_SOLVED where the filter accepts the iterate. */
static twx_status reduce_violation(twx_work *w) {
  const twx_options *o = w->options;
  const real before = twx_violation(w, &w->here, 0);
  phase f = {.barrier = twx_max(w->barrier, twx_violation(w, &w->here, 1)), .penalty = PENALTY_LEAST};
  for (int32_t n = 0; n < (int32_t)o->restoration_iterations; n++) {
    restoring_right_side(w, f.barrier);
    if (!factorize_restoring(w)) return TWX_UNBOUNDED_CURVATURE;
    twx_solve_system(w, &w->right, &w->step, 0);
    measure_step(w, &f);
    const real length = f.slope > -SLOPE_LEAST * (f.merit - f.bounds) ? 0 : search_merit(w, &f);
    if (length > 0) {
      accept_restoring(w);
      if (twx_differentiate(w)) return TWX_NON_FINITE;
      const real violation = twx_violation(w, &w->here, 0);
      if (violation <= o->restoration_decrease * before && twx_filter_accepts(w, violation, twx_barrier(w, &w->here)))
        return TWX_SOLVED;
    }
    const real near = f.barrier < BARRIER_LEAST ? SLOPE_NEAR : o->barrier_error;
    if (length == 0 || f.slope > -near * f.barrier) {
      /* Where no step helps though a large part of the violation would vanish by one, or it overflows, nothing is
       * stationary. */
      const int32_t steep = !(f.slope >= -SLOPE_STEEP * (f.merit - f.bounds));
      if (f.barrier < BARRIER_LEAST) return length == 0 && steep ? TWX_STALLED : TWX_INFEASIBLE;
      f.barrier *= BARRIER_DECREASE;
    }
  }
  return TWX_MAX_ITERATIONS;
}

/* Multipliers of bounds that grew too large start anew. */
static void reset_multipliers(twx_work *w) {
  twx_iterate *q = &w->iterate;
  real most = 0;
  for (size_t i = 0; i < w->rows; i++) most = twx_max(most, q->zs[i]);
  for (size_t i = 0; i < w->variables; i++) most = twx_max(most, twx_max(q->zl[i], q->zu[i]));
  if (!(most > w->options->restoration_multiplier)) return;
  for (size_t i = 0; i < w->rows; i++) q->zs[i] = 1;
  FOR_FREE(w, i) q->zl[i] = twx_has(w->lower[i]), q->zu[i] = twx_has(w->upper[i]);
}

/* Restoration from the iterate; TWX_SOLVED where the search goes on from a better one. */
twx_status twx_restore(twx_work *w) {
  w->statistics->restorations++;
  w->softness = 1, w->weight = 0;
  const twx_status status = reduce_violation(w);
  w->softness = 0;
  if (status != TWX_SOLVED) {
    twx_differentiate(w); /* the cost's gradient, for the measures of the result */
    return status;
  }
  reset_multipliers(w);
  twx_least_squares_multipliers(w);
  return status;
}
