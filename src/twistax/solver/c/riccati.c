/* The linear system of a step, factored from the last stage to the first.
 *
 * The cost of what follows a node is  x'P x/2 + x'W b + b'S b/2 + x'p + b's  with the border b = (p, ye): parameters
 * that all stages share and multipliers of the equalities. A stage adds its own cost in (x, u, p), then u is eliminated:
 *
 *   M = H + Jh' Sigma Jh + weight Je'Je + F'P F + (W F terms),   L L' = M_uu,   K = -L'^-1 L^-1 [M_ux | M_ub].
 *
 * The equations have the inertia of a minimum exactly if every Cholesky factor exists: of M_uu at every stage, of P for
 * free entries of x_0, of S for the parameters, and of minus what is left of S for the equalities.
 * Source: C. V. Rao, S. J. Wright, J. B. Rawlings, Application of interior-point methods to model predictive control,
 * J. Optim. Theory Appl. 99 (1998), section 3.
 */
#include "work.h"

static double row_weight(const twx_work *w, size_t row) { /* 1 / (1/Sigma + softness) */
  const double sigma = w->Ss[row] + w->identity;
  return sigma / (1 + w->softness * sigma);
}

/* M += J' diag(weights) J of a block of rows (rows, n); the upper triangle. */
static void add_squares(int32_t rows, int32_t n, const double *J, const double *weights, double *scratch, double *M) {
  for (int32_t j = 0; j < n; j++) {
    const double *column = J + (size_t)j * (size_t)rows;
    for (int32_t r = 0; r < rows; r++) scratch[r] = weights[r] * column[r];
    twx_add_product_transposed(j + 1, 1, rows, J, rows, scratch, rows, M + (size_t)j * (size_t)n, n);
  }
}

/* The cost of a stage alone in (x, u, p), in t0 (n, n), its upper triangle. */
static void stage_cost(twx_work *w, const twx_stage *s, int32_t with_hessian) {
  const int32_t n = s->n;
  double *const M = w->t0, *const weights = w->t3, *const scratch = weights + s->nh + s->ne;
  if (with_hessian) memcpy(M, w->H + s->H, sizeof(double) * (size_t)n * (size_t)n);
  else memset(M, 0, sizeof(double) * (size_t)n * (size_t)n);
  for (int32_t i = 0; i < s->nv; i++) M[i + (size_t)i * (size_t)n] += w->Sv[s->v + (size_t)i] + w->identity;
  for (int32_t i = 0; i < s->nh; i++) weights[i] = row_weight(w, s->h + (size_t)i);
  add_squares(s->nh, n, w->Jh + s->Jh, weights, scratch, M);
  for (int32_t i = 0; i < s->ne; i++) weights[i] = w->weight;
  if (w->weight > 0) add_squares(s->ne, n, w->Je + s->Je, weights, scratch, M);
}

/* What follows: t0 += F'P F and its terms with W; t2 (n, ne) = the columns of the equalities' multipliers. */
static void add_cost_to_go(twx_work *w, const twx_stage *s) {
  const twx_stage *next = s + 1;
  const int32_t n = s->n, nx = s->next, nv = s->nv;
  const double *const F = w->F + s->F, *const P = w->P + next->P, *const W = w->W + next->W;
  double *const M = w->t0, *const T = w->t1, *const R = w->t2;
  memset(T, 0, sizeof(double) * (size_t)nx * (size_t)n);
  twx_add_product(nx, n, nx, P, nx, F, nx, T, nx);
  for (int32_t j = 0; j < w->np; j++) /* F'W_p of rows before p; of p itself both orders */
    for (int32_t i = 0; i < nx; i++) T[i + (size_t)(nv + j) * (size_t)nx] += W[i + (size_t)j * (size_t)nx];
  for (int32_t j = 0; j < n; j++)
    twx_add_product_transposed(j + 1, 1, nx, F, nx, T + (size_t)j * (size_t)nx, nx, M + (size_t)j * (size_t)n, n);
  for (int32_t j = 0; j < w->np; j++)
    twx_add_product_transposed(j + 1, 1, nx, W, nx, F + (size_t)(nv + j) * (size_t)nx, nx,
                               M + nv + (size_t)(nv + j) * (size_t)n, n);
  memset(R, 0, sizeof(double) * (size_t)n * (size_t)w->ne);
  twx_add_product_transposed(n, w->ne, nx, F, nx, W + (size_t)w->np * (size_t)nx, nx, R, n);
}

/* The rows of the stage's equalities in the columns of their multipliers. */
static void add_equalities(twx_work *w, const twx_stage *s) {
  for (int32_t r = 0; r < s->ne; r++) {
    double *column = w->t2 + (s->e + (size_t)r) * (size_t)s->n;
    for (int32_t i = 0; i < s->n; i++) column[i] += w->Je[s->Je + (size_t)r + (size_t)i * (size_t)s->ne];
  }
}

static void mirror(int32_t n, double *M) { /* the lower triangle from the upper */
  for (int32_t j = 0; j < n; j++)
    for (int32_t i = 0; i < j; i++) M[j + (size_t)i * (size_t)n] = M[i + (size_t)j * (size_t)n];
}

