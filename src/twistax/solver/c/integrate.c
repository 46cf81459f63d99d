/* Intervals of a phase: their integration, its sensitivities and its adjoints. Row k of an array is interval k. */
#include "phase.h"

/* u and p in q = (eta, u, p) of all intervals, and the shares where they stand. */
static void join(const twx_memory *t, size_t place, const real *z, real within) {
  const twx_phase *f = t->phase;
  const size_t stride = (size_t)(f->point + f->m);
  const real *p = z + f->parameters_z;
  for (size_t k = 0; k < t->K; k++) {
    real *q = t->q + (place * t->K + k) * SIZE_OF(t);
    memcpy(q + N_OF(t), z + f->at.z[t->first] + k * stride + (size_t)f->point, sizeof(real) * M_OF(f));
    memcpy(q + N_OF(t) + M_OF(f), p, sizeof(real) * P_OF(f));
    t->shares[place * t->K + k] = t->starts[k] + t->widths[k] * within;
  }
}

static size_t stage_place(const twx_memory *t, size_t stage) { return (size_t)t->phase->substeps + 1 + stage; }

static real *q_of(const twx_memory *t, size_t place) { return t->q + place * t->K * SIZE_OF(t); }

static real *shared_of(const twx_memory *t, size_t stage) {
  return t->shared + stage * t->K * (size_t)t->phase->rate.shared_width;
}

twx_inputs twx_inputs_at(const twx_memory *t, const real *z, size_t place) {
  const size_t before = stage_place(t, 0);
  return (twx_inputs){.z = q_of(t, place), .width = SIZE_OF(t), .share = t->shares + place * t->K,
                      .base = z + t->phase->at.z[t->first], .stage = t->first,
                      .shared = place < before ? NULL : shared_of(t, place - before)};
}

/* Elementary functions in the rate of a stage, which its value and derivatives read. */
static void share(const twx_memory *t, const real *z, size_t stage) {
  const twx_smooth *rate = &t->phase->rate;
  if (rate->shared_width > 0)
    twx_call(&rate->shared, t, twx_inputs_at(t, z, stage_place(t, stage)), t->K, shared_of(t, stage), (size_t)rate->shared_width);
}

static void rates(const twx_memory *t, const real *z, size_t stage, real *slopes) {
  share(t, z, stage);
  twx_call(&t->phase->rate.value, t, twx_inputs_at(t, z, stage_place(t, stage)), t->K, slopes, N_OF(t));
}

static void rate_slopes(const twx_memory *t, const real *z, size_t stage) {
  real *J = t->J + stage * t->K * N_OF(t) * SIZE_OF(t);
  twx_call(&t->phase->rate.slopes, t, twx_inputs_at(t, z, stage_place(t, stage)), t->K, J, N_OF(t) * SIZE_OF(t));
}

/* eta at a place: that of the substep's start plus steps along the slopes of its stages, by these weights. */
static void advance(const twx_memory *t, size_t substep, const real *weights, size_t count, size_t place) {
  const size_t s = STAGES_OF(t->phase);
  for (size_t k = 0; k < t->K; k++) {
    const real length = t->widths[k] / t->phase->substeps;
    const real *restrict from = q_of(t, substep) + k * SIZE_OF(t);
    real *restrict to = q_of(t, place) + k * SIZE_OF(t);
    for (size_t i = 0; i < N_OF(t); i++) to[i] = from[i];
    for (size_t l = 0; l < count; l++) {
      const real *restrict slope = t->slopes + ((substep * s + l) * t->K + k) * N_OF(t), factor = length * weights[l];
      if (factor == 0) continue;
      for (size_t i = 0; i < N_OF(t); i++) to[i] += factor * slope[i];
    }
  }
}

/* The matrix of v_i - J_i sum_j a_ij v_j of a substep, factorised. */
static int32_t factorize_stages(const twx_memory *t, size_t substep, size_t k) {
  const twx_phase *f = t->phase;
  const size_t s = STAGES_OF(f), n = N_OF(t), sn = s * n;
  const real length = t->widths[k] / f->substeps;
  real *M = t->matrix + k * sn * sn;
  for (size_t i = 0; i < s; i++)
    for (size_t r = 0; r < n; r++)
      for (size_t j = 0; j < s; j++)
        for (size_t q = 0; q < n; q++)
          M[(i * n + r) * sn + j * n + q] = (i == j && r == q) - length * f->a[i * s + j] *
                                            t->J[(((substep * s + i) * t->K + k) * n + r) * SIZE_OF(t) + q];
  return twx_lu(sn, M, t->right + (sn + s) * SIZE_OF(t));
}

