/* Values, derivatives and moves of a transcribed problem, phase by phase. */
#include "phase.h"

static int32_t is_zero(const real *a, size_t count) {
  for (size_t i = 0; i < count; i++)
    if (a[i] != 0) return 0;
  return 1;
}

/* ---- path rows and cost --------------------------------------------------------------------------------------- */

static const int32_t *places_at(const twx_memory *t, size_t point, size_t k) {
  const twx_phase *f = t->phase;
  return f->place + ((t->first + k) * ((size_t)f->substeps + 1) + point) * (size_t)f->path_rows;
}

/* Whether any row of a point counts; rows stand at ends of substeps alone. */
static int32_t has_rows(const twx_memory *t, size_t point) {
  const twx_phase *f = t->phase;
  if (point > (size_t)f->substeps) return 0;
  for (size_t k = 0; k < t->K; k++)
    for (int32_t r = 0; r < f->path_rows; r++)
      if (places_at(t, point, k)[r] != -1) return 1;
  return 0;
}

/* Whether any row or the cost does. */
static int32_t is_asked(const twx_memory *t, size_t point) { return t->phase->weights[point] != 0 || has_rows(t, point); }

static real rows_values(twx_memory *t, const real *z, real *h, real *e) {
  const twx_phase *f = t->phase;
  const size_t R = (size_t)f->path_rows;
  real cost = 0;
  for (size_t point = 0; point < t->points; point++) {
    if (!is_asked(t, point)) continue;
    twx_call(&f->rows.value, t, twx_inputs_at(t, z, point), t->K, t->rows, R + 1);
    for (size_t k = 0; k < t->K; k++) {
      const real *row = t->rows + k * (R + 1);
      cost += t->widths[k] * f->weights[point] * row[R];
      for (size_t r = 0; point <= (size_t)f->substeps && r < R; r++) {
        real *to = twx_row_at(f, t->first + k, places_at(t, point, k)[r], h, e);
        if (to) *to = row[r] + f->margins[places_at(t, point, k) + r - f->place];
      }
    }
  }
  return cost;
}

/* The slopes of the rows of a block by the unknowns, in `lane_moved`, from this row on. */
static void move_rows(const twx_memory *t, size_t point, size_t block, size_t rows, size_t from) {
  const size_t before = from * SIZE_OF(t), entries = rows * SIZE_OF(t) - before;
  real *const moved = t->lane_moved + before * TWX_LANES, *const packed = twx_is_start(t, point) ? moved : t->lane_rows;
  twx_pack(t, block, rows * SIZE_OF(t), entries, t->row_slopes + before, packed);
  if (!twx_is_start(t, point)) twx_lanes_along(t, rows - from, packed, SIZE_OF(t), twx_maps_at(t, point, block), moved);
}

/* What the slopes of a point add to Jacobians and to the gradient of the cost. */
static void point_jacobians(const twx_memory *t, size_t point, const twx_derivatives *d) {
  const twx_phase *f = t->phase;
  const size_t R = (size_t)f->path_rows, size = SIZE_OF(t), nv = N_OF(t) + (size_t)f->m, from = has_rows(t, point) ? 0 : R;
  for (size_t k = 0; k < t->K; k++) {
    const size_t lane = k % TWX_LANES;
    const real weight = t->widths[k] * f->weights[point], *moved = t->lane_moved + lane;
    if (lane == 0) move_rows(t, point, k / TWX_LANES, R + 1, from);
    for (size_t r = from; r < R; r++)
      twx_add_row(f, t->first + k, places_at(t, point, k)[r], moved + r * size * TWX_LANES, TWX_LANES, size, 0, d->Jh, d->Je);
    for (size_t j = 0; j < size; j++) {
      const real slope = moved[(R * size + j) * TWX_LANES];
      d->gradient[j < nv ? (size_t)f->at.v[t->first + k] + j : (size_t)f->parameters_v + j - nv] += weight * slope;
      if (j >= nv) f->cost_slopes[(t->first + k) * (size - nv) + j - nv] += weight * slope;
    }
  }
}

/* The second derivative `bends` of q at a place, of all intervals, adds to H. */
static void add_bends(const twx_memory *t, size_t place) {
  const size_t size = SIZE_OF(t), entries = size * size;
  for (size_t block = 0; block < t->blocks; block++) {
    twx_pack(t, block, entries, entries, t->bends, t->lane_rows);
    const real *const maps = twx_is_start(t, place) ? NULL : twx_maps_at(t, place, block);
    twx_lanes_bends(t, t->lane_rows, size, maps, t->H + block * entries * TWX_LANES);
  }
}

