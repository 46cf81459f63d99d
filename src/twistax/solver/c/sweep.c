/* Solutions of the linear system of a step with its factors: one sweep back, the border, one sweep ahead, refinement.
 *
 * The system for a right side r, with the rows of c, h + s and e linearised:
 *   (H + Sv + identity) v + F'lambda - lambda_before + Jh'y + Je'ye = -r.v      F v - v_next = -r.c
 *   (Ss + identity) s + y = -r.s        Jh v + s - softness y = -r.h            Je v - softness ye = -r.e
 */
#include "work.h"

/* y of the rows of a stage where v = 0: (sigma r.h - r.s) / (1 + softness sigma). */
TWX_INLINE void rows_at_rest(const twx_work *w, const twx_stage *s, const twx_residual *r, real *y) {
  for (int32_t i = 0; i < s->nh; i++) {
    const size_t row = s->h + (size_t)i;
    const real sigma = w->Ss[row] + w->identity;
    y[i] = (sigma * r->h[row] - r->s[row]) / (1 + w->softness * sigma);
  }
}

/* The gradient of a stage in (x, u, p) without what follows; p's part of the cost itself is added once, at the end. */
TWX_INLINE void stage_gradient(twx_work *w, const twx_stage *s, const twx_residual *r, real *q) {
  real *const y = w->t3;
  memset(q, 0, sizeof(real) * (size_t)s->n);
  memcpy(q, r->v + s->v, sizeof(real) * (size_t)s->nv);
  rows_at_rest(w, s, r, y);
  twx_add_apply_transposed(s->nh, s->n, w->Jh + s->Jh, s->nh, y, q);
  for (int32_t i = 0; i < s->ne; i++) y[i] = w->place[s->e + (size_t)i] < 0 ? 0 : w->weight * r->e[s->e + (size_t)i];
  twx_add_apply_transposed(s->ne, s->n, w->Je + s->Je, s->ne, y, q);
}

TWX_INLINE void stage_back(twx_work *w, int32_t k, const twx_stage *s, const twx_residual *r) {
  const twx_stage *const next = w->stages + k + 1;
  const int32_t nx = s->nx, nu = s->nu, np = NP_OF(w), nb = NB_OF(w);
  real *const slope = w->t1, *const q = w->t2;
  stage_gradient(w, s, r, q);
  if (k < w->N) {
    memcpy(slope, w->p + next->v, sizeof(real) * (size_t)s->next);
    twx_add_apply(s->next, s->next, w->P + next->P, s->next, r->c + s->c, slope);
    twx_add_apply_transposed(s->next, s->n, w->F + s->F, s->next, slope, q);
    twx_add_apply_transposed(s->next, nb, w->W + next->W, s->next, r->c + s->c, w->border);
  }
  for (int32_t i = 0; i < np; i++) w->border[i] += q[s->nv + i];
  real *const p = w->p + s->v, *const step = w->k + s->k;
  for (int32_t i = 0; i < nu; i++) step[i] = w->free[s->v + (size_t)(nx + i)] == 0 ? 0 : q[nx + i];
  for (int32_t i = 0; i < s->ne; i++) {
    const int32_t place = w->place[s->e + (size_t)i];
    if (place < 0) step[nu - place - 1] = r->e[s->e + (size_t)i];
  }
  const int32_t m = nu + s->nl;
  const twx_factor B = twx_factor_in(m, w->L + s->L);
  memcpy(p, q, sizeof(real) * (size_t)nx);
  twx_add_apply_transposed(m, nx, w->K + s->K, m, step, p);
  twx_add_apply_transposed(m, nb, w->K + s->K + (size_t)nx * (size_t)m, m, step, w->border);
  for (int32_t i = 0; i < m; i++) step[i] = -step[i];
  twx_solve_symmetric(&B, 1, step, w->t3);
}

