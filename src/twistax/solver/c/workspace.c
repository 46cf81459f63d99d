/* Sizes of a problem, and its arrays laid out one after the other in memory that the caller owns. */
#include "work.h"

typedef struct {
  real *at; /* NULL: sizes are counted alone */
  size_t used, bytes; /* bytes: of a number */
} arena;

static real *take(arena *a, size_t count) {
  real *const start = a->at ? a->at + a->used : NULL;
  a->used += count;
  return start;
}

static void *take_bytes(arena *a, size_t bytes) { return take(a, (bytes + a->bytes - 1) / a->bytes); }

/* What the linear system has of a step: steps of the multipliers of bounds follow from it. */
static void take_move(arena *a, const twx_work *w, twx_iterate *q) {
  q->v = take(a, w->variables), q->s = take(a, w->rows), q->lambda = take(a, w->defects), q->y = take(a, w->rows);
  q->ye = take(a, (size_t)w->ne), q->zl = q->zu = q->zs = NULL;
}

static void take_iterate(arena *a, const twx_work *w, twx_iterate *q) {
  take_move(a, w, q);
  q->zl = take(a, w->variables), q->zu = take(a, w->variables), q->zs = take(a, w->rows);
}

static void take_residual(arena *a, const twx_work *w, twx_residual *r) {
  r->v = take(a, w->variables), r->s = take(a, w->rows), r->c = take(a, w->defects);
  r->h = take(a, w->rows), r->e = take(a, (size_t)w->ne);
}

static void take_values(arena *a, const twx_work *w, twx_values *q) {
  q->z = take(a, w->points), q->c = take(a, w->defects), q->h = take(a, w->rows), q->e = take(a, (size_t)w->ne);
}

/* Copies of iterates are one block: v is the first of its arrays. */
void twx_copy_iterate(const twx_work *w, twx_iterate *to, const twx_iterate *from) {
  memcpy(to->v, from->v, sizeof(real) * w->point_size);
}

void twx_copy_step(const twx_work *w, twx_iterate *to, const twx_iterate *from) {
  memcpy(to->v, from->v, sizeof(real) * (w->variables + 2 * w->rows + w->defects + (size_t)w->ne));
}

static int32_t sizes_are_possible(const twx_problem *p) {
  if (p->intervals < 1 || p->parameters < 0 || p->controls[p->intervals] != 0) return 0;
  for (int32_t k = 0; k <= p->intervals; k++) {
    if (p->states[k] < 0 || p->controls[k] < 0 || p->inequalities[k] < 0 || p->equalities[k] < 0) return 0;
    if (p->point_states && (p->point_states[k] < 0 || !p->retract)) return 0;
  }
  return 1;
}

typedef struct {
  size_t F, Jh, Je, H, P, W, L, K, k;
  int32_t nx, nu, nv, n, nh, ne;
} totals;

static int32_t largest(int32_t a, int32_t b) { return a > b ? a : b; }

static int32_t smallest(int32_t a, int32_t b) { return a < b ? a : b; }

/* Where the stages lie. `stages` may be NULL: then they are counted alone. */
static void place_stages(twx_work *w, const twx_problem *p, twx_stage *stages, totals *t) {
  size_t v = 0, z = 0, c = 0, h = 0, e = 0;
  int32_t all_ne = 0;
  for (int32_t k = 0; k <= p->intervals; k++) all_ne += p->equalities[k];
  w->N = p->intervals, w->np = p->parameters, w->ne = w->nbe = all_ne, w->nb = p->parameters + all_ne;
  memset(t, 0, sizeof *t);
  for (int32_t k = 0; k <= w->N; k++) {
    twx_stage s = {.nx = p->states[k], .nu = p->controls[k], .nh = p->inequalities[k], .ne = p->equalities[k]};
    s.nv = s.nx + s.nu, s.n = s.nv + w->np, s.next = k < w->N ? p->states[k + 1] : 0;
    s.point_states = p->point_states ? p->point_states[k] : s.nx;
    s.v = v, s.z = z, s.c = c, s.h = h, s.e = e;
    s.F = t->F, s.Jh = t->Jh, s.Je = t->Je, s.H = t->H, s.P = t->P, s.W = t->W, s.L = t->L, s.K = t->K, s.k = t->k;
    if (stages) stages[k] = s;
    const int32_t block = s.nu + smallest(s.nu, s.ne); /* of controls and of multipliers that go with them */
    const size_t nx = (size_t)s.nx, nu = (size_t)s.nu, n = (size_t)s.n, nb = (size_t)w->nb, m = (size_t)block;
    v += nx + nu, z += (size_t)s.point_states + nu, c += (size_t)s.next, h += (size_t)s.nh, e += (size_t)s.ne;
    t->F += (size_t)s.next * n, t->Jh += (size_t)s.nh * n, t->Je += (size_t)s.ne * n, t->H += n * n;
    t->P += nx * nx, t->W += nx * nb, t->L += twx_factor_size(block), t->K += m * (nx + nb), t->k += m;
    t->nx = largest(t->nx, s.nx), t->nu = largest(t->nu, s.nu), t->nv = largest(t->nv, s.nv);
    t->n = largest(t->n, s.n), t->nh = largest(t->nh, s.nh), t->ne = largest(t->ne, s.ne);
  }
  w->variables = v + (size_t)w->np, w->points = z + (size_t)w->np, w->defects = c, w->rows = h;
  w->point_size = 3 * (w->variables + w->rows) + w->defects + (size_t)w->ne;
}