/* The upper triangles of all intervals to their blocks, and the lower ones from them. */
static void write_hessians(const twx_memory *t, real *H) {
  const size_t size = SIZE_OF(t);
  for (size_t k = 0; k < t->K; k++) {
    real *const block = twx_at_stage(H, t->phase->at.H, t->first + k);
    const real *const lanes = t->H + k / TWX_LANES * size * size * TWX_LANES + k % TWX_LANES;
    for (size_t r = 0; r < size; r++)
      for (size_t j = r; j < size; j++) block[j * size + r] = block[r * size + j] = lanes[(r * size + j) * TWX_LANES];
  }
}

/* What a point is weighted by: rows at ends of substeps by their multipliers, the cost everywhere. Whether by anything. */
static int32_t weigh_rows(const twx_memory *t, size_t point, real weight, const real *y, const real *ye) {
  const twx_phase *f = t->phase;
  const size_t R = (size_t)f->path_rows;
  for (size_t k = 0; k < t->K; k++) {
    real *w = t->weights + k * (R + 1);
    for (size_t r = 0; r < R; r++)
      w[r] = point <= (size_t)f->substeps ? twx_weight_of(f, t->first + k, places_at(t, point, k)[r], y, ye) : 0;
    w[R] = weight * t->widths[k] * f->weights[point];
  }
  return !is_zero(t->weights, t->K * (R + 1)); /* the curvature of other rows is asked for */
}

static twx_inputs weighted_at(const twx_memory *t, const real *z, size_t point) {
  twx_inputs in = twx_inputs_at(t, z, point);
  in.weights = t->weights, in.weight_width = (size_t)t->phase->path_rows + 1;
  return in;
}

/* Derivatives of rows and cost; the second ones with gradients by eta, but for those at stages, which come with rates. */
static void rows_derivatives(twx_memory *t, const real *z, const twx_multipliers *q, const twx_derivatives *d) {
  const size_t rows = (size_t)t->phase->path_rows + 1, size = SIZE_OF(t), n = N_OF(t);
  for (size_t point = 0; point < t->points; point++) {
    real *pulls = t->pulls + point * t->K * n;
    if (d->H) memset(pulls, 0, sizeof(real) * t->K * n);
    if (!is_asked(t, point)) continue;
    const int32_t bent = d->H && weigh_rows(t, point, q->cost, q->y, q->ye);
    if (!d->F && !bent) continue;
    twx_call(&t->phase->rows.slopes, t, twx_inputs_at(t, z, point), t->K, t->row_slopes, rows * size);
    if (d->F) point_jacobians(t, point, d);
    for (size_t k = 0; k < t->K && bent; k++)
      for (size_t r = k * rows; r < (k + 1) * rows; r++)
        for (size_t i = 0; i < n && t->weights[r] != 0; i++) pulls[k * n + i] += t->weights[r] * t->row_slopes[r * size + i];
    if (!bent || !t->phase->rows.bends.run || point > (size_t)t->phase->substeps) continue;
    twx_call(&t->phase->rows.bends, t, weighted_at(t, z, point), t->K, t->bends, size * size);
    add_bends(t, point);
  }
}

/* ---- the defects ---------------------------------------------------------------------------------------------- */

static void gaps(twx_memory *t, const real *z, const twx_kernel *f, const real *weights, real *out, size_t size) {
  twx_inputs in = twx_inputs_at(t, z, (size_t)t->phase->substeps);
  in.weights = weights, in.weight_width = N_OF(t);
  twx_call(f, t, in, t->K, out, size);
}

/* Whether rows of defects are multiplied by their left Jacobians: in charts that stay they are not. */
static int32_t is_turned(const twx_phase *f) { return f->turn.run && !f->steps; }

/* Derivatives of the defects by eta at the ends, their rows multiplied by the left Jacobians of the defects. */
static void gap_slopes(twx_memory *t, const real *z) {
  const twx_phase *f = t->phase;
  const size_t n = N_OF(t);
  gaps(t, z, &f->gap.slopes, NULL, t->gap_slopes, n * n);
  if (!is_turned(f)) return;
  gaps(t, z, &f->gap.value, NULL, t->defects, n);
  twx_call(&f->turn, t, (twx_inputs){.z = t->defects, .width = n}, t->K, t->turns, n * n);
  for (size_t k = 0; k < t->K; k++) {
    twx_multiply(n, n, n, t->turns + k * n * n, t->gap_slopes + k * n * n, t->moved);
    memcpy(t->gap_slopes + k * n * n, t->moved, sizeof(real) * n * n);
  }
}

