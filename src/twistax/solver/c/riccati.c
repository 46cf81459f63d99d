/* The linear system of a step, factored from the last stage to the first.
 *
 * The cost of what follows a node is  x'P x/2 + x'W b + b'S b/2 + x'p + b's  with the border b = (p, ye): parameters
 * that all stages share and multipliers of equalities. A stage adds its cost in (x, u, p); then it is eliminated with the
 * multipliers y of those of its equalities, E_u u + E_x x + E_p p + e = 0, that controls decide:
 *
 *   M = H + Jh' Sigma Jh + weight Je'Je + F'P F + (W F terms),   B = [M_uu E_u'; E_u 0],   K = -B^-1 [M_ux M_ub; E_x E_b].
 *
 * Blocks may be indefinite. The equations have the inertia of a minimum exactly if their negative eigenvalues, of all
 * blocks together, are as many as there are equalities (E. V. Haynsworth, Linear Algebra Appl. 1 (1968): inertias of a
 * block and of its Schur complement add up).
 * Source: C. V. Rao, S. J. Wright, J. B. Rawlings, Application of interior-point methods to model predictive control,
 * J. Optim. Theory Appl. 99 (1998), section 3.
 */
#include "work.h"

static real row_weight(const twx_work *w, size_t row) { /* 1 / (1/Sigma + softness) */
  const real sigma = w->Ss[row] + w->identity;
  return sigma / (1 + w->softness * sigma);
}

/* M += J' diag(weights) J of a block of rows (rows, n); the upper triangle. */
TWX_INLINE void add_squares(int32_t rows, int32_t n, const real *J, const real *weights, real *scratch, real *M) {
  for (int32_t j = 0; j < n; j++) {
    const real *column = J + (size_t)j * (size_t)rows;
    for (int32_t r = 0; r < rows; r++) scratch[r] = weights[r] * column[r];
    twx_add_product_transposed(j + 1, 1, rows, J, rows, scratch, rows, M + (size_t)j * (size_t)n, n);
  }
}

/* The cost of a stage alone in (x, u, p), in t0 (n, n), its upper triangle. */
TWX_INLINE void stage_cost(twx_work *w, const twx_stage *s, int32_t with_hessian) {
  const int32_t n = s->n;
  real *const M = w->t0, *const weights = w->t3, *const scratch = weights + s->nh + s->ne;
  if (with_hessian) memcpy(M, w->H + s->H, sizeof(real) * (size_t)n * (size_t)n);
  else memset(M, 0, sizeof(real) * (size_t)n * (size_t)n);
  for (int32_t i = 0; i < s->nv; i++) M[i + (size_t)i * (size_t)n] += w->Sv[s->v + (size_t)i] + w->identity;
  for (int32_t i = 0; i < s->nh; i++) weights[i] = row_weight(w, s->h + (size_t)i);
  add_squares(s->nh, n, w->Jh + s->Jh, weights, scratch, M);
  for (int32_t i = 0; i < s->ne; i++) weights[i] = w->place[s->e + (size_t)i] < 0 ? 0 : w->weight;
  if (w->weight > 0) add_squares(s->ne, n, w->Je + s->Je, weights, scratch, M);
}

typedef struct { /* rows first <= i < last of a column; all others are zero */
  int32_t first, last;
} column_range;

TWX_INLINE void mirror(int32_t n, real *M) { /* the lower triangle from the upper */
  for (int32_t j = 0; j < n; j++)
    for (int32_t i = 0; i < j; i++) M[j + (size_t)i * (size_t)n] = M[i + (size_t)j * (size_t)n];
}

TWX_INLINE void mirror_up(int32_t n, real *M) { /* the upper triangle from the lower */
  for (int32_t j = 0; j < n; j++)
    for (int32_t i = 0; i < j; i++) M[i + (size_t)j * (size_t)n] = M[j + (size_t)i * (size_t)n];
}

TWX_INLINE void transpose(int32_t m, int32_t n, const real *restrict A, real *restrict B) { /* B (n, m) = A' */
  for (int32_t j = 0; j < n; j++)
    for (int32_t i = 0; i < m; i++) B[j + (size_t)i * (size_t)n] = A[i + (size_t)j * (size_t)m];
}