/* Factors and steps: nothing that a point needs, so that functions may use the memory while they differentiate there. */
static void take_system(arena *a, twx_work *w, const totals *t) {
  const size_t V = w->variables, E = (size_t)w->ne, B = (size_t)w->nb, X = (size_t)t->nx, n = (size_t)t->n, np = (size_t)w->np;
  const size_t m = 2 * (size_t)t->nu;
  take_iterate(a, w, &w->step), take_move(a, w, &w->corrected), take_move(a, w, &w->refinement);
  take_residual(a, w, &w->right), take_residual(a, w, &w->correction), take_residual(a, w, &w->residual);
  take_values(a, w, &w->trial), w->trial.v = take(a, V), w->trial.s = take(a, w->rows), w->moved = take(a, V);
  w->P = take(a, t->P), w->W = take(a, t->W), w->L = take(a, t->L), w->K = take(a, t->K);
  w->L0 = take(a, twx_factor_size(t->nx)), w->K0 = take(a, X * B), w->S = take(a, B * B);
  w->Lp = take(a, twx_factor_size(w->np)), w->Z = take(a, np * E), w->C = take(a, twx_factor_size(w->ne));
  w->p = take(a, V), w->k = take(a, t->k), w->border = take(a, B);
  w->t1 = take(a, twx_most(2 * X * n + (X + n) * E, twx_most(2 * twx_most(m, X) * (X + B), twx_most(np * E, m * m))));
  w->t2 = take(a, n * (B + 1));
}

static size_t carve(twx_work *w, const twx_problem *p, arena a) {
  totals t;
  place_stages(w, p, NULL, &t);
  take_system(&a, w, &t);
  a.used = twx_most(a.used, p->scratch);
  w->stages = take_bytes(&a, sizeof(twx_stage) * ((size_t)p->intervals + 1));
  place_stages(w, p, w->stages, &t);
  const size_t V = w->variables, R = w->rows, E = (size_t)w->ne, n = (size_t)t.n;
  const size_t columns = twx_most(twx_most((size_t)t.nx, 2 * (size_t)t.nu), twx_most((size_t)w->np, E));
  take_iterate(&a, w, &w->iterate), take_iterate(&a, w, &w->best);
  take_values(&a, w, &w->here), w->here.v = w->iterate.v, w->here.s = w->iterate.s;
  w->best_z = take(&a, w->points), w->watchdog = (twx_iterate){0}, w->watchdog_z = NULL;
  if (!p->without_watchdog) take_iterate(&a, w, &w->watchdog), w->watchdog_z = take(&a, w->points);
  w->lower = take(&a, V), w->upper = take(&a, V), w->free = take(&a, V);
  w->ones = p->size ? NULL : take(&a, V), w->size = p->size ? p->size : w->ones;
  w->row_scale = take(&a, R), w->equality_scale = take(&a, E), w->gradient = take(&a, V);
  w->F = take(&a, t.F), w->Jh = take(&a, t.Jh), w->Je = take(&a, t.Je), w->H = take(&a, t.H);
  w->Sv = take(&a, V), w->Ss = take(&a, R), w->place = take_bytes(&a, sizeof(int32_t) * (E + 1));
  w->t0 = take(&a, n * n);
  w->t3 = take(&a, twx_most(twx_most(V + (size_t)w->np, w->defects + R + E), twx_most(twx_most(4 * columns, n), 2 * ((size_t)t.nh + (size_t)t.ne))));
  w->filter_size = p->filter_rows > 0 ? p->filter_rows : TWX_FILTER_ROWS;
  w->filter = take(&a, 2 * (size_t)w->filter_size);
  return a.used;
}

size_t twx_carve(twx_work *w, const twx_problem *p, real *base) { return carve(w, p, (arena){base, 0, sizeof(real)}); }

size_t twx_workspace_size(const twx_problem *p, size_t bytes) {
  twx_work w;
  const size_t size = sizes_are_possible(p) ? carve(&w, p, (arena){NULL, 0, bytes}) : 0;
  return size <= UINT32_MAX ? size : 0; /* places of stages are numbers of 32 bits */
}

int32_t twx_count(const twx_problem *p, twx_counts *counts) {
  twx_work w;
  totals t;
  if (!sizes_are_possible(p)) return TWX_BAD_PROBLEM;
  place_stages(&w, p, NULL, &t);
  *counts = (twx_counts){w.variables, w.points, w.defects, w.rows, (size_t)w.ne, t.F, t.Jh, t.Je, t.H};
  return TWX_SOLVED;
}