/* One step of Newton's method for the slopes of a substep of all intervals: its largest relative size, -1: none. */
static real improve(const twx_memory *t, const real *z, size_t substep) {
  const twx_phase *f = t->phase;
  const size_t s = STAGES_OF(f), n = N_OF(t), sn = s * n;
  real worst = 0, *r = t->right, *value = t->adjoints;
  for (size_t i = 0; i < s; i++) {
    const size_t stage = substep * s + i;
    advance(t, substep, f->a + i * s, s, stage_place(t, stage));
    rates(t, z, stage, value + i * t->K * n), rate_slopes(t, z, stage);
  }
  for (size_t k = 0; k < t->K; k++) {
    real step = 0, scale = 0;
    const real length = t->widths[k] / f->substeps;
    for (size_t i = 0; i < s; i++)
      for (size_t d = 0; d < n; d++)
        r[i * n + d] = t->slopes[((substep * s + i) * t->K + k) * n + d] - value[(i * t->K + k) * n + d];
    if (!factorize_stages(t, substep, k)) return -1;
    twx_lu_solve(sn, t->matrix + k * sn * sn, r + (sn + s) * SIZE_OF(t), 1, r);
    for (size_t i = 0; i < s; i++)
      for (size_t d = 0; d < n; d++) {
        real *slope = t->slopes + ((substep * s + i) * t->K + k) * n + d;
        scale = twx_max(fabs(*slope), scale), step = twx_max(fabs(r[i * n + d]), step);
        *slope -= r[i * n + d];
        if (!isfinite(*slope)) return -1;
      }
    worst = twx_max(length * step / (1 + length * scale), worst);
  }
  return worst;
}

/* Slopes at the start of a substep; where there is none, as of p / v at v = 0, that of the way to the next node. */
static void first_slopes(const twx_memory *t, const real *z, size_t substep, real *slopes) {
  const twx_phase *f = t->phase;
  int32_t singular = 0;
  rates(t, z, substep * STAGES_OF(f), slopes);
  for (size_t i = 0; i < t->K * N_OF(t); i++) singular |= !isfinite(slopes[i]);
  if (!singular) return;
  twx_call(&f->gap.value, t, twx_inputs_at(t, z, 0), t->K, t->defects, N_OF(t));
  for (size_t k = 0; k < t->K; k++) {
    singular = 0;
    for (size_t i = 0; i < N_OF(t); i++) singular |= !isfinite(slopes[k * N_OF(t) + i]);
    for (size_t i = 0; i < N_OF(t) && singular; i++) slopes[k * N_OF(t) + i] = -t->defects[k * N_OF(t) + i] / t->widths[k];
  }
}

static int32_t solve_stages(const twx_memory *t, const real *z, size_t substep) {
  const twx_phase *f = t->phase;
  const size_t s = STAGES_OF(f), block = t->K * N_OF(t);
  real *first = t->slopes + substep * s * block;
  advance(t, substep, NULL, 0, stage_place(t, substep * s));
  first_slopes(t, z, substep, first);
  for (size_t i = 1; i < s; i++) memcpy(first + i * block, first, sizeof(real) * block);
  for (int32_t i = 0; i < f->iterations; i++) {
    const real size = improve(t, z, substep);
    if (size < 0) return 1;
    if (size <= f->close) {
      if (improve(t, z, substep) < 0) return 1;
      for (size_t l = 0; l < s; l++) advance(t, substep, f->a + l * s, s, stage_place(t, substep * s + l));
      return 0;
    }
  }
  return 1;
}

static int32_t differ(const real *a, const real *b, size_t count) {
  for (size_t i = 0; i < count; i++)
    if (a[i] != b[i]) return 1;
  return 0;
}