TWX_INLINE column_range nonzeros(int32_t n, const real *column) {
  column_range r = {0, n};
  while (r.first < n && column[r.first] == 0) r.first++;
  while (r.last > r.first && column[r.last - 1] == 0) r.last--;
  return r;
}

/* What follows: the lower triangle of t0 += F'P F and its terms with W; t2 (n, border rows) = the columns of the border's
 * multipliers. Columns of F have zeros at their ends: those of states that are constant, one entry. Factors are transposed,
 * so that columns of results are sums of columns. */
TWX_INLINE void add_cost_to_go(twx_work *w, const twx_stage *s, const twx_stage *next) {
  const int32_t n = s->n, nx = s->next, nv = s->nv, np = NP_OF(w), nbe = w->nbe;
  const real *const F = w->F + s->F, *const P = w->P + next->P, *const W = w->W + next->W;
  real *const M = w->t0, *const T = w->t1, *const R = w->t2, *const Tt = T + (size_t)nx * (size_t)n;
  real *const Wt = Tt + (size_t)nx * (size_t)n, *const Rt = Wt + (size_t)nx * (size_t)nbe;
  memset(T, 0, sizeof(real) * (size_t)nx * (size_t)n);
  for (int32_t j = 0; j < n; j++) {
    const real *const f = F + (size_t)j * (size_t)nx;
    const column_range r = nonzeros(nx, f);
    twx_add_product(nx, 1, r.last - r.first, P + (size_t)r.first * (size_t)nx, nx, f + r.first, nx, T + (size_t)j * (size_t)nx, nx);
  }
  for (int32_t j = 0; j < np; j++) /* F'W_p of rows before p; of p itself both orders */
    for (int32_t i = 0; i < nx; i++) T[i + (size_t)(nv + j) * (size_t)nx] += W[i + (size_t)j * (size_t)nx];
  transpose(nx, n, T, Tt), transpose(nx, nbe, W + (size_t)np * (size_t)nx, Wt), mirror(n, M);
  memset(Rt, 0, sizeof(real) * (size_t)n * (size_t)nbe);
  for (int32_t i = 0; i < n; i++) {
    const column_range r = nonzeros(nx, F + (size_t)i * (size_t)nx);
    const real *const f = F + (size_t)i * (size_t)nx + r.first;
    const int32_t count = r.last - r.first;
    twx_add_sums(n - i, count, 1, Tt + i + (size_t)r.first * (size_t)n, n, f, M + i + (size_t)i * (size_t)n);
    if (i >= nv) twx_add_dots(i - nv + 1, count, 1, W + r.first, nx, f, M + i + (size_t)nv * (size_t)n, n);
    twx_add_sums(nbe, count, 1, Wt + (size_t)r.first * (size_t)nbe, nbe, f, Rt + (size_t)i * (size_t)nbe);
  }
  transpose(nbe, n, Rt, R), mirror_up(n, M);
}

/* The rows of the stage's equalities that stand in the border, in the columns of their multipliers. */
TWX_INLINE void add_equalities(twx_work *w, const twx_stage *s) {
  for (int32_t r = 0; r < s->ne; r++) {
    const int32_t place = w->place[s->e + (size_t)r];
    if (place < 0) continue;
    real *column = w->t2 + (size_t)place * (size_t)s->n;
    for (int32_t i = 0; i < s->n; i++) column[i] += w->Je[s->Je + (size_t)r + (size_t)i * (size_t)s->ne];
  }
}

/* Rows and columns of fixed variables become those of the identity. M (n, n) whole, R (n, columns) or NULL. */
TWX_INLINE void fix(const real *free, int32_t first, int32_t count, int32_t n, real *M, int32_t columns, real *R) {
  for (int32_t l = 0; l < count; l++) {
    if (free[l] != 0) continue;
    const int32_t i = first + l;
    for (int32_t j = 0; j < n; j++) M[i + (size_t)j * (size_t)n] = M[j + (size_t)i * (size_t)n] = 0;
    M[i + (size_t)i * (size_t)n] = 1;
    for (int32_t j = 0; j < columns; j++) R[i + (size_t)j * (size_t)n] = 0;
  }
}