/* Back: p of every node, k = -B^-1 (q_u, e) of every stage, and the right side of the border. */
static void sweep_back(twx_work *w, const twx_residual *r) {
  for (int32_t i = 0; i < NP_OF(w); i++) w->border[i] = r->v[w->variables - (size_t)(NP_OF(w) - i)];
  for (int32_t i = 0; i < w->ne; i++) if (w->place[i] >= 0) w->border[NP_OF(w) + w->place[i]] = r->e[i];
  for (int32_t k = w->N; k >= 0; k--) TWX_AT(w, k, stage_back, r);
}

/* The free entries of x_0 at rest, in `start`, and what they add to the border. */
static void solve_start(twx_work *w, real *start) {
  const int32_t nx = w->stages[0].nx;
  for (int32_t i = 0; i < nx; i++) start[i] = w->free[i] != 0 ? w->p[i] : 0;
  twx_add_apply_transposed(nx, NB_OF(w), w->K0, nx, start, w->border);
  for (int32_t i = 0; i < nx; i++) start[i] = -start[i];
  const twx_factor f = twx_factor_in(nx, w->L0);
  twx_solve_symmetric(&f, 1, start, w->t3);
}

/* border = the parameters' step and the equalities' multipliers, of its right side. With S_pp = Q'L D L'Q:
 * t = L^-1 Q r_p,  C ye = r_e - Z'D^-1 t,  p = -Q'L'^-1 D^-1 (t + Z ye). */
static void solve_border(twx_work *w) {
  const int32_t np = NP_OF(w), ne = w->nbe;
  const twx_factor parameters = twx_factor_in(np, w->Lp), equalities = twx_factor_in(ne, w->C);
  real *const r = w->border, *const ye = r + np, *const t = w->t2;
  for (int32_t i = 0; i < np; i++) if (w->free[w->variables - (size_t)(np - i)] == 0) r[i] = 0;
  twx_solve_lower_part(&parameters, 1, r, w->t3);
  memcpy(t, r, sizeof(real) * (size_t)np);
  twx_solve_diagonal_part(&parameters, 1, t);
  for (int32_t j = 0; j < ne; j++)
    for (int32_t i = 0; i < np; i++) ye[j] -= w->Z[i + (size_t)j * (size_t)np] * t[i];
  twx_solve_symmetric(&equalities, 1, ye, w->t3);
  twx_add_apply(np, ne, w->Z, np, ye, r);
  for (int32_t i = 0; i < np; i++) r[i] = -r[i];
  twx_solve_diagonal_part(&parameters, 1, r);
  twx_solve_upper_part(&parameters, 1, r, w->t3);
}

TWX_INLINE void stage_ahead(twx_work *w, int32_t k, const twx_stage *s, const twx_residual *r, twx_iterate *d) {
  const twx_stage *const next = w->stages + k + 1;
  real *const x = d->v + s->v, *const after = d->v + next->v, *const lambda = d->lambda + s->c, *const u = w->t2;
  const int32_t m = s->nu + s->nl, nb = NB_OF(w), np = NP_OF(w);
  memcpy(u, w->k + s->k, sizeof(real) * (size_t)m);
  twx_add_apply(m, s->nx, w->K + s->K, m, x, u);
  twx_add_apply(m, nb, w->K + s->K + (size_t)s->nx * (size_t)m, m, w->border, u);
  memcpy(x + s->nx, u, sizeof(real) * (size_t)s->nu);
  for (int32_t i = 0; i < s->ne; i++) {
    const int32_t place = w->place[s->e + (size_t)i];
    if (place < 0) d->ye[s->e + (size_t)i] = u[s->nu - place - 1];
  }
  memcpy(after, r->c + s->c, sizeof(real) * (size_t)s->next);
  twx_add_apply(s->next, s->nv, w->F + s->F, s->next, x, after);
  twx_add_apply(s->next, np, w->F + s->F + (size_t)s->nv * (size_t)s->next, s->next, w->border, after);
  memcpy(lambda, w->p + next->v, sizeof(real) * (size_t)s->next);
  twx_add_apply(s->next, s->next, w->P + next->P, s->next, after, lambda);
  twx_add_apply(s->next, nb, w->W + next->W, s->next, w->border, lambda);
}