static int32_t integrate_window(twx_memory *t, const real *z) {
  const twx_phase *f = t->phase;
  const size_t S = (size_t)f->substeps, s = STAGES_OF(f);
  memset(q_of(t, 0), 0, sizeof(real) * t->K * SIZE_OF(t));
  for (size_t k = 0; f->steps && k < t->K; k++)
    memcpy(q_of(t, 0) + k * SIZE_OF(t), f->steps + (t->first + k) * N_OF(t), sizeof(real) * N_OF(t));
  join(t, 0, z, 0);
  for (size_t j = 0; j < S; j++) {
    for (size_t i = 0; i < s; i++) join(t, stage_place(t, j * s + i), z, ((real)j + f->c[i]) / (real)S);
    if (f->implicit && solve_stages(t, z, j)) return 1;
    for (size_t i = 0; !f->implicit && i < s; i++) {
      advance(t, j, f->a + i * s, i, stage_place(t, j * s + i));
      rates(t, z, j * s + i, t->slopes + (j * s + i) * t->K * N_OF(t));
    }
    join(t, j + 1, z, (real)(j + 1) / (real)S);
    advance(t, j, f->b, s, j + 1);
  }
  return 0;
}

/* The memory for a point, integrated, unless it is kept. Other than 0 where implicit stages are not solved. */
int32_t twx_integrate(twx_memory *t, const real *z) {
  const twx_phase *f = t->phase;
  const size_t inner = t->K * (size_t)(f->point + f->m) + (size_t)f->point;
  const real *own = z + f->at.z[0], *p = z + f->parameters_z;
  if (!twx_is_kept(f)) return integrate_window(t, z);
  if (*t->state > 0 && !differ(t->at, own, inner) && !differ(t->at + inner, p, (size_t)f->p)) return 0;
  *t->state = 0;
  if (integrate_window(t, z)) return 1;
  memcpy(t->at, own, sizeof(real) * inner), memcpy(t->at + inner, p, sizeof(real) * (size_t)f->p);
  *t->state = 1;
  return 0;
}

void twx_phase_states(const twx_phase *f, int32_t substep, real *eta) {
  twx_memory t;
  twx_lay_out(&t, f, f->work, f->scratch);
  for (size_t k = 0; k < t.K; k++)
    memcpy(eta + k * t.n, q_of(&t, (size_t)substep) + k * t.size, sizeof(real) * t.n);
}

static real *along_of(const twx_memory *t, size_t stage, size_t block) {
  return t->along + (stage * t->blocks + block) * N_OF(t) * SIZE_OF(t) * TWX_LANES;
}

int32_t twx_is_start(const twx_memory *t, size_t place) {
  return place == 0 || (!t->phase->implicit && place == stage_place(t, 0));
}

/* Starts have no memory of their own. */
real *twx_maps_at(const twx_memory *t, size_t place, size_t block) {
  const size_t before = place > stage_place(t, 0) && !t->phase->implicit ? place - 2 : place - 1;
  return t->maps + (before * t->blocks + block) * N_OF(t) * SIZE_OF(t) * TWX_LANES;
}

static void one_of(const twx_memory *t, size_t stride, real *map) { /* that of a start */
  memset(map, 0, sizeof(real) * N_OF(t) * SIZE_OF(t) * stride);
  for (size_t i = 0; i < N_OF(t); i++)
    for (size_t l = 0; l < stride; l++) map[i * (SIZE_OF(t) + 1) * stride + l] = 1;
}

/* The sensitivity of one interval. */
void twx_map_of(const twx_memory *t, size_t place, size_t k, real *map) {
  if (twx_is_start(t, place)) {
    one_of(t, 1, map);
    return;
  }
  const real *const lanes = twx_maps_at(t, place, k / TWX_LANES) + k % TWX_LANES;
  for (size_t i = 0; i < N_OF(t) * SIZE_OF(t); i++) map[i] = lanes[i * TWX_LANES];
}

/* Sensitivities at a place begin as those of the substep's start. */
static void start_maps(const twx_memory *t, size_t substep, size_t block, size_t place) {
  real *const to = twx_maps_at(t, place, block);
  if (twx_is_start(t, substep)) one_of(t, TWX_LANES, to);
  else memcpy(to, twx_maps_at(t, substep, block), sizeof(real) * N_OF(t) * SIZE_OF(t) * TWX_LANES);
}