/* The upper triangle of S of the border, of what M and R have for it: parameters by parameters, by equalities. */
TWX_INLINE void add_to_border(twx_work *w, const twx_stage *s) {
  const int32_t np = NP_OF(w), nb = NB_OF(w), nv = s->nv, n = s->n;
  for (int32_t j = 0; j < np; j++)
    for (int32_t i = 0; i < np; i++) w->S[i + (size_t)j * (size_t)nb] += w->t0[nv + i + (size_t)(nv + j) * (size_t)n];
  for (int32_t j = 0; j < w->nbe; j++)
    for (int32_t i = 0; i < np; i++) w->S[i + (size_t)(np + j) * (size_t)nb] += w->t2[nv + i + (size_t)j * (size_t)n];
}

/* The upper triangle of S -= Y T, with Y' and T blocks (rows, nb); Y has this leading dimension. */
TWX_INLINE void subtract_from_border(twx_work *w, int32_t rows, const real *Y, int32_t leading, const real *T) {
  for (int32_t j = 0; j < NB_OF(w); j++)
    twx_add_sums(j + 1, rows, -1, Y, leading, T + (size_t)j * (size_t)rows, w->S + (size_t)j * (size_t)NB_OF(w));
}

TWX_INLINE void negate(size_t count, real *a) {
  for (size_t i = 0; i < count; i++) a[i] = -a[i];
}

/* B of a stage, its lower triangle. */
TWX_INLINE void fill_block(twx_work *w, const twx_stage *s, const twx_factor *B) {
  const int32_t nx = s->nx, nu = s->nu, n = s->n, m = B->n;
  for (int32_t j = 0; j < nu; j++)
    memcpy(B->A + (size_t)j * (size_t)m, w->t0 + nx + (size_t)(nx + j) * (size_t)n, sizeof(real) * (size_t)nu);
  for (int32_t r = 0; r < s->ne; r++) {
    if (w->place[s->e + (size_t)r] >= 0) continue;
    const int32_t row = nu - w->place[s->e + (size_t)r] - 1;
    for (int32_t j = 0; j < nu; j++)
      B->A[row + (size_t)j * (size_t)m] =
          w->free[s->v + (size_t)(nx + j)] == 0 ? 0 : w->Je[s->Je + (size_t)r + (size_t)(nx + j) * (size_t)s->ne];
    for (int32_t j = nu; j <= row; j++) B->A[row + (size_t)j * (size_t)m] = j == row ? -w->softness - w->local_softness : 0;
  }
}

/* [M_ux | M_up | R_u] over [E_x | E_p | 0] of a stage, in K; P and W begin as those of x. */
TWX_INLINE void fill_sides(twx_work *w, const twx_stage *s) {
  const int32_t nx = s->nx, nu = s->nu, n = s->n, m = nu + s->nl, np = NP_OF(w);
  real *const Y = w->K + s->K;
  for (int32_t j = 0; j < nx + NB_OF(w); j++) {
    const real *from = j < nx        ? w->t0 + (size_t)j * (size_t)n
                         : j < nx + np ? w->t0 + (size_t)(s->nv + j - nx) * (size_t)n
                                       : w->t2 + (size_t)(j - nx - np) * (size_t)n;
    real *const to = j < nx ? w->P + s->P + (size_t)j * (size_t)nx : w->W + s->W + (size_t)(j - nx) * (size_t)nx;
    real *const y = Y + (size_t)j * (size_t)m;
    memcpy(y, from + nx, sizeof(real) * (size_t)nu), memset(y + nu, 0, sizeof(real) * (size_t)s->nl);
    memcpy(to, from, sizeof(real) * (size_t)nx);
    if (j >= nx + np) continue;
    const real *column = w->Je + s->Je + (size_t)(j < nx ? j : j + nu) * (size_t)s->ne;
    for (int32_t r = 0; r < s->ne; r++) {
      const int32_t place = w->place[s->e + (size_t)r];
      if (place < 0) y[nu - place - 1] = column[r];
    }
  }
}

/* Eliminate u and the multipliers of the stage: L, K and P, W. The count of negative eigenvalues beyond those of
 * equalities, or -1 where the block is singular. */
