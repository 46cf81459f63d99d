/* Memory of a quadratic program, and its data in units in which rows and columns have entries of about 1.
 * Source: D. Ruiz, A scaling algorithm to equilibrate both rows and columns norms in matrices, RAL-TR-2001-034. Scales
 * are powers of two, so that data are exact.
 */
#include "qp_work.h"

static double *qp_take(double *base, size_t *used, size_t count) {
  double *const start = base ? base + *used : NULL;
  *used += count;
  return start;
}

static int32_t *qp_take_integers(double *base, size_t *used, size_t count) {
  return (int32_t *)(void *)qp_take(base, used, (count + 1) / 2);
}

size_t twx_qp_carve(twx_qp_work *w, const twx_qp *p, double *base) {
  const size_t n = (size_t)p->variables, m = (size_t)p->equalities + (size_t)p->inequalities, k = n + m;
  size_t used = 0;
  w->n = p->variables, w->m = p->equalities + p->inequalities, w->k = w->n + w->m;
  w->D = qp_take(base, &used, k), w->E = base ? w->D + n : NULL;
  w->H = qp_take(base, &used, n * n), w->M = qp_take(base, &used, n * n), w->g = qp_take(base, &used, n);
  w->G = qp_take(base, &used, m * n), w->Gt = qp_take(base, &used, n * m);
  w->lower = qp_take(base, &used, k), w->upper = qp_take(base, &used, k), w->weights = qp_take(base, &used, k);
  w->kind = qp_take_integers(base, &used, k), w->active = qp_take_integers(base, &used, k);
  w->tried = qp_take_integers(base, &used, k);
  twx_qp_point *const points[] = {&w->point, &w->trial, &w->best};
  for (int32_t i = 0; i < 3; i++) {
    twx_qp_point *const q = points[i];
    q->x = qp_take(base, &used, n), q->z = qp_take(base, &used, k), q->t = qp_take(base, &used, k);
    q->Hx = qp_take(base, &used, n), q->Gz = qp_take(base, &used, n), q->residual = qp_take(base, &used, n);
  }
  double **const long_ones[] = {&w->v,  &w->sl, &w->su,  &w->zl,  &w->zu,  &w->dt,
                                &w->dz, &w->dv, &w->dzl, &w->dzu, &w->dz0, &w->r};
  for (size_t i = 0; i < sizeof long_ones / sizeof *long_ones; i++) *long_ones[i] = qp_take(base, &used, k);
  w->dx = qp_take(base, &used, n), w->scratch = qp_take(base, &used, k);
  return used;
}

size_t twx_qp_workspace_size(const twx_qp *p) {
  twx_qp_work w;
  if (p->variables < 1 || p->equalities < 0 || p->inequalities < 0) return 0;
  return twx_qp_carve(&w, p, NULL);
}

/* A power of two near a positive number: its exponent alone. 1 where that is out of range. */
static double qp_power_of_two(double a) {
  uint64_t bits;
  memcpy(&bits, &a, sizeof bits);
  bits &= 0x7ff0000000000000u;
  memcpy(&a, &bits, sizeof a);
  return a > 0 && isfinite(a) ? a : 1;
}

/* 1 where all data are numbers, H is symmetric up to rounding and no lower bound is above its upper one. */
static int32_t qp_data_are_possible(const twx_qp_work *w) {
  const int32_t n = w->n;
  const double *const H = w->problem->H, rounding = w->options->symmetry * w->options->symmetry;
  double sum = 0;
  for (int32_t i = 0; i < n; i++) sum += fabs(w->g[i]);
  for (int32_t i = 0; i < w->m * n; i++) sum += fabs(w->G[i]);
  for (int32_t j = 0; j < n; j++)
    for (int32_t i = 0; i <= j; i++) {
      const double above = H[i + j * n], below = H[j + i * n], off = above - below;
      if (off * off > rounding * fabs(H[i + i * n] * H[j + j * n])) return 0;
      sum += fabs(above) + fabs(below);
    }
  for (int32_t i = 0; i < w->k; i++)
    if (!(w->lower[i] <= w->upper[i]) || w->lower[i] == INFINITY || w->upper[i] == -INFINITY) return 0;
  for (int32_t i = n; i < n + w->problem->equalities; i++) sum += fabs(w->lower[i]);
  return isfinite(sum) ? 1 : 0;
}