/* Sensitivities at a place += those of a stage's slope, by this weight. */
static void advance_maps(const twx_memory *t, size_t block, real weight, const real *restrict from, size_t place) {
  const size_t entries = N_OF(t) * SIZE_OF(t);
  real *restrict to = twx_maps_at(t, place, block), factor[TWX_LANES] = {0};
  if (weight == 0) return;
  for (size_t l = 0; l < twx_lanes_of(t, block); l++)
    factor[l] = t->widths[block * TWX_LANES + l] / t->phase->substeps * weight;
  for (size_t e = 0; e < entries; e++)
    for (size_t l = 0; l < TWX_LANES; l++) to[e * TWX_LANES + l] += factor[l] * from[e * TWX_LANES + l];
}

/* Sensitivities of the slopes of a substep, of one interval. */
static int32_t implicit_along(const twx_memory *t, size_t j, size_t k) {
  const size_t s = STAGES_OF(t->phase), entries = N_OF(t) * SIZE_OF(t), sn = s * N_OF(t);
  twx_map_of(t, j, k, t->map);
  for (size_t i = 0; i < s; i++)
    twx_along(N_OF(t), N_OF(t), SIZE_OF(t), t->J + ((j * s + i) * t->K + k) * entries, t->map, t->right + i * entries);
  if (!factorize_stages(t, j, k)) return 1;
  twx_lu_solve(sn, t->matrix + k * sn * sn, t->right + (sn + s) * SIZE_OF(t), SIZE_OF(t), t->right);
  for (size_t i = 0; i < s; i++) {
    real *const lanes = along_of(t, i, k / TWX_LANES) + k % TWX_LANES;
    for (size_t e = 0; e < entries; e++) lanes[e * TWX_LANES] = t->right[i * entries + e];
  }
  return 0;
}

static int32_t implicit_maps(const twx_memory *t, size_t j, size_t block) {
  const twx_phase *f = t->phase;
  const size_t s = STAGES_OF(f), first = block * TWX_LANES;
  for (size_t i = 0; i < s; i++) memset(along_of(t, i, block), 0, sizeof(real) * N_OF(t) * SIZE_OF(t) * TWX_LANES);
  for (size_t l = 0; l < twx_lanes_of(t, block); l++)
    if (implicit_along(t, j, first + l)) return 1;
  for (size_t i = 0; i <= s; i++) {
    const size_t place = i < s ? stage_place(t, j * s + i) : j + 1;
    const real *const weights = i < s ? f->a + i * s : f->b;
    start_maps(t, j, block, place);
    for (size_t l = 0; l < s; l++) advance_maps(t, block, weights[l], along_of(t, l, block), place);
  }
  return 0;
}

/* The sensitivity of each stage's slope adds to those of the stages after it and of the end. */
static void explicit_maps(const twx_memory *t, size_t j, size_t block) {
  const twx_phase *f = t->phase;
  const size_t s = STAGES_OF(f), entries = N_OF(t) * SIZE_OF(t);
  real *const along = t->lane_moved;
  for (size_t i = 0; i < s; i++)
    if (!twx_is_start(t, stage_place(t, j * s + i))) start_maps(t, j, block, stage_place(t, j * s + i));
  start_maps(t, j, block, j + 1);
  for (size_t i = 0; i < s; i++) {
    const size_t place = stage_place(t, j * s + i);
    const real *const J = t->J + (j * s + i) * t->K * entries;
    twx_pack(t, block, entries, entries, J, twx_is_start(t, place) ? along : t->lane_rows);
    if (!twx_is_start(t, place)) twx_lanes_along(t, N_OF(t), t->lane_rows, SIZE_OF(t), twx_maps_at(t, place, block), along);
    for (size_t l = i + 1; l < s; l++) advance_maps(t, block, f->a[l * s + i], along, stage_place(t, j * s + l));
    advance_maps(t, block, f->b[i], along, j + 1);
  }
}