static void gap_jacobians(const twx_memory *t, real *F) {
  const twx_phase *f = t->phase;
  const size_t n = N_OF(t), size = SIZE_OF(t);
  for (size_t block = 0; block < t->blocks; block++) {
    twx_pack(t, block, n * n, n * n, t->gap_slopes, t->lane_rows);
    twx_lanes_along(t, n, t->lane_rows, n, twx_maps_at(t, (size_t)f->substeps, block), t->lane_moved);
    for (size_t l = 0; l < twx_lanes_of(t, block); l++) {
      real *const to = twx_at_stage(F, f->at.F, t->first + block * TWX_LANES + l);
      for (size_t j = 0; j < size; j++)
        for (size_t i = 0; i < n; i++) to[j * n + i] = t->lane_moved[(i * size + j) * TWX_LANES + l];
    }
  }
}

/* out (K, n) += rows of weights times matrices (n, n). */
static void add_weighted(const twx_memory *t, const real *restrict weights, const real *restrict M, real *restrict out) {
  const size_t n = N_OF(t);
  for (size_t k = 0; k < t->K; k++)
    for (size_t i = 0; i < n; i++)
      for (size_t j = 0; j < n; j++) out[k * n + j] += weights[k * n + i] * M[(k * n + i) * n + j];
}

/* Second derivatives of the defects by eta at the ends. */
static void gap_bends(twx_memory *t, const real *z) {
  const size_t n = N_OF(t);
  gaps(t, z, &t->phase->gap.bends, t->weights, t->bends, n * n);
  for (size_t block = 0; block < t->blocks; block++) {
    twx_pack(t, block, n * n, n * n, t->bends, t->lane_rows);
    twx_lanes_bends(t, t->lane_rows, n, twx_maps_at(t, (size_t)t->phase->substeps, block),
                    t->H + block * SIZE_OF(t) * SIZE_OF(t) * TWX_LANES);
  }
}

/* Derivatives of the defects, and with second ones the adjoints at the ends. */
static void gap_derivatives(twx_memory *t, const real *z, const twx_multipliers *multipliers, const twx_derivatives *d) {
  const twx_phase *f = t->phase;
  const size_t count = t->K * N_OF(t);
  const real *const weights = d->H ? multipliers->lambda + f->at.c[t->first] : NULL;
  const int32_t weighted = d->H && !is_zero(weights, count);
  if (d->H) memset(t->adjoint, 0, sizeof(real) * count);
  if (d->F || weighted) gap_slopes(t, z);
  if (weighted) {
    add_weighted(t, weights, t->gap_slopes, t->adjoint);
    memset(t->weights, 0, sizeof(real) * count);
    if (is_turned(f)) add_weighted(t, weights, t->turns, t->weights);
    else memcpy(t->weights, weights, sizeof(real) * count);
  }
  if (d->F) gap_jacobians(t, d->F); /* in memory of the turns */
  if (weighted && f->gap.bends.run) gap_bends(t, z);
}

/* The second derivatives of a stage's rate by its adjoint and of the cost there, together. */
static void stage_bends(twx_memory *t, const real *z, size_t i, size_t place, real weight) {
  const twx_phase *f = t->phase;
  const size_t size = SIZE_OF(t), count = t->K * size * size;
  const int32_t bent = f->rate.bends.run && !is_zero(t->adjoints + i * t->K * N_OF(t), t->K * N_OF(t));
  const int32_t has_cost = f->rows.bends.run && weight != 0 && f->weights[place] != 0;
  if (bent) {
    twx_inputs in = twx_inputs_at(t, z, place);
    in.weights = t->adjoints + i * t->K * N_OF(t), in.weight_width = N_OF(t);
    twx_call(&f->rate.bends, t, in, t->K, t->bends, size * size);
  }
  if (has_cost) {
    weigh_rows(t, place, weight, NULL, NULL);
    twx_call(&f->rows.bends, t, weighted_at(t, z, place), t->K, bent ? t->cost_bends : t->bends, size * size);
    for (size_t e = 0; bent && e < count; e++) t->bends[e] += t->cost_bends[e];
  }
  if (bent || has_cost) add_bends(t, place);
}

/* Adjoints back through the substeps of all intervals; each stage adds its second derivatives. */
static void rate_hessians(twx_memory *t, const real *z, real weight, real *adjoint) {
  const twx_phase *f = t->phase;
  const size_t S = (size_t)f->substeps, s = STAGES_OF(f), n = N_OF(t);
  for (size_t i = 0; i < t->K * n; i++) adjoint[i] += t->pulls[S * t->K * n + i];
  for (size_t j = S; j-- > 0;) {
    twx_adjoint_stages(t, j, adjoint);
    for (size_t i = 0; i < s; i++) stage_bends(t, z, i, S + 1 + j * s + i, weight);
    for (size_t i = 0; i < t->K * n; i++) adjoint[i] += t->pulls[j * t->K * n + i];
  }
}

/* ---- functions of the problem --------------------------------------------------------------------------------- */

#define FOR_PHASES(user, f, t) \
  for (int32_t number = 0; number < ((twx_transcription *)(user))->phases; number++) \
    for (twx_phase *f = ((twx_transcription *)(user))->phase + number; f; f = NULL) \
      for (twx_memory t = memory_of(f); t.phase; t.phase = NULL)