/* Rows and columns of fixed variables become those of the identity. M (n, n) whole, R (n, columns) or NULL. */
static void fix(const double *free, int32_t first, int32_t count, int32_t n, double *M, int32_t columns, double *R) {
  for (int32_t l = 0; l < count; l++) {
    if (free[l] != 0) continue;
    const int32_t i = first + l;
    for (int32_t j = 0; j < n; j++) M[i + (size_t)j * (size_t)n] = M[j + (size_t)i * (size_t)n] = 0;
    M[i + (size_t)i * (size_t)n] = 1;
    for (int32_t j = 0; j < columns; j++) R[i + (size_t)j * (size_t)n] = 0;
  }
}

/* S of the border, of what M and R have for it: parameters by parameters, by equalities. */
static void add_to_border(twx_work *w, const twx_stage *s) {
  const int32_t np = w->np, nb = w->nb, nv = s->nv, n = s->n;
  for (int32_t j = 0; j < np; j++)
    for (int32_t i = 0; i < np; i++) w->S[i + (size_t)j * (size_t)nb] += w->t0[nv + i + (size_t)(nv + j) * (size_t)n];
  for (int32_t j = 0; j < w->ne; j++)
    for (int32_t i = 0; i < np; i++) {
      const double entry = w->t2[nv + i + (size_t)j * (size_t)n];
      w->S[i + (size_t)(np + j) * (size_t)nb] += entry, w->S[np + j + (size_t)i * (size_t)nb] += entry;
    }
}

/* S -= Y'Y */
static void subtract_squares(twx_work *w, int32_t rows, const double *Y) {
  const int32_t nb = w->nb;
  for (int32_t j = 0; j < nb; j++)
    for (int32_t i = 0; i < nb; i++) {
      double sum = 0;
      for (int32_t l = 0; l < rows; l++) sum += Y[l + (size_t)i * (size_t)rows] * Y[l + (size_t)j * (size_t)rows];
      w->S[i + (size_t)j * (size_t)nb] -= sum;
    }
}

static void negate(size_t count, double *a) {
  for (size_t i = 0; i < count; i++) a[i] = -a[i];
}

/* Eliminate u: L, K and P, W of the stage. 0 where M_uu has no Cholesky factor. */
static int32_t eliminate(twx_work *w, const twx_stage *s) {
  const int32_t nx = s->nx, nu = s->nu, n = s->n, nb = w->nb, np = w->np;
  double *const M = w->t0, *const R = w->t2, *const L = w->L + s->L, *const Y = w->K + s->K;
  double *const P = w->P + s->P, *const W = w->W + s->W;
  for (int32_t j = 0; j < nu; j++) memcpy(L + (size_t)j * (size_t)nu, M + nx + (size_t)(nx + j) * (size_t)n, sizeof(double) * (size_t)nu);
  if (!twx_cholesky(nu, L, nu)) return 0;
  for (int32_t j = 0; j < nx + nb; j++) { /* [M_ux | M_up | R_u] */
    const double *from = j < nx ? M + (size_t)j * (size_t)n
                         : j < nx + np ? M + (size_t)(s->nv + j - nx) * (size_t)n
                                       : R + (size_t)(j - nx - np) * (size_t)n;
    memcpy(Y + (size_t)j * (size_t)nu, from + nx, sizeof(double) * (size_t)nu);
    double *to = j < nx ? P + (size_t)j * (size_t)nx : W + (size_t)(j - nx) * (size_t)nx;
    memcpy(to, from, sizeof(double) * (size_t)nx);
  }
  twx_solve_lower(nu, L, nu, nx + nb, Y, nu);
  for (int32_t j = 0; j < nx + nb; j++) {
    double *to = j < nx ? P + (size_t)j * (size_t)nx : W + (size_t)(j - nx) * (size_t)nx;
    const double *y = Y + (size_t)j * (size_t)nu;
    for (int32_t i = 0; i < (j < nx ? j + 1 : nx); i++) {
      double sum = 0;
      for (int32_t l = 0; l < nu; l++) sum += Y[l + (size_t)i * (size_t)nu] * y[l];
      to[i] -= sum;
    }
  }
  mirror(nx, P);
  subtract_squares(w, nu, Y + (size_t)nx * (size_t)nu);
  twx_solve_lower_transposed(nu, L, nu, nx + nb, Y, nu);
  negate((size_t)nu * (size_t)(nx + nb), Y);
  return 1;
}

/* Eliminate the free entries of x_0. */
static int32_t eliminate_start(twx_work *w) {
  const int32_t nx = w->stages[0].nx, nb = w->nb;
  memcpy(w->L0, w->P, sizeof(double) * (size_t)nx * (size_t)nx);
  memcpy(w->K0, w->W, sizeof(double) * (size_t)nx * (size_t)nb);
  fix(w->free, 0, nx, nx, w->L0, nb, w->K0);
  if (!twx_cholesky(nx, w->L0, nx)) return 0;
  twx_solve_lower(nx, w->L0, nx, nb, w->K0, nx);
  subtract_squares(w, nx, w->K0);
  twx_solve_lower_transposed(nx, w->L0, nx, nb, w->K0, nx);
  negate((size_t)nx * (size_t)nb, w->K0);
  return 1;
}