static void qp_copy(twx_qp_work *w) {
  const twx_qp *p = w->problem;
  const int32_t n = w->n, m = w->m, ne = p->equalities, ni = p->inequalities;
  for (int32_t j = 0; j < n; j++)
    for (int32_t i = j; i < n; i++) w->H[i + j * n] = w->H[j + i * n] = p->H[i + j * n];
  memcpy(w->g, p->g, sizeof(double) * (size_t)n);
  for (int32_t j = 0; j < n; j++) {
    for (int32_t i = 0; i < ne; i++) w->G[i + j * m] = p->A[i + j * ne];
    for (int32_t i = 0; i < ni; i++) w->G[ne + i + j * m] = p->C[i + j * ni];
    w->lower[j] = p->lower ? p->lower[j] : -INFINITY, w->upper[j] = p->upper ? p->upper[j] : INFINITY;
  }
  for (int32_t i = 0; i < ne; i++) w->lower[n + i] = w->upper[n + i] = p->b[i];
  for (int32_t i = 0; i < ni; i++) w->lower[n + ne + i] = p->row_lower[i], w->upper[n + ne + i] = p->row_upper[i];
}

/* The size of a variable that is in no row and has no curvature: that of a bound, or the reciprocal of its gradient. */
static double qp_size_without_rows(const twx_qp_work *w, int32_t j) {
  const double bound = twx_min(fabs(w->lower[j]), fabs(w->upper[j]));
  return bound > 0 && isfinite(bound) ? bound : w->g[j] != 0 ? 1 / fabs(w->g[j]) : 1;
}

/* Square roots of norms divide scales, until all norms are within a range of 1. Cost's unit does not matter: H counts
 * over its largest diagonal entry. */
static void qp_equilibrate(twx_qp_work *w) {
  const twx_qp_options *o = w->options;
  double *const columns = w->dx, *const rows = w->dt;
  for (int32_t pass = 0; pass < (int32_t)o->scaling_passes; pass++) {
    double largest = 0, farthest = 1;
    for (int32_t j = 0; j < w->n; j++) largest = twx_max(largest, w->H[j + j * w->n] * w->D[j] * w->D[j]);
    memset(rows, 0, sizeof(double) * (size_t)w->m);
    for (int32_t j = 0; j < w->n; j++) {
      const double *restrict column = w->G + (size_t)j * w->m, *restrict E = w->E, d = w->D[j];
      double norm = largest > 0 ? w->H[j + j * w->n] * d * d / largest : 0;
      for (int32_t i = 0; i < w->m; i++) {
        const double size = fabs(column[i]) * E[i] * d;
        norm = twx_max(norm, size), rows[i] = twx_max(rows[i], size);
      }
      columns[j] = norm;
    }
    for (int32_t j = 0; j < w->n; j++)
      if (columns[j] > 0) farthest = twx_max(farthest, twx_max(columns[j], 1 / columns[j]));
    for (int32_t i = 0; i < w->m; i++)
      if (rows[i] > 0) farthest = twx_max(farthest, twx_max(rows[i], 1 / rows[i]));
    if (farthest <= o->scaling_range) break;
    for (int32_t j = 0; j < w->n; j++) if (columns[j] > 0) w->D[j] /= sqrt(columns[j]);
    for (int32_t i = 0; i < w->m; i++) if (rows[i] > 0) w->E[i] /= sqrt(rows[i]);
  }
  for (int32_t j = 0; j < w->n; j++)
    w->D[j] = qp_power_of_two(columns[j] > 0 ? w->D[j] : qp_size_without_rows(w, j));
  for (int32_t i = 0; i < w->m; i++) w->E[i] = qp_power_of_two(w->E[i]);
}

static void qp_apply_scales(twx_qp_work *w) {
  const int32_t n = w->n, m = w->m;
  for (int32_t j = 0; j < n; j++) {
    const double d = w->D[j];
    w->g[j] *= d, w->lower[j] /= d, w->upper[j] /= d;
    for (int32_t i = 0; i < n; i++) w->H[i + j * n] *= w->D[i] * d;
    for (int32_t i = 0; i < m; i++) w->Gt[j + i * n] = w->G[i + j * m] *= w->E[i] * d;
  }
  for (int32_t i = 0; i < m; i++) w->lower[n + i] *= w->E[i], w->upper[n + i] *= w->E[i];
}

