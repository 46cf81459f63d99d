/* Functions of the problem, in the core's units: v over `size`, rows by their scales, the cost by `cost_scale`. */
#include "work.h"

static const real *parameter_size(const twx_work *w) { return w->size + w->variables - (size_t)w->np; }

TWX_INLINE real size_of(const twx_work *w, const twx_stage *stage, int32_t column) {
  return column < stage->nv ? w->size[stage->v + (size_t)column] : parameter_size(w)[column - stage->nv];
}

static const real *size_of_next(const twx_work *w, int32_t k) { return w->size + w->stages[k + 1].v; }

int32_t twx_evaluate(twx_work *w, twx_values *at) {
  const twx_problem *p = w->problem;
  real sum = 0, *const h = at->h, *const e = at->e;
  memset(at->c, 0, sizeof(real) * w->defects), memset(h, 0, sizeof(real) * w->rows);
  memset(e, 0, sizeof(real) * (size_t)w->ne);
  at->cost = 0;
  w->statistics->evaluations++;
  if (p->values(p->user, at->z, &at->cost, at->c, h, e)) return 1;
  at->cost *= w->cost_scale;
  for (int32_t k = 0; k < w->N; k++) {
    const real *size = size_of_next(w, k);
    for (int32_t i = 0; i < w->stages[k].next; i++) sum += at->c[w->stages[k].c + (size_t)i] /= size[i];
  }
  for (size_t i = 0; i < w->rows; i++) sum += h[i] = h[i] * w->row_scale[i] - w->options->row_relaxation;
  for (size_t i = 0; i < (size_t)w->ne; i++) sum += e[i] *= w->equality_scale[i];
  return !isfinite(sum + at->cost);
}

/* Rows of a block (rows, n) of a stage by `scale`, columns by the units of the variables; a sum that tells NaN, of columns
 * apart so that one does not wait for another. */
TWX_INLINE real scale_block(const twx_work *w, const twx_stage *stage, int32_t rows, real *block, const real *restrict scale) {
  real sum = 0;
  for (int32_t j = 0; j < stage->n; j++) {
    const real size = size_of(w, stage, j);
    real *restrict column = block + (size_t)j * (size_t)rows, of_column = 0;
    for (int32_t i = 0; i < rows; i++) column[i] *= size * scale[i];
    for (int32_t i = 0; i < rows; i++) of_column += column[i];
    sum += of_column;
  }
  return sum;
}

/* The functions at the iterate are those of the trial. */
void twx_take_values(twx_work *w) {
  twx_values *const to = &w->here;
  const twx_values *const from = &w->trial;
  memcpy(to->z, from->z, sizeof(real) * w->points), memcpy(to->c, from->c, sizeof(real) * w->defects);
  memcpy(to->h, from->h, sizeof(real) * w->rows), memcpy(to->e, from->e, sizeof(real) * (size_t)w->ne);
  to->cost = from->cost;
}

static void clear_jacobians(twx_work *w) {
  const twx_stage *end = w->stages + w->N;
  memset(w->gradient, 0, sizeof(real) * w->variables);
  memset(w->F, 0, sizeof(real) * end->F), memset(w->Jh, 0, sizeof(real) * (end->Jh + (size_t)end->nh * (size_t)end->n));
  memset(w->Je, 0, sizeof(real) * (end->Je + (size_t)end->ne * (size_t)end->n));
}

TWX_INLINE real scale_stage(twx_work *w, int32_t k, const twx_stage *s, real *inverse) {
  for (int32_t i = 0; i < s->next; i++) inverse[i] = 1 / size_of_next(w, k)[i];
  return scale_block(w, s, s->next, w->F + s->F, inverse) + scale_block(w, s, s->nh, w->Jh + s->Jh, w->row_scale + s->h) +
         scale_block(w, s, s->ne, w->Je + s->Je, w->equality_scale + s->e);
}

static int32_t scale_jacobians(twx_work *w) {
  real sum = 0;
  for (size_t i = 0; i < w->variables; i++) sum += w->gradient[i] *= w->cost_scale * w->size[i];
  for (int32_t k = 0; k <= w->N; k++) sum += TWX_AT(w, k, scale_stage, w->t0);
  return !isfinite(sum);
}

int32_t twx_differentiate(twx_work *w) {
  const twx_problem *p = w->problem;
  clear_jacobians(w);
  w->has_hessian = 0;
  return p->jacobians(p->user, w->here.z, w->gradient, w->F, w->Jh, w->Je) || scale_jacobians(w);
}

