/* How a solution moves: the linear system of the first-order conditions at a point, solved for many right sides.
 *
 * Variables of equal bounds are fixed: they move by what a right side has for them. With K the matrix of the system in
 * (v, lambda, y, ye), slacks and multipliers of bounds eliminated by their weights multiplier / slack, and g the gradient
 * of the cost, a side b gives the moves d of
 *
 *   K_free d = b_free,   d_fixed = b_fixed,   d_cost = g'd + b_cost,   K = [H + Wv, F' - 1, Jh', Je'; F - 1, 0; Jh, -1/Wh; Je, 0],
 *
 * or of the transposed equations. Source: A. V. Fiacco, Introduction to sensitivity and stability analysis in nonlinear
 * programming (1983), theorem 3.2.1.
 */
#include "work.h"

static size_t side_size(const twx_work *w) { return w->variables + w->defects + w->rows + (size_t)w->ne; }

/* The units of moves, in `best`, and of right sides, in `corrected`, by v | c | h | e. */
static void units_of_sides(twx_work *w, real *moves, real *sides) {
  real *const of_c = moves + w->variables, *const c = sides + w->variables;
  for (size_t i = 0; i < w->variables; i++)
    moves[i] = w->size[i], sides[i] = w->free[i] != 0 ? w->cost_scale * w->size[i] : 1 / w->size[i];
  for (int32_t k = 0; k < w->N; k++)
    for (int32_t i = 0; i < w->stages[k].next; i++) {
      const real size = w->size[w->stages[k + 1].v + (size_t)i];
      of_c[w->stages[k].c + (size_t)i] = 1 / (w->cost_scale * size), c[w->stages[k].c + (size_t)i] = 1 / size;
    }
  real *const of_h = of_c + w->defects, *const h = c + w->defects;
  for (size_t i = 0; i < w->rows; i++) of_h[i] = w->row_scale[i] / w->cost_scale, h[i] = w->row_scale[i];
  for (size_t i = 0; i < (size_t)w->ne; i++)
    of_h[w->rows + i] = w->equality_scale[i] / w->cost_scale, h[w->rows + i] = w->equality_scale[i];
}

static void clear(twx_work *w, twx_iterate *d) {
  memset(d->v, 0, sizeof(real) * w->point_size);
}

/* right = K d, of the iterate `step`, whose multipliers are zero. */
static void push(twx_work *w) {
  twx_residual *const zero = &w->correction;
  memset(zero->v, 0, sizeof(real) * w->variables), memset(zero->s, 0, sizeof(real) * w->rows);
  memset(zero->c, 0, sizeof(real) * w->defects), memset(zero->h, 0, sizeof(real) * w->rows);
  memset(zero->e, 0, sizeof(real) * (size_t)w->ne);
  twx_product(w, zero, &w->step, &w->right, 1);
}

/* right -= side, of which fixed variables are no part. */
static void subtract(twx_work *w, const real *side) {
  twx_residual *const r = &w->right;
  const real *const c = side + w->variables, *const h = c + w->defects, *const e = h + w->rows;
  FOR_FREE(w, i) r->v[i] -= side[i];
  for (size_t i = 0; i < w->defects; i++) r->c[i] -= c[i];
  for (size_t i = 0; i < w->rows; i++) r->h[i] -= h[i], r->s[i] = 0;
  for (size_t i = 0; i < (size_t)w->ne; i++) r->e[i] -= e[i];
}

static void write(const twx_work *w, const twx_iterate *d, real *side) {
  real *const c = side + w->variables, *const h = c + w->defects, *const e = h + w->rows;
  FOR_FREE(w, i) side[i] = d->v[i];
  memcpy(c, d->lambda, sizeof(real) * w->defects), memcpy(h, d->y, sizeof(real) * w->rows);
  memcpy(e, d->ye, sizeof(real) * (size_t)w->ne);
}

static void move_along(twx_work *w, real *side, real *cost) {
  clear(w, &w->step);
  for (size_t i = 0; i < w->variables; i++) w->step.v[i] = w->free[i] != 0 ? 0 : side[i];
  push(w), subtract(w, side);
  twx_solve_system(w, &w->right, &w->step, 1);
  write(w, &w->step, side);
  for (size_t i = 0; i < w->variables; i++) *cost += w->gradient[i] * side[i];
}

static void pull_back(twx_work *w, real *side, real cost) {
  for (size_t i = 0; i < w->variables; i++) side[i] += w->gradient[i] * cost;
  clear(w, &w->step), push(w), subtract(w, side);
  twx_solve_system(w, &w->right, &w->step, 1);
  for (size_t i = 0; i < w->variables; i++) if (w->free[i] == 0) w->step.v[i] = 0;
  push(w);
  write(w, &w->step, side);
  for (size_t i = 0; i < w->variables; i++) if (w->free[i] == 0) side[i] -= w->right.v[i];
}

/* Weights in the core's units. */
static void take_weights(twx_work *w, const twx_point *at) {
  for (size_t i = 0; i < w->variables; i++) w->Sv[i] = w->free[i] != 0 ? at->bound_weights[i] * w->size[i] * w->size[i] * w->cost_scale : 0;
  for (size_t i = 0; i < w->rows; i++) w->Ss[i] = at->row_weights[i] * w->cost_scale / (w->row_scale[i] * w->row_scale[i]);
}

static twx_status adopt(twx_work *w, const twx_point *at) {
  twx_iterate *q = &w->iterate;
  clear(w, q);
  memcpy(w->here.z, at->z, sizeof(real) * w->points), memcpy(q->lambda, at->lambda, sizeof(real) * w->defects);
  memcpy(q->y, at->y, sizeof(real) * w->rows), memcpy(q->ye, at->ye, sizeof(real) * (size_t)w->ne);
  if (!twx_read_problem(w)) return TWX_BAD_PROBLEM;
  if (twx_evaluate(w, &w->here) || twx_differentiate(w) || twx_differentiate_twice(w)) return TWX_NON_FINITE;
  take_weights(w, at);
  twx_place_equalities(w);
  return TWX_SOLVED;
}

int32_t twx_linearised(const twx_problem *problem, const twx_options *options, const twx_point *at, int32_t transposed,
                       int32_t count, real *sides, real *workspace) {
  twx_work work, *const w = &work;
  twx_statistics statistics = {0};
  if (!twx_workspace_size(problem, sizeof(real))) return TWX_BAD_PROBLEM;
  twx_carve(w, problem, workspace);
  w->problem = problem, w->options = options, w->statistics = &statistics;
  const twx_status status = adopt(w, at);
  if (status != TWX_SOLVED) return status;
  /* What is zero may be above it by rounding: a strict minimum is one with a little less on the diagonal, too. */
  if (!twx_factorize_weighted(w, -options->curvature) || !twx_factorize_weighted(w, 0)) return TWX_UNBOUNDED_CURVATURE;
  real *const moves = w->best.v, *const units = w->corrected.v;
  const size_t n = side_size(w);
  units_of_sides(w, moves, units);
  const real *const before = transposed ? moves : units, *const after = transposed ? units : moves;
  for (int32_t k = 0; k < count; k++) {
    real *const side = sides + (size_t)k * (n + 1), *const cost = side + n;
    for (size_t i = 0; i < n; i++) side[i] *= before[i];
    *cost *= transposed ? 1 / w->cost_scale : w->cost_scale;
    if (transposed) pull_back(w, side, *cost);
    else move_along(w, side, cost);
    for (size_t i = 0; i < n; i++) side[i] *= after[i];
    *cost *= transposed ? w->cost_scale : 1 / w->cost_scale;
  }
  return TWX_SOLVED;
}