/* The cost's unit: H, and gradients over the usual size of bounds (their geometric mean), are at most about 1. */
static void qp_scale_cost(twx_qp_work *w) {
  double H = 0, g = 0, logarithms = 0;
  int32_t count = 0;
  for (int32_t j = 0; j < w->n; j++) H = twx_max(H, w->H[j + j * w->n]), g = twx_max(g, fabs(w->g[j]));
  for (int32_t i = 0; i < w->k; i++) {
    const double size = twx_min(fabs(w->lower[i]), fabs(w->upper[i]));
    if (size > 0 && isfinite(size)) logarithms += log(size), count++;
  }
  const double bound = count ? pow(2.718281828459045, logarithms / count) : 0;
  const double unit = bound > 0 ? twx_max(H, g / bound) : H > 0 ? H : g;
  w->cost_scale = unit > 0 ? 1 / qp_power_of_two(unit) : 1;
  for (int32_t i = 0; i < w->n * w->n; i++) w->H[i] *= w->cost_scale;
  for (int32_t j = 0; j < w->n; j++) w->g[j] *= w->cost_scale;
}

static void qp_load_warm_start(twx_qp_work *w, const twx_qp_solution *s) {
  const int32_t ne = w->problem->equalities;
  for (int32_t j = 0; j < w->n; j++) {
    w->trial.x[j] = s->x[j] / w->D[j], w->trial.z[j] = s->w[j] * w->D[j] * w->cost_scale;
  }
  for (int32_t i = 0; i < w->m; i++)
    w->trial.z[w->n + i] = (i < ne ? s->y[i] : s->z[i - ne]) * w->cost_scale / w->E[i];
}

/* The problem as stated, by the scales that are known. */
void twx_qp_reload(twx_qp_work *w) {
  qp_copy(w), qp_apply_scales(w), qp_scale_cost(w);
  w->soft = 0;
  for (int32_t i = 0; i < w->k; i++) {
    const double l = w->lower[i], u = w->upper[i];
    const int32_t fixed = isfinite(u - l) && u - l <= w->options->fixed_width * twx_max(fabs(l), fabs(u));
    w->kind[i] = fixed ? TWX_QP_FIXED : isfinite(l) || isfinite(u) ? TWX_QP_BOUNDED : TWX_QP_FREE;
    if (fixed) w->lower[i] = w->upper[i] = l + (u - l) / 2;
  }
}

/* The problem, and the point of a warm start in `trial`. 0 where the data cannot be. */
int32_t twx_qp_load(twx_qp_work *w, const twx_qp_solution *s) {
  const int32_t warm = w->options->warm_start > 0;
  qp_copy(w);
  if (!qp_data_are_possible(w)) return 0;
  for (int32_t i = 0; i < w->k; i++) {
    const double scale = warm ? s->scales[i] : 1;
    w->D[i] = scale > 0 && isfinite(scale) ? scale : 1; /* E follows D */
  }
  qp_equilibrate(w);
  twx_qp_reload(w);
  if (warm) qp_load_warm_start(w, s);
  return 1;
}

void twx_qp_unload(const twx_qp_work *w, twx_qp_solution *s) {
  const twx_qp *p = w->problem;
  const int32_t solved = w->statistics->status == TWX_QP_SOLVED;
  double cost = 0;
  for (int32_t j = 0; j < w->n; j++) {
    cost += w->point.x[j] * (w->point.Hx[j] / 2 + w->g[j]) / w->cost_scale;
    const double x = w->point.x[j];
    const double inside = solved ? twx_min(twx_max(x, w->lower[j]), w->upper[j]) : x;
    s->x[j] = inside * w->D[j], s->w[j] = w->point.z[j] / (w->D[j] * w->cost_scale), s->scales[j] = w->D[j];
  }
  for (int32_t i = 0; i < w->m; i++) {
    const double multiplier = w->point.z[w->n + i] * w->E[i] / w->cost_scale;
    *(i < p->equalities ? s->y + i : s->z + (i - p->equalities)) = multiplier, s->scales[w->n + i] = w->E[i];
  }
  twx_qp_statistics *const t = w->statistics;
  t->cost = cost, t->error = w->point.error, t->stationarity = w->point.stationarity;
  t->violation = w->point.violation, t->complementarity = w->point.complementarity;
}