static twx_memory memory_of(const twx_phase *f) {
  twx_memory t;
  twx_lay_out(&t, f, f->work, f->scratch);
  return t;
}

int32_t twx_transcribed_values(void *user, const real *z, real *cost, real *c, real *h, real *e) {
  *cost = 0;
  FOR_PHASES(user, f, t) {
    FOR_WINDOWS(t) {
      if (twx_integrate(&t, z)) return 1;
      *cost += rows_values(&t, z, h, e);
      gaps(&t, z, &f->gap.value, NULL, c + f->at.c[t.first], t.n);
    }
    *cost += twx_node_values(&t, z, h, e);
    for (size_t i = 0; f->steps && i < (size_t)f->intervals * t.n; i++) c[(size_t)f->at.c[0] + i] -= f->steps[t.n + i];
    if (f->join) twx_join_values(&t, z, c);
  }
  return 0;
}

/* Derivatives of a window, of the first order where F is no NULL, and of the second where H is none. */
static int32_t window_derivatives(twx_memory *t, const real *z, const twx_multipliers *weights, const twx_derivatives *d) {
  if (twx_sensitivities(t, z)) return 1;
  if (d->H) memset(t->H, 0, sizeof(real) * t->blocks * SIZE_OF(t) * SIZE_OF(t) * TWX_LANES);
  rows_derivatives(t, z, weights, d);
  gap_derivatives(t, z, weights, d);
  if (!d->H) return 0;
  rate_hessians(t, z, weights->cost, t->adjoint);
  write_hessians(t, d->H);
  return 0;
}

int32_t twx_transcribed_derivatives(void *user, const real *z, const twx_multipliers *weights, const twx_derivatives *d) {
  FOR_PHASES(user, f, t) {
    if (d->F) memset(f->cost_slopes, 0, sizeof(real) * (size_t)(f->intervals + 1) * (size_t)f->p);
    FOR_WINDOWS(t) if (window_derivatives(&t, z, weights, d)) return 1;
    if (d->F) twx_node_jacobians(&t, z, d->gradient, d->Jh, d->Je);
    if (d->F && f->join) twx_join_jacobians(&t, z, d->F);
    if (d->H) twx_node_hessians(&t, z, weights->cost, weights->y, weights->ye, d->H);
    if (d->H && f->join) twx_join_hessians(&t, z, weights->lambda, d->H);
  }
  return 0;
}

int32_t twx_transcribed_jacobians(void *user, const real *z, real *gradient, real *F, real *Jh, real *Je) {
  const twx_derivatives d = {gradient, F, Jh, Je, NULL};
  return twx_transcribed_derivatives(user, z, NULL, &d);
}

int32_t twx_transcribed_hessians(void *user, const real *z, real weight, const real *lambda, const real *y,
                                 const real *ye, real *H) {
  const twx_multipliers weights = {weight, lambda, y, ye};
  const twx_derivatives d = {NULL, NULL, NULL, NULL, H};
  return twx_transcribed_derivatives(user, z, &weights, &d);
}

int32_t twx_transcribed_retract(void *user, const real *z, const real *d, real *moved) {
  FOR_PHASES(user, f, t) {
    const size_t nodes = (size_t)f->intervals + 1, stride = (size_t)(f->point + f->m), m = (size_t)f->m;
    for (size_t k = 0; k < nodes; k++) {
      const real *step = d + f->at.v[k], *from = z + f->at.z[k];
      real *to = moved + f->at.z[k];
      for (size_t i = 0; !f->retract.run && i < t.n; i++) to[i] = from[i] + step[i];
      for (size_t i = 0; k + 1 < nodes && i < m; i++) to[(size_t)f->point + i] = from[(size_t)f->point + i] + step[t.n + i];
    }
    if (f->retract.run) {
      const twx_inputs in = {.z = d + f->at.v[0], .width = t.n + m, .base = z + f->at.z[0]};
      twx_call(&f->retract, &t, in, nodes, moved + f->at.z[0], stride);
    }
    /* What a join leaves free is where the next node is: the step to it from there is taken. */
    for (int32_t i = 0; f->join && i < f->join->free_count; i++) {
      const size_t at = (size_t)f->at.z[f->intervals] + (size_t)f->point + (size_t)i, v = (size_t)f->at.v[f->intervals] + t.n;
      moved[at] = z[at] + d[v + (size_t)i] - d[v + (size_t)f->join->free_count + (size_t)f->join->free[i]];
    }
    for (int64_t i = 0; i < f->p; i++)
      moved[f->parameters_z + i] = z[f->parameters_z + i] + d[f->parameters_v + i];
  }
  return 0;
}
