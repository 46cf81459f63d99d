/* Calls of kernels, memory of a phase, and the small linear algebra of row-major matrices. */
#include "phase.h"

static real *next_of(real *base, size_t *used, size_t count) {
  real *const start = base ? base + *used : NULL;
  *used += count;
  return start;
}

size_t twx_window_of(const twx_phase *f) {
  return f->window > 0 && f->window < f->intervals ? (size_t)f->window : (size_t)f->intervals;
}

/* Whether what is integrated stays: all intervals are in memory. */
int32_t twx_is_kept(const twx_phase *f) { return twx_window_of(f) == (size_t)f->intervals; }

/* Rows of the largest function of a phase. */
static size_t most_rows(const twx_phase *f) {
  size_t rows = (size_t)f->path_rows + 1;
  for (int32_t i = 0; i < f->nodes; i++) rows = twx_most(rows, (size_t)f->node[i].function.rows);
  return f->join ? twx_most(rows, (size_t)f->join->function.rows) : rows;
}

twx_phase_sizes twx_lay_out(twx_memory *t, const twx_phase *f, real *work, real *scratch) {
  const size_t n = (size_t)f->n, size = n + (size_t)f->m + (size_t)f->p, rows = most_rows(f), K = twx_window_of(f);
  const size_t S = (size_t)f->substeps, s = (size_t)f->stages, all = S * s, sn = f->implicit ? s * n : 0;
  const size_t lanes = (K + TWX_LANES - 1) / TWX_LANES * TWX_LANES, joined = f->join ? (size_t)f->join->function.rows : 0;
  const size_t block = twx_most(rows, size) * size * TWX_LANES, stages = all * K * n * size;
  twx_phase_sizes used = {0, 0};
  *t = (twx_memory){.phase = f, .n = n, .size = size, .stages = all};
  t->points = S + 1 + all;
  t->state = next_of(work, &used.work, 1);
  t->at = next_of(work, &used.work, !twx_is_kept(f) ? 0 : (K + 1) * (size_t)f->point + K * (size_t)f->m + (size_t)f->p);
  t->q = next_of(work, &used.work, (S + 1 + all) * K * size), t->shares = next_of(work, &used.work, (S + 1 + all) * K);
  t->shared = next_of(work, &used.work, all * K * (size_t)f->rate.shared_width);
  t->slopes = next_of(work, &used.work, all * K * n), t->rows = next_of(work, &used.work, K * rows);
  t->defects = next_of(work, &used.work, K * n), t->q_node = next_of(work, &used.work, n + (size_t)f->p);
  t->matrix = next_of(work, &used.work, K * sn * sn), t->right = next_of(work, &used.work, f->implicit ? (sn + s) * size + sn : 0);
  /* Implicit stages are differentiated where they are solved. */
  t->J = f->implicit ? next_of(work, &used.work, stages) : next_of(scratch, &used.scratch, stages);
  t->adjoints = f->implicit ? next_of(work, &used.work, s * K * n) : next_of(scratch, &used.scratch, s * K * n);
  t->maps = next_of(scratch, &used.scratch, (S + all - !f->implicit) * lanes * n * size);
  t->along = next_of(scratch, &used.scratch, f->implicit ? s * lanes * n * size : 0);
  t->H = next_of(scratch, &used.scratch, lanes * size * size), t->map = next_of(scratch, &used.scratch, n * size);
  t->turns = t->lane_rows = next_of(scratch, &used.scratch, twx_most(block, K * n * n));
  t->lane_moved = next_of(scratch, &used.scratch, block), t->list = (int32_t *)(void *)next_of(scratch, &used.scratch, 2 * size);
  t->through = next_of(scratch, &used.scratch, s * K * n), t->pulls = next_of(scratch, &used.scratch, t->points * K * n);
  t->gap_slopes = t->row_slopes = next_of(scratch, &used.scratch, K * twx_most(rows * size, n * n));
  t->adjoint = next_of(scratch, &used.scratch, K * n), t->bends = next_of(scratch, &used.scratch, K * size * size);
  t->cost_bends = next_of(scratch, &used.scratch, K * size * size);
  t->moved = next_of(scratch, &used.scratch, size * size + joined * (joined + size));
  t->weights = next_of(scratch, &used.scratch, K * twx_most(rows, n));
  twx_open_window(t, 0);
  return used;
}

void twx_open_window(twx_memory *t, size_t first) {
  const size_t left = (size_t)t->phase->intervals - first, window = twx_window_of(t->phase);
  t->first = first, t->K = left < window ? left : window, t->blocks = (t->K + TWX_LANES - 1) / TWX_LANES;
  t->starts = t->phase->starts + first, t->widths = t->phase->widths + first;
}

size_t twx_phase_work(const twx_phase *f) {
  twx_memory t;
  return twx_lay_out(&t, f, NULL, NULL).work;
}

size_t twx_phase_scratch(const twx_phase *f) {
  twx_memory t;
  return twx_lay_out(&t, f, NULL, NULL).scratch;
}

void twx_call(const twx_kernel *f, const twx_memory *t, twx_inputs in, size_t rows, real *result, size_t size) {
  const int64_t stride = t->phase->point + t->phase->m; /* from a node to the next */
  const real *const target = in.target ? in.target : in.base ? in.base + stride : NULL;
  const real *at[TWX_ARGUMENTS] = {in.z, in.share, in.base, target, t->phase->data, f->numbers, in.weights,
                                   t->phase->node_rows + in.stage * (size_t)t->phase->node_width, t->phase->of_phase,
                                   in.shared};
  const int64_t strides[TWX_ARGUMENTS] = {(int64_t)in.width, 1, stride, stride, 0, 0, (int64_t)in.weight_width, t->phase->node_width, 0,
                                          t->phase->rate.shared_width};
  int64_t table[2 * (TWX_ARGUMENTS + 1)];
  if (!f->run) {
    memset(result, 0, sizeof(real) * rows * size);
    return;
  }
  for (int32_t i = 0; i < f->reads; i++) {
    table[i] = (int64_t)(intptr_t)at[f->argument[i]];
    table[f->reads + 1 + i] = strides[f->argument[i]];
  }
  table[f->reads] = (int64_t)(intptr_t)result, table[2 * f->reads + 1] = (int64_t)size;
  f->run(table, 0, (int64_t)rows);
}