TWX_INLINE int32_t eliminate(twx_work *w, const twx_stage *s) {
  const int32_t nx = s->nx, m = s->nu + s->nl, columns = nx + NB_OF(w);
  const twx_factor B = twx_factor_in(m, w->L + s->L);
  real *const Y = w->K + s->K, *const T = w->t1, *const Yt = T + (size_t)m * (size_t)columns;
  fill_block(w, s, &B);
  const int32_t negative = twx_factorize_symmetric(&B);
  if (negative < s->nl) return -1;
  fill_sides(w, s);
  twx_solve_lower_part(&B, columns, Y, w->t3);
  memcpy(T, Y, sizeof(real) * (size_t)m * (size_t)columns);
  twx_solve_diagonal_part(&B, columns, T);
  transpose(m, columns, Y, Yt);
  for (int32_t j = 0; j < columns; j++) {
    real *to = j < nx ? w->P + s->P + (size_t)j * (size_t)nx : w->W + s->W + (size_t)(j - nx) * (size_t)nx;
    twx_add_sums(j < nx ? j + 1 : nx, m, -1, Yt, columns, T + (size_t)j * (size_t)m, to);
  }
  mirror(nx, w->P + s->P);
  subtract_from_border(w, m, Yt + nx, columns, T + (size_t)nx * (size_t)m);
  memcpy(Y, T, sizeof(real) * (size_t)m * (size_t)columns);
  twx_solve_upper_part(&B, columns, Y, w->t3);
  negate((size_t)m * (size_t)columns, Y);
  return negative - s->nl;
}

/* Eliminate the free entries of x_0. */
static int32_t eliminate_start(twx_work *w) {
  const int32_t nx = w->stages[0].nx, nb = NB_OF(w);
  const size_t sides = sizeof(real) * (size_t)nx * (size_t)nb;
  const twx_factor f = twx_factor_in(nx, w->L0);
  memcpy(f.A, w->P, sizeof(real) * (size_t)nx * (size_t)nx);
  memcpy(w->K0, w->W, sides);
  fix(w->free, 0, nx, nx, f.A, nb, w->K0);
  const int32_t negative = twx_factorize_symmetric(&f);
  if (negative < 0) return -1;
  twx_solve_lower_part(&f, nb, w->K0, w->t3);
  memcpy(w->t1, w->K0, sides);
  twx_solve_diagonal_part(&f, nb, w->t1);
  transpose(nx, nb, w->K0, w->t1 + (size_t)nx * (size_t)nb);
  subtract_from_border(w, nx, w->t1 + (size_t)nx * (size_t)nb, nb, w->t1);
  memcpy(w->K0, w->t1, sides);
  twx_solve_upper_part(&f, nb, w->K0, w->t3);
  negate((size_t)nx * (size_t)nb, w->K0);
  return negative;
}

/* The factor C of Z'D^-1 Z - S_ee + softness, of so many negative eigenvalues; -1 where a pivot is rounding: a row
 * depends on others, or nothing moves it. */
static int32_t factorize_equalities(twx_work *w, int32_t negative) {
  const int32_t np = NP_OF(w), ne = w->nbe, nb = NB_OF(w);
  const real least = w->options->pivot;
  const twx_factor f = twx_factor_in(ne, w->C);
  real most = 0;
  for (int32_t j = 0; j < ne; j++)
    for (int32_t i = 0; i < ne; i++)
      f.A[i + (size_t)j * (size_t)ne] =
          (i == j ? w->softness + w->border_softness : 0) - w->S[np + i + (size_t)(np + j) * (size_t)nb];
  memcpy(w->t1, w->Z, sizeof(real) * (size_t)np * (size_t)ne);
  const twx_factor parameters = twx_factor_in(np, w->Lp);
  twx_solve_diagonal_part(&parameters, ne, w->t1);
  twx_add_product_transposed(ne, ne, np, w->Z, np, w->t1, np, f.A, ne);
  for (int32_t i = 0; i < ne; i++) most = twx_max(most, fabs(f.A[i + (size_t)i * (size_t)ne]));
  const int32_t count = twx_factorize_symmetric(&f);
  if (count < 0) return -1;
  for (int32_t i = 0; i < ne && w->border_softness == 0; i++) {
    if (f.block[i] != 1) continue;
    const real pivot = fabs(f.A[i + (size_t)i * (size_t)ne]);
    if (pivot <= least * f.added[i] || f.added[i] <= least * least * most) return -1;
  }
  return count == negative;
}

/* The border: Lp of its parameters, Z = Lp^-1 S_pe, and C of its equalities, after so many negative eigenvalues beyond
 * those of equalities. Rows that depend on each other have no factor: they are softened. Source: [WB] Algorithm IC, IC-2. */