/* Ahead: the step of v, and lambda. `start` is x_0 at rest. */
static void sweep_ahead(twx_work *w, const twx_residual *r, const real *start, twx_iterate *d) {
  const int32_t np = NP_OF(w);
  memcpy(d->v, start, sizeof(real) * (size_t)w->stages[0].nx);
  twx_add_apply(w->stages[0].nx, NB_OF(w), w->K0, w->stages[0].nx, w->border, d->v);
  for (int32_t k = 0; k < w->N; k++) TWX_AT(w, k, stage_ahead, r, d);
  memcpy(d->v + w->variables - (size_t)np, w->border, sizeof(real) * (size_t)np);
  /* The squares of equalities, weight |Je v + e|^2 / 2, are a part of the multipliers where a row is left soft. */
  for (int32_t i = 0; i < w->ne; i++)
    if (w->place[i] >= 0) d->ye[i] = w->border[np + w->place[i]] * (1 + w->weight * w->border_softness);
}

/* product (rows,) += J (x, u, p) of a block of rows of a stage. */
TWX_INLINE void along(const twx_work *w, const twx_stage *s, int32_t rows, const real *J, const real *v, real *product) {
  twx_add_apply(rows, s->nv, J, rows, v + s->v, product);
  twx_add_apply(rows, NP_OF(w), J + (size_t)s->nv * (size_t)rows, rows, v + w->variables - (size_t)NP_OF(w), product);
}

static void slacks(twx_work *w, const twx_residual *r, twx_iterate *d) {
  memset(d->s, 0, sizeof(real) * w->rows);
  FOR_STAGES(w, k, s) along(w, s, s->nh, w->Jh + s->Jh, d->v, d->s + s->h);
  for (size_t i = 0; i < w->rows; i++) {
    const real sigma = w->Ss[i] + w->identity, rest = -r->h[i] - d->s[i];
    d->y[i] = (-r->s[i] - sigma * rest) / (1 + w->softness * sigma);
    d->s[i] = rest + w->softness * d->y[i];
  }
}

static void solve_once(twx_work *w, const twx_residual *r, twx_iterate *d) {
  real *const start = w->t0;
  sweep_back(w, r);
  solve_start(w, start);
  solve_border(w);
  sweep_ahead(w, r, start, d);
  slacks(w, r, d);
}

/* left += block' multipliers, for (x, u) of the stage and for p. */
TWX_INLINE void add_pull(const twx_work *w, const twx_stage *s, int32_t rows, const real *J, const real *multipliers, real *left) {
  twx_add_apply_transposed(rows, s->nv, J, rows, multipliers, left + s->v);
  twx_add_apply_transposed(rows, NP_OF(w), J + (size_t)s->nv * (size_t)rows, rows, multipliers, left + w->variables - (size_t)NP_OF(w));
}

/* The rows of a stage in left += K d. */
TWX_INLINE void stage_product(twx_work *w, int32_t k, const twx_stage *s, const twx_iterate *d, twx_residual *left, int32_t with_hessian) {
  const size_t p = w->variables - (size_t)NP_OF(w), next = w->stages[k < w->N ? k + 1 : k].v;
  if (with_hessian) {
    real *const z = w->t2, *const product = w->t3;
    memcpy(z, d->v + s->v, sizeof(real) * (size_t)s->nv), memcpy(z + s->nv, d->v + p, sizeof(real) * (size_t)NP_OF(w));
    memset(product, 0, sizeof(real) * (size_t)s->n);
    twx_add_apply(s->n, s->n, w->H + s->H, s->n, z, product);
    for (int32_t i = 0; i < s->nv; i++) left->v[s->v + (size_t)i] += product[i];
    for (int32_t i = 0; i < NP_OF(w); i++) left->v[p + (size_t)i] += product[s->nv + i];
  }
  add_pull(w, s, s->nh, w->Jh + s->Jh, d->y + s->h, left->v), along(w, s, s->nh, w->Jh + s->Jh, d->v, left->h + s->h);
  add_pull(w, s, s->ne, w->Je + s->Je, d->ye + s->e, left->v), along(w, s, s->ne, w->Je + s->Je, d->v, left->e + s->e);
  add_pull(w, s, s->next, w->F + s->F, d->lambda + s->c, left->v), along(w, s, s->next, w->F + s->F, d->v, left->c + s->c);
  for (int32_t i = 0; i < s->next; i++) {
    left->v[next + (size_t)i] -= d->lambda[s->c + (size_t)i];
    left->c[s->c + (size_t)i] -= d->v[next + (size_t)i];
  }
}