/* Sensitivities of all stages and ends of substeps. Other than 0 where the point cannot be integrated. */
int32_t twx_sensitivities(twx_memory *t, const real *z) {
  const twx_phase *f = t->phase;
  if (twx_integrate(t, z)) return 1;
  if (f->window == 0 && *t->state > 1) return 0;
  for (size_t i = 0; i < t->stages; i++) {
    if (f->implicit) share(t, z, i); /* stages were moved after their last rates */
    rate_slopes(t, z, i);
  }
  for (size_t block = 0; block < t->blocks; block++)
    for (size_t j = 0; j < (size_t)f->substeps; j++) {
      if (!f->implicit) explicit_maps(t, j, block);
      else if (implicit_maps(t, j, block)) return 1;
    }
  *t->state = f->window == 0 ? 2 : twx_is_kept(f);
  return 0;
}

/* to (n,) += factor from (n,) */
TWX_INLINE void add_multiple(size_t n, real factor, const real *restrict from, real *restrict to) {
  for (size_t i = 0; i < n; i++) to[i] += factor * from[i];
}

/* to (n,) += adjoint (n,) times the first n columns of J (n, size) */
TWX_INLINE void add_pulled(size_t n, size_t size, const real *restrict adjoint, const real *restrict J, real *restrict to) {
  for (size_t r = 0; r < n; r++)
    for (size_t i = 0; i < n; i++) to[i] += adjoint[r] * J[r * size + i];
}

/* Adjoints of the slopes of a substep from that of its end, which becomes that of its start. */
static void explicit_adjoints(twx_memory *t, size_t j, size_t k, real *adjoint) {
  const twx_phase *f = t->phase;
  const size_t s = STAGES_OF(f), n = N_OF(t), size = SIZE_OF(t), stride = t->K * n;
  const real length = t->widths[k] / f->substeps, *pulls = t->pulls + (stage_place(t, j * s) * t->K + k) * n;
  real *const adjoints = t->adjoints + k * n, *const through = t->through + k * n;
  for (size_t i = s; i-- > 0;) {
    real *const of_stage = adjoints + i * stride, *const back = through + i * stride;
    memset(of_stage, 0, sizeof(real) * n), memcpy(back, pulls + i * stride, sizeof(real) * n);
    add_multiple(n, length * f->b[i], adjoint, of_stage);
    for (size_t l = i + 1; l < s; l++)
      if (f->a[l * s + i] != 0) add_multiple(n, length * f->a[l * s + i], through + l * stride, of_stage);
    add_pulled(n, size, of_stage, t->J + ((j * s + i) * t->K + k) * n * size, back);
  }
  for (size_t i = 0; i < s; i++) add_multiple(n, 1, through + i * stride, adjoint);
}

static void implicit_adjoints(twx_memory *t, size_t j, size_t k, real *adjoint) {
  const twx_phase *f = t->phase;
  const size_t s = STAGES_OF(f), n = N_OF(t), sn = s * n;
  const real length = t->widths[k] / f->substeps, *pulls = t->pulls + stage_place(t, j * s) * t->K * n;
  real *r = t->right;
  factorize_stages(t, j, k);
  for (size_t i = 0; i < s; i++)
    for (size_t d = 0; d < n; d++) {
      real sum = f->b[i] * adjoint[d];
      for (size_t l = 0; l < s; l++) sum += f->a[l * s + i] * pulls[(l * t->K + k) * n + d];
      r[i * n + d] = length * sum;
    }
  twx_lu_solve_transposed(sn, t->matrix + k * sn * sn, r + (sn + s) * SIZE_OF(t), r);
  for (size_t i = 0; i < s; i++) {
    const real *J = t->J + ((j * s + i) * t->K + k) * n * SIZE_OF(t);
    memcpy(t->adjoints + (i * t->K + k) * n, r + i * n, sizeof(real) * n);
    for (size_t d = 0; d < n; d++) {
      adjoint[d] += pulls[(i * t->K + k) * n + d];
      for (size_t q = 0; q < n; q++) adjoint[d] += r[i * n + q] * J[q * SIZE_OF(t) + d];
    }
  }
}

void twx_adjoint_stages(twx_memory *t, size_t substep, real *adjoint) {
  for (size_t k = 0; k < t->K; k++)
    (t->phase->implicit ? implicit_adjoints : explicit_adjoints)(t, substep, k, adjoint + k * N_OF(t));
}