void twx_along(size_t rows, size_t n, size_t size, const real *M, const real *maps, real *out) {
  for (size_t r = 0; r < rows; r++) {
    const real *restrict row = M + r * size;
    real *restrict to = out + r * size;
    for (size_t j = 0; j < size; j++) to[j] = j < n ? 0 : row[j];
    for (size_t i = 0; i < n; i++) {
      const real *restrict map = maps + i * size, factor = row[i];
      if (factor != 0)
        for (size_t j = 0; j < size; j++) to[j] += factor * map[j];
    }
  }
}

/* L U of a row-major matrix with rows exchanged; 0 where a pivot is zero or not a number. */
int32_t twx_lu(size_t n, real *A, real *pivots) {
  for (size_t j = 0; j < n; j++) {
    size_t best = j;
    for (size_t i = j + 1; i < n; i++)
      if (fabs(A[i * n + j]) > fabs(A[best * n + j])) best = i;
    pivots[j] = (real)best;
    if (!(fabs(A[best * n + j]) > 0)) return 0;
    for (size_t l = 0; l < n && best != j; l++) {
      const real kept = A[j * n + l];
      A[j * n + l] = A[best * n + l], A[best * n + l] = kept;
    }
    for (size_t i = j + 1; i < n; i++) {
      const real factor = A[i * n + j] /= A[j * n + j];
      if (factor != 0)
        for (size_t l = j + 1; l < n; l++) A[i * n + l] -= factor * A[j * n + l];
    }
  }
  return 1;
}

void twx_lu_solve(size_t n, const real *A, const real *pivots, size_t columns, real *B) {
  for (size_t j = 0; j < n; j++) {
    const size_t from = (size_t)pivots[j];
    for (size_t l = 0; l < columns && from != j; l++) {
      const real kept = B[j * columns + l];
      B[j * columns + l] = B[from * columns + l], B[from * columns + l] = kept;
    }
  }
  for (size_t j = 0; j < n; j++)
    for (size_t i = j + 1; i < n; i++)
      for (size_t l = 0; l < columns; l++) B[i * columns + l] -= A[i * n + j] * B[j * columns + l];
  for (size_t j = n; j-- > 0;) {
    for (size_t l = 0; l < columns; l++) B[j * columns + l] /= A[j * n + j];
    for (size_t i = 0; i < j; i++)
      for (size_t l = 0; l < columns; l++) B[i * columns + l] -= A[i * n + j] * B[j * columns + l];
  }
}

void twx_lu_solve_transposed(size_t n, const real *A, const real *pivots, real *b) {
  for (size_t j = 0; j < n; j++) {
    b[j] /= A[j * n + j];
    for (size_t i = j + 1; i < n; i++) b[i] -= A[j * n + i] * b[j];
  }
  for (size_t j = n; j-- > 0;)
    for (size_t i = 0; i < j; i++) b[i] -= A[j * n + i] * b[j];
  for (size_t j = n; j-- > 0;) {
    const size_t from = (size_t)pivots[j];
    const real kept = b[j];
    b[j] = b[from], b[from] = kept;
  }
}

/* out (rows, columns) = A (rows, n) B (n, columns) */
void twx_multiply(size_t rows, size_t n, size_t columns, const real *restrict A, const real *restrict B, real *restrict out) {
  memset(out, 0, sizeof(real) * rows * columns);
  for (size_t i = 0; i < rows; i++)
    for (size_t l = 0; l < n; l++) {
      const real factor = A[i * n + l];
      if (factor != 0)
        for (size_t j = 0; j < columns; j++) out[i * columns + j] += factor * B[l * columns + j];
    }
}

/* ---- rows --------------------------------------------------------------------------------------------------- */

real *twx_at_stage(real *array, const int64_t *offsets, size_t k) { return array + offsets[k]; }

/* A row of a stage among inequalities and equalities; NULL: nowhere. */
real *twx_row_at(const twx_phase *f, size_t k, int32_t place, real *h, real *e) {
  if (place >= 0) return twx_at_stage(h, f->at.h, k) + place;
  return place == -1 ? NULL : twx_at_stage(e, f->at.e, k) - 2 - place;
}

real twx_weight_of(const twx_phase *f, size_t k, int32_t place, const real *y, const real *ye) {
  if (place >= 0) return y[f->at.h[k] + place];
  return place == -1 ? 0 : ye[f->at.e[k] - 2 - place];
}

/* Adds a row of derivatives of a stage to its block, columns of eta, then those from `after` on. */
void twx_add_row(const twx_phase *f, size_t k, int32_t place, const real *row, size_t stride, size_t count,
                 size_t skipped, real *Jh, real *Je) {
  const size_t n = (size_t)f->n;
  const int32_t rows = place >= 0 ? f->at.inequalities[k] : f->at.equalities[k];
  real *block = place >= 0 ? Jh + f->at.Jh[k] + place : Je + f->at.Je[k] - 2 - place;
  if (place != -1)
    for (size_t j = 0; j < count; j++) block[(j < n ? j : j + skipped) * (size_t)rows] = row[j * stride];
}