/* The multipliers in the problem's units, in `t3`, in the order of lambda, y, ye. */
static real *unscaled_multipliers(twx_work *w) {
  real *lambda = w->t3, *y = lambda + w->defects, *ye = y + w->rows;
  for (int32_t k = 0; k < w->N; k++)
    for (int32_t i = 0; i < w->stages[k].next; i++) {
      const size_t at = w->stages[k].c + (size_t)i;
      lambda[at] = w->iterate.lambda[at] / size_of_next(w, k)[i];
    }
  for (size_t i = 0; i < w->rows; i++) y[i] = w->iterate.y[i] * w->row_scale[i];
  for (size_t i = 0; i < (size_t)w->ne; i++) ye[i] = w->iterate.ye[i] * w->equality_scale[i];
  return lambda;
}

static twx_multipliers weights_of(twx_work *w) {
  const real *const lambda = unscaled_multipliers(w), *const y = lambda + w->defects;
  return (twx_multipliers){w->cost_scale, lambda, y, y + w->rows};
}

static void clear_hessians(twx_work *w) {
  const twx_stage *end = w->stages + w->N;
  memset(w->H, 0, sizeof(real) * (end->H + (size_t)end->n * (size_t)end->n));
}

TWX_INLINE real scale_stage_hessian(twx_work *w, int32_t k, const twx_stage *s, real *size) {
  (void)k;
  for (int32_t i = 0; i < s->n; i++) size[i] = size_of(w, s, i);
  return scale_block(w, s, s->n, w->H + s->H, size);
}

static int32_t scale_hessians(twx_work *w) {
  real sum = 0;
  for (int32_t k = 0; k <= w->N; k++) sum += TWX_AT(w, k, scale_stage_hessian, w->t0);
  return !isfinite(sum);
}

int32_t twx_differentiate_twice(twx_work *w) {
  const twx_problem *p = w->problem;
  if (w->has_hessian) return 0;
  const twx_multipliers q = weights_of(w);
  clear_hessians(w);
  if (p->hessians(p->user, w->here.z, q.cost, q.lambda, q.y, q.ye, w->H) || scale_hessians(w)) return 1;
  w->has_hessian = 1;
  return 0;
}

/* Both at once where the problem can and another step follows. */
int32_t twx_differentiate_both(twx_work *w) {
  const twx_problem *p = w->problem;
  const twx_derivatives to = {w->gradient, w->F, w->Jh, w->Je, w->H};
  if (!p->derivatives || w->statistics->iterations >= (int32_t)w->options->iterations) return twx_differentiate(w);
  const twx_multipliers q = weights_of(w);
  clear_jacobians(w), clear_hessians(w);
  if (p->derivatives(p->user, w->here.z, &q, &to) || scale_jacobians(w) || scale_hessians(w)) return 1;
  w->has_hessian = 1;
  return 0;
}

/* Entries of z that are those of v and have a bound at zero: sums of steps drift apart by rounding, and what is divided by
 * would change its sign in z. */
static void keep_signs(twx_work *w) {
  const twx_problem *p = w->problem;
  if (p->retract && !p->flat) return;
  FOR_FREE(w, i) {
    if (w->lower[i] != 0 && w->upper[i] != 0) continue;
    if (!p->retract) w->trial.z[i] = w->size[i] * w->trial.v[i];
    else if (p->flat[i] >= 0) w->trial.z[p->flat[i]] = w->size[i] * w->trial.v[i];
  }
}

/* The trial: the iterate moved by a step, its values, and its functions. Other than 0 where these are not finite. */
int32_t twx_move(twx_work *w, const twx_iterate *step, real length) {
  const twx_problem *p = w->problem;
  for (size_t i = 0; i < w->variables; i++) {
    w->trial.v[i] = w->iterate.v[i] + length * step->v[i];
    w->moved[i] = w->size[i] * length * step->v[i];
  }
  for (size_t i = 0; i < w->rows; i++) w->trial.s[i] = w->iterate.s[i] + length * step->s[i];
  if (!p->retract)
    for (size_t i = 0; i < w->variables; i++) w->trial.z[i] = w->here.z[i] + w->moved[i];
  else if (p->retract(p->user, w->here.z, w->moved, w->trial.z))
    return 1;
  keep_signs(w);
  if (twx_evaluate(w, &w->trial)) return 1;
  if (w->options->slack_reset > 0) /* a smaller slack costs barrier and gains nothing */
    for (size_t i = 0; i < w->rows; i++) w->trial.s[i] = twx_max(w->trial.s[i], -w->trial.h[i]);
  return 0;
}