static int32_t factorize_border(twx_work *w, int32_t negative) {
  const int32_t np = NP_OF(w), ne = w->nbe, nb = NB_OF(w);
  const size_t p = w->variables - (size_t)np;
  const twx_factor f = twx_factor_in(np, w->Lp);
  for (int32_t i = 0; i < np; i++) w->S[i + (size_t)i * (size_t)nb] += w->Sv[p + (size_t)i] + w->identity;
  fix(w->free + p, 0, np, nb, w->S, 0, NULL);
  for (int32_t j = 0; j < np; j++) memcpy(f.A + (size_t)j * (size_t)np, w->S + (size_t)j * (size_t)nb, sizeof(real) * (size_t)np);
  const int32_t more = twx_factorize_symmetric(&f);
  if (more < 0) return -1;
  for (int32_t j = 0; j < ne; j++) memcpy(w->Z + (size_t)j * (size_t)np, w->S + (size_t)(np + j) * (size_t)nb, sizeof(real) * (size_t)np);
  twx_solve_lower_part(&f, ne, w->Z, w->t3);
  w->border_softness = 0;
  const int32_t good = factorize_equalities(w, negative + more);
  if (good >= 0) return good;
  w->border_softness = w->softening;
  return factorize_equalities(w, negative + more);
}

/* A stage with what follows, eliminated; as `eliminate`. */
TWX_INLINE int32_t factorize_stage(twx_work *w, int32_t k, const twx_stage *s, int32_t with_hessian) {
  stage_cost(w, s, with_hessian);
  if (k < w->N) add_cost_to_go(w, s, w->stages + k + 1);
  else memset(w->t2, 0, sizeof(real) * (size_t)s->n * (size_t)w->nbe), mirror(s->n, w->t0);
  add_equalities(w, s);
  add_to_border(w, s);
  fix(w->free + s->v + s->nx, s->nx, s->nu, s->n, w->t0, w->nbe, w->t2);
  return eliminate(w, s);
}

/* Factor; 1: the inertia is that of a minimum, 0: it is another one, -1: a block is singular. */
static int32_t factorize_once(twx_work *w, int32_t with_hessian) {
  int32_t negative = 0;
  memset(w->S, 0, sizeof(real) * (size_t)NB_OF(w) * (size_t)NB_OF(w));
  for (int32_t k = w->N; k >= 0; k--) {
    const int32_t more = TWX_AT(w, k, factorize_stage, with_hessian);
    if (more < 0) return -1;
    if ((negative += more) > w->nbe) return 0; /* equalities of the border can take no more */
  }
  const int32_t more = eliminate_start(w);
  if (more < 0) return -1;
  negative += more;
  mirror(NB_OF(w), w->S);
  return factorize_border(w, negative);
}

/* Factor with so many times the identity added to the second derivatives of v and s; whether it is a minimum. */
int32_t twx_factorize(twx_work *w, real identity, int32_t with_hessian) {
  w->identity = identity, w->statistics->factorizations++;
  w->softening = w->options->equality_softness * pow(w->barrier, w->options->equality_softness_power);
  w->local_softness = 0;
  int32_t good = factorize_once(w, with_hessian);
  if (good < 0 && w->nbe < w->ne) w->local_softness = w->softening, good = factorize_once(w, with_hessian);
  return good > 0;
}

/* With squares of the equalities as last time, or the other way: they change no step, but its inertia by stages. */
int32_t twx_factorize_weighted(twx_work *w, real identity) {
  if (twx_factorize(w, identity, 1)) return 1;
  w->weight = w->weight > 0 ? 0 : w->options->equality_weight;
  return w->nbe > 0 && twx_factorize(w, identity, 1);
}

/* Raise the multiple of the identity until the step is one of descent. Source: [WB] Algorithm IC. */
int32_t twx_correct_inertia(twx_work *w) {
  const twx_options *o = w->options;
  if (twx_factorize_weighted(w, 0)) return 1;
  w->weight = o->equality_weight;
  const int32_t first = w->last_identity == 0;
  real identity = first ? o->inertia_first : twx_max(o->inertia_smallest, o->inertia_decrease * w->last_identity);
  w->statistics->inertia_corrections++;
  while (!twx_factorize(w, identity, 1)) {
    identity *= first ? o->inertia_increase_first : o->inertia_increase;
    if (identity > o->inertia_largest) return 0;
  }
  w->last_identity = identity;
  return 1;
}