/* The factor C of Z'Z - S_ee + softness; 0 where a pivot is rounding: a row depends on others, or nothing moves it. */
static int32_t factorize_equalities(twx_work *w) {
  const int32_t np = w->np, ne = w->ne, nb = w->nb;
  const double least = w->options->pivot;
  double *const diagonal = w->t3, most = 0;
  for (int32_t j = 0; j < ne; j++)
    for (int32_t i = 0; i < ne; i++)
      w->C[i + (size_t)j * (size_t)ne] =
          (i == j ? w->softness + w->border_softness : 0) - w->S[np + i + (size_t)(np + j) * (size_t)nb];
  twx_add_product_transposed(ne, ne, np, w->Z, np, w->Z, np, w->C, ne);
  for (int32_t i = 0; i < ne; i++) most = twx_max(most, diagonal[i] = w->C[i + (size_t)i * (size_t)ne]);
  if (!twx_cholesky(ne, w->C, ne)) return 0;
  for (int32_t i = 0; i < ne && w->border_softness == 0; i++) {
    const double pivot = w->C[i + (size_t)i * (size_t)ne] * w->C[i + (size_t)i * (size_t)ne];
    if (pivot <= least * diagonal[i] || diagonal[i] <= least * least * most) return 0;
  }
  return 1;
}

/* The border: Lp of its parameters, Z = Lp^-1 S_pe, and C of its equalities. Those that depend on each other have no
 * factor: they are softened. Source: [WB] Algorithm IC, IC-2. */
static int32_t factorize_border(twx_work *w) {
  const int32_t np = w->np, ne = w->ne, nb = w->nb;
  const size_t p = w->variables - (size_t)np;
  for (int32_t i = 0; i < np; i++) w->S[i + (size_t)i * (size_t)nb] += w->Sv[p + (size_t)i] + w->identity;
  fix(w->free + p, 0, np, nb, w->S, 0, NULL);
  for (int32_t j = 0; j < np; j++) memcpy(w->Lp + (size_t)j * (size_t)np, w->S + (size_t)j * (size_t)nb, sizeof(double) * (size_t)np);
  if (!twx_cholesky(np, w->Lp, np)) return 0;
  for (int32_t j = 0; j < ne; j++) memcpy(w->Z + (size_t)j * (size_t)np, w->S + (size_t)(np + j) * (size_t)nb, sizeof(double) * (size_t)np);
  twx_solve_lower(np, w->Lp, np, ne, w->Z, np);
  w->border_softness = 0;
  if (factorize_equalities(w)) return 1;
  w->border_softness = w->options->equality_softness * pow(w->barrier, w->options->equality_softness_power);
  return factorize_equalities(w);
}

/* Factor with so many times the identity added to the second derivatives of v and s. 0 where it is no minimum. */
int32_t twx_factorize(twx_work *w, double identity, int32_t with_hessian) {
  w->identity = identity, w->statistics->factorizations++;
  memset(w->S, 0, sizeof(double) * (size_t)w->nb * (size_t)w->nb);
  for (int32_t k = w->N; k >= 0; k--) {
    const twx_stage *s = w->stages + k;
    stage_cost(w, s, with_hessian);
    if (k < w->N) add_cost_to_go(w, s);
    else memset(w->t2, 0, sizeof(double) * (size_t)s->n * (size_t)w->ne);
    add_equalities(w, s), mirror(s->n, w->t0);
    add_to_border(w, s);
    fix(w->free + s->v + s->nx, s->nx, s->nu, s->n, w->t0, w->ne, w->t2);
    if (!eliminate(w, s)) return 0;
  }
  return eliminate_start(w) && factorize_border(w);
}

/* With squares of the equalities as last time, or the other way: they change no step, but its inertia by stages. */
int32_t twx_factorize_weighted(twx_work *w, double identity) {
  if (twx_factorize(w, identity, 1)) return 1;
  w->weight = w->weight > 0 ? 0 : w->options->equality_weight;
  return w->ne > 0 && twx_factorize(w, identity, 1);
}

/* Raise the multiple of the identity until the step is one of descent. Source: [WB] Algorithm IC. */
int32_t twx_correct_inertia(twx_work *w) {
  const twx_options *o = w->options;
  if (twx_factorize_weighted(w, 0)) return 1;
  w->weight = o->equality_weight;
  const int32_t first = w->last_identity == 0;
  double identity = first ? o->inertia_first : twx_max(o->inertia_smallest, o->inertia_decrease * w->last_identity);
  w->statistics->inertia_corrections++;
  while (!twx_factorize(w, identity, 1)) {
    identity *= first ? o->inertia_increase_first : o->inertia_increase;
    if (identity > o->inertia_largest) return 0;
  }
  w->last_identity = identity;
  return 1;
}