/* left = r + K d: what a step leaves of the equations. */
void twx_product(twx_work *w, const twx_residual *r, const twx_iterate *d, twx_residual *left, int32_t with_hessian) {
  const real of_border = w->softness + w->border_softness / (1 + w->weight * w->border_softness);
  for (size_t i = 0; i < w->variables; i++) left->v[i] = r->v[i] + (w->Sv[i] + w->identity) * d->v[i];
  memcpy(left->h, r->h, sizeof(real) * w->rows), memcpy(left->e, r->e, sizeof(real) * (size_t)w->ne);
  memcpy(left->c, r->c, sizeof(real) * w->defects);
  for (int32_t k = 0; k <= w->N; k++) TWX_AT(w, k, stage_product, d, left, with_hessian);
  for (size_t i = 0; i < w->rows; i++) {
    left->h[i] += d->s[i] - w->softness * d->y[i];
    left->s[i] = r->s[i] + (w->Ss[i] + w->identity) * d->s[i] + d->y[i];
  }
  for (size_t i = 0; i < (size_t)w->ne; i++)
    left->e[i] -= (w->place[i] < 0 ? w->softness + w->local_softness : of_border) * d->ye[i];
}

static real size_of_entries(size_t count, const real *a) {
  real most = 0;
  for (size_t i = 0; i < count; i++) most = twx_max(most, fabs(a[i]));
  return most;
}

/* What a step leaves of the equations of free variables: its size, over what may be left of this right side. */
static real remainder_of(twx_work *w, const twx_residual *r, const twx_iterate *d, twx_residual *left, int32_t with_hessian) {
  const size_t ne = (size_t)w->ne;
  twx_product(w, r, d, left, with_hessian);
  for (size_t i = 0; i < w->variables; i++) if (w->free[i] == 0) left->v[i] = 0;
  const real size = twx_max(twx_max(size_of_entries(w->variables, left->v), size_of_entries(w->rows, left->h)),
                              twx_max(size_of_entries(ne, left->e), size_of_entries(w->defects, left->c)));
  const real whole = twx_max(twx_max(twx_max(size_of_entries(w->variables, r->v), size_of_entries(w->rows, r->h)), size_of_entries(w->rows, r->s)),
                               twx_max(size_of_entries(ne, r->e), size_of_entries(w->defects, r->c)));
  return size / twx_max(TWX_LEAST, twx_min(w->options->refinement_error * whole, w->options->refinement_share * w->exactness * w->options->tolerance));
}

static void add(size_t count, real *to, real factor, const real *from) {
  for (size_t i = 0; i < count; i++) to[i] += factor * from[i];
}

static void add_step(const twx_work *w, twx_iterate *to, real factor, const twx_iterate *from) {
  add(w->variables, to->v, factor, from->v), add(w->rows, to->s, factor, from->s);
  add(w->defects, to->lambda, factor, from->lambda), add(w->rows, to->y, factor, from->y);
  add((size_t)w->ne, to->ye, factor, from->ye);
}

/* v, s, lambda, y and ye of a step. */
void twx_solve_system(twx_work *w, const twx_residual *right, twx_iterate *d, int32_t with_hessian) {
  real before = INFINITY;
  solve_once(w, right, d);
  for (int32_t n = 0; n <= (int32_t)w->options->refinements; n++) {
    const real left = remainder_of(w, right, d, &w->residual, with_hessian);
    if (!(left < before) && n > 0) add_step(w, d, -1, &w->refinement); /* refined in vain */
    if (left <= 1 || !(left < before) || n == (int32_t)w->options->refinements) return;
    before = left;
    solve_once(w, &w->residual, &w->refinement);
    add_step(w, d, 1, &w->refinement);
  }
}
