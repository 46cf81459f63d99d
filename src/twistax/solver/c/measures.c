/* How far a point is from a solution: violation, barrier function, and the scaled error of the optimality conditions. */
#include "work.h"

/* Sum of the absolute violations of c, h + s and e, or the largest of them. */
real twx_violation(const twx_work *w, const twx_values *at, int32_t largest) {
  real sum = 0, most = 0;
  for (size_t i = 0; i < w->defects; i++) sum += fabs(at->c[i]), most = twx_max(most, fabs(at->c[i]));
  for (size_t i = 0; i < w->rows; i++) sum += fabs(at->h[i] + at->s[i]), most = twx_max(most, fabs(at->h[i] + at->s[i]));
  for (size_t i = 0; i < (size_t)w->ne; i++) sum += fabs(at->e[i]), most = twx_max(most, fabs(at->e[i]));
  return largest ? most : sum;
}

/* Sum of logarithms: the factors are multiplied, and few logarithms taken. */
static void add_logarithm(real *sum, real *product, real factor) {
  *product *= factor;
  if (*product < TWX_LEAST_PRODUCT || *product > 1 / TWX_LEAST_PRODUCT) *sum += log(*product), *product = 1;
}

/* The barrier function without the cost, with its damping of one-sided bounds. Source: [WB] (3) and 3.7. */
real twx_barrier_of_bounds(const twx_work *w, const twx_values *at, real barrier) {
  real logs = 0, damping = 0, product = 1;
  FOR_FREE(w, i) {
    const int low = twx_has(w->lower[i]), high = twx_has(w->upper[i]);
    if (low) add_logarithm(&logs, &product, twx_below(w, at->v, i));
    if (high) add_logarithm(&logs, &product, twx_above(w, at->v, i));
    if (low && !high) damping += twx_below(w, at->v, i);
    if (high && !low) damping += twx_above(w, at->v, i);
  }
  for (size_t i = 0; i < w->rows; i++) add_logarithm(&logs, &product, twx_max(at->s[i], TWX_LEAST_SLACK)), damping += at->s[i];
  return barrier * (w->options->damping * damping - logs - log(product));
}

real twx_barrier(const twx_work *w, const twx_values *at) {
  return at->cost + twx_barrier_of_bounds(w, at, w->barrier);
}

/* What the rows of a stage add to the gradient of the Lagrangian. */
TWX_INLINE void stage_pulls(twx_work *w, int32_t k, const twx_stage *s, real *g) {
  const twx_iterate *q = &w->iterate;
  real *const of_parameters = g + w->variables - (size_t)NP_OF(w), *const of_next = g + w->stages[k < w->N ? k + 1 : k].v;
  const struct { int32_t rows; const real *J, *multipliers; } blocks[] = {
      {s->next, w->F + s->F, q->lambda + s->c}, {s->nh, w->Jh + s->Jh, q->y + s->h}, {s->ne, w->Je + s->Je, q->ye + s->e}};
  for (size_t b = 0; b < 3; b++) {
    const int32_t rows = blocks[b].rows;
    twx_add_apply_transposed(rows, s->nv, blocks[b].J, rows, blocks[b].multipliers, g + s->v);
    twx_add_apply_transposed(rows, NP_OF(w), blocks[b].J + (size_t)rows * (size_t)s->nv, rows, blocks[b].multipliers, of_parameters);
  }
  for (int32_t i = 0; i < s->next; i++) of_next[i] -= q->lambda[s->c + (size_t)i];
}

/* The gradient of the Lagrangian by v, in t3. */
static real *lagrangian_gradient(twx_work *w) {
  const twx_iterate *q = &w->iterate;
  real *const g = w->t3;
  for (size_t i = 0; i < w->variables; i++) g[i] = w->gradient[i] - q->zl[i] + q->zu[i];
  for (int32_t k = 0; k <= w->N; k++) TWX_AT(w, k, stage_pulls, g);
  return g;
}

static real complementarity(const twx_work *w, real barrier) {
  const twx_iterate *q = &w->iterate;
  real most = 0;
  FOR_FREE(w, i) {
    if (twx_has(w->lower[i])) most = twx_max(most, fabs(twx_below(w, q->v, i) * q->zl[i] - barrier));
    if (twx_has(w->upper[i])) most = twx_max(most, fabs(twx_above(w, q->v, i) * q->zu[i] - barrier));
  }
  for (size_t i = 0; i < w->rows; i++) most = twx_max(most, fabs(q->s[i] * q->zs[i] - barrier));
  return most;
}

/* The measures of the same iterate for another barrier parameter. */
twx_measures twx_measure_again(const twx_work *w, const twx_measures *of_iterate, real barrier) {
  twx_measures m = *of_iterate;
  m.complementarity = complementarity(w, barrier);
  m.error = twx_max(twx_max(m.violation, m.complementarity / m.bound_scale), m.stationarity / m.dual_scale); /* last: infinite beside NaN */
  return m;
}

/* The scaled error for a barrier parameter of zero, and its parts. Source: [WB] (5), (6). */
twx_measures twx_measure(twx_work *w) {
  const twx_iterate *q = &w->iterate;
  const real *const g = lagrangian_gradient(w), least = w->options->multiplier_scale;
  twx_measures m = {0};
  real sum = 0; /* the largest of numbers forgets those that are NaN */
  real multipliers = 0, of_bounds = 0, bounds = 0, count = (real)(w->defects + w->rows) + w->ne;
  FOR_FREE(w, i) {
    m.stationarity = twx_max(m.stationarity, fabs(g[i])), sum += g[i];
    if (twx_has(w->lower[i])) of_bounds += q->zl[i], bounds++;
    if (twx_has(w->upper[i])) of_bounds += q->zu[i], bounds++;
  }
  for (size_t i = 0; i < w->rows; i++) {
    m.stationarity = twx_max(m.stationarity, fabs(q->y[i] - q->zs[i]));
    multipliers += fabs(q->y[i]), of_bounds += q->zs[i], bounds++;
  }
  for (size_t i = 0; i < w->defects; i++) multipliers += fabs(q->lambda[i]);
  for (size_t i = 0; i < (size_t)w->ne; i++) multipliers += fabs(q->ye[i]);
  m.dual_scale = twx_max(least, (multipliers + of_bounds) / twx_max(1, count + bounds)) / least;
  m.bound_scale = twx_max(least, of_bounds / twx_max(1, bounds)) / least;
  m.violation = twx_violation(w, &w->here, 1);
  if (!isfinite(sum + multipliers + of_bounds)) m.stationarity = INFINITY, m.dual_scale = m.bound_scale = 1;
  return twx_measure_again(w, &m, 0);
}
