/* What the files of the core share: sizes of stages, the workspace, and their functions by file. */
#ifndef TWX_WORK_H
#define TWX_WORK_H
#include "core.h"
#include "dense.h"

#define TWX_FILTER_ROWS 400 /* unless the problem says it */
#define TWX_LEAST_SLACK twx_max((real)1e-20, TWX_EPSILON * TWX_EPSILON) /* slacks are never smaller: their reciprocals stay finite */

typedef struct { /* where a stage lies in the arrays */
  int32_t nx, nu, nv, n, nh, ne;      /* n = nv + parameters, columns of its derivatives */
  int32_t nl;                         /* equalities that its controls decide: eliminated with them */
  int32_t next;                       /* states of the next stage, 0 at the end */
  uint32_t v, z, c, h, e;             /* c: of the defect that ends this interval */
  uint32_t F, Jh, Je, H;              /* derivatives */
  uint32_t P, W, L, K, k;             /* factors; k: of the step at rest */
  int32_t point_states;
} twx_stage;

typedef struct { /* a primal-dual point, or a step of one */
  real *v, *s, *lambda, *y, *ye, *zl, *zu, *zs;
} twx_iterate;

typedef struct { /* a right side of the linear system: gradients by v and s, residuals of c, h + s and e */
  real *v, *s, *c, *h, *e;
} twx_residual;

typedef struct { /* values at a point */
  real *z, *v, *s, *c, *h, *e, cost;
} twx_values;

typedef struct {
  const twx_problem *problem;
  const twx_options *options;
  twx_statistics *statistics;
  twx_stage *stages;
  int32_t N, np, ne, nbe, nb;         /* ne: all equalities, nbe of the border; nb = np + nbe */
  int32_t *place;                     /* of an equality in the border; -1 - place where its stage eliminates it */
  size_t variables, points, defects, rows, point_size;
  twx_iterate iterate, step, corrected, refinement, watchdog, best;
  twx_values here, trial;
  real *watchdog_z, *best_z, *moved; /* moved: a step in the problem's units */
  real best_error, best_excess;
  twx_residual right, correction, residual;
  real *lower, *upper, *ones, *free; /* of v; free: 1 or 0 */
  const real *size;                  /* the problem's, or the ones */
  real *row_scale, *equality_scale, cost_scale;
  real *gradient, *F, *Jh, *Je, *H;
  real *Sv, *Ss;                    /* barrier's second derivatives of v and s */
  real *P, *W, *L, *K, *L0, *K0, *S, *Lp, *Z, *C; /* factors, see riccati.c */
  real *p, *k, *border, *t0, *t1, *t2, *t3;      /* of a sweep; scratch */
  real *filter;
  int32_t filter_rows, filter_size;
  int32_t has_hessian; /* H is that of the iterate with its multipliers */
  real exactness;  /* factor of the tolerance and of the least barrier, 1 until the excess asks for less */
  int32_t acceptable_age; /* iterations since the first iterate with an acceptable excess; 0: there is none */
  real barrier, fraction, identity, last_identity, violation_small, violation_large, softness, weight;
  real softening, border_softness, local_softness; /* of equalities that depend on each other */
} twx_work;

static inline size_t twx_most(size_t a, size_t b) { return a > b ? a : b; }
static inline int twx_has(real bound) { return isfinite(bound); }
/* Distances from bounds. */
static inline real twx_below(const twx_work *w, const real *v, size_t i) {
  return twx_max(v[i] - w->lower[i], TWX_LEAST_SLACK);
}
static inline real twx_above(const twx_work *w, const real *v, size_t i) {
  return twx_max(w->upper[i] - v[i], TWX_LEAST_SLACK);
}

#define FOR_STAGES(w, k, stage) \
  for (int32_t k = 0; k <= (w)->N; k++) \
    for (const twx_stage *stage = (w)->stages + k; stage; stage = NULL)
/* f(w, k, stage, ...). Where a program solves one problem alone, whose stages but the last and joins have the same sizes,
 * these are constants in a copy of the stage, and loops over them are unrolled. */
#ifdef TWX_STATES
static inline twx_stage twx_sized(const twx_stage *s) {
  twx_stage sized = *s;
  sized.nx = sized.next = TWX_STATES, sized.nu = TWX_CONTROLS;
  sized.nv = TWX_STATES + TWX_CONTROLS, sized.n = TWX_STATES + TWX_CONTROLS + TWX_PARAMETERS;
  if (!TWX_INEQUALITIES) sized.nh = 0;
  if (!TWX_EQUALITIES) sized.ne = sized.nl = 0;
  return sized;
}
#define TWX_AT(w, k, f, ...) \
  ((k) < (w)->N && (w)->stages[k].nu == TWX_CONTROLS ? f(w, k, (const twx_stage[1]){twx_sized((w)->stages + (k))}, __VA_ARGS__) : f(w, k, (w)->stages + (k), __VA_ARGS__))
#define NP_OF(w) ((void)(w), TWX_PARAMETERS)
#define NB_OF(w) (TWX_EQUALITIES ? (w)->nb : TWX_PARAMETERS)
#else
#define NP_OF(w) ((w)->np)
#define NB_OF(w) ((w)->nb)
#define TWX_AT(w, k, f, ...) f(w, k, (w)->stages + (k), __VA_ARGS__)
#endif
#define FOR_FREE(w, i) for (size_t i = 0; i < (w)->variables; i++) if ((w)->free[i] != 0)

/* symmetric.c: a factor in memory of `twx_factor_size` numbers, n (n + 3) of them. */
typedef struct {
  int32_t n;
  real *A, *row, *block, *added; /* block: rows of the block that begins there; added: absolute sums of the diagonal */
} twx_factor;
TWX_SMALL twx_factor twx_factor_in(int32_t n, real *memory);
TWX_INTERNAL size_t twx_factor_size(int32_t n);
TWX_INTERNAL int32_t twx_factorize_symmetric(const twx_factor *factor);
TWX_SMALL void twx_solve_lower_part(const twx_factor *factor, int32_t columns, real *B, real *scratch);
TWX_SMALL void twx_solve_diagonal_part(const twx_factor *factor, int32_t columns, real *B);
TWX_SMALL void twx_solve_upper_part(const twx_factor *factor, int32_t columns, real *B, real *scratch);
TWX_SMALL void twx_solve_symmetric(const twx_factor *factor, int32_t columns, real *B, real *scratch);

/* workspace.c */
TWX_INTERNAL size_t twx_carve(twx_work *w, const twx_problem *problem, real *base);
TWX_INTERNAL void twx_copy_iterate(const twx_work *w, twx_iterate *to, const twx_iterate *from);
TWX_INTERNAL void twx_copy_step(const twx_work *w, twx_iterate *to, const twx_iterate *from);

/* evaluate.c: functions of the problem in the core's units. */
TWX_INTERNAL int32_t twx_evaluate(twx_work *w, twx_values *at);
TWX_INTERNAL void twx_take_values(twx_work *w);
TWX_INTERNAL int32_t twx_differentiate(twx_work *w);
TWX_INTERNAL int32_t twx_differentiate_both(twx_work *w);
TWX_INTERNAL int32_t twx_differentiate_twice(twx_work *w);
TWX_INTERNAL int32_t twx_move(twx_work *w, const twx_iterate *step, real length);

/* equalities.c: which of them stand in the border. */
TWX_INTERNAL void twx_place_equalities(twx_work *w);

/* riccati.c, sweep.c: the linear system of a step. */
TWX_INTERNAL int32_t twx_factorize(twx_work *w, real identity, int32_t with_hessian);
TWX_INTERNAL int32_t twx_factorize_weighted(twx_work *w, real identity);
TWX_INTERNAL int32_t twx_correct_inertia(twx_work *w);
TWX_INTERNAL void twx_product(twx_work *w, const twx_residual *r, const twx_iterate *d, twx_residual *left, int32_t with_hessian);
TWX_INTERNAL void twx_solve_system(twx_work *w, const twx_residual *right, twx_iterate *step, int32_t with_hessian);

/* measures.c */
typedef struct {
  real error, stationarity, violation, complementarity, dual_scale, bound_scale;
} twx_measures;
TWX_INTERNAL real twx_violation(const twx_work *w, const twx_values *at, int32_t largest);
TWX_INTERNAL real twx_barrier_of_bounds(const twx_work *w, const twx_values *at, real barrier);
TWX_INTERNAL real twx_barrier(const twx_work *w, const twx_values *at);
TWX_INTERNAL twx_measures twx_measure(twx_work *w);
TWX_INTERNAL twx_measures twx_measure_again(const twx_work *w, const twx_measures *m, real barrier);

/* optimum.c */
TWX_INTERNAL int32_t twx_measure_optimum(twx_work *w);

/* start.c */
TWX_INTERNAL int32_t twx_read_problem(twx_work *w);
TWX_INTERNAL twx_status twx_start(twx_work *w);
TWX_INTERNAL void twx_least_squares_multipliers(twx_work *w);

/* direction.c: right side, steps of multipliers, lengths that stay inside. */
TWX_INTERNAL void twx_right_side(twx_work *w, real barrier);
TWX_INTERNAL void twx_step_of_bounds(twx_work *w, twx_iterate *step);
TWX_INTERNAL real twx_primal_length(const twx_work *w, const twx_iterate *step);
TWX_INTERNAL real twx_dual_length(const twx_work *w, const twx_iterate *step);
TWX_INTERNAL real twx_slope(const twx_work *w, const twx_iterate *step);

/* filter.c */
typedef struct { /* where a line search begins */
  real violation, barrier, slope, length;
  int32_t by_filter; /* the last trial was rejected by the filter alone */
} twx_reference;
TWX_INTERNAL int32_t twx_at_most(real a, real b, real base);
TWX_INTERNAL int32_t twx_filter_accepts(const twx_work *w, real violation, real barrier);
TWX_INTERNAL void twx_filter_add(twx_work *w, real violation, real barrier);
TWX_INTERNAL int32_t twx_switches(const twx_work *w, const twx_reference *from, real length);
TWX_INTERNAL int32_t twx_descends(const twx_work *w, const twx_reference *from, real length, real barrier);
TWX_INTERNAL int32_t twx_accepts(const twx_work *w, twx_reference *from, real length);
TWX_INTERNAL real twx_smallest_length(const twx_work *w, const twx_reference *from);

/* line_search.c */
typedef struct {
  int32_t tiny, shortened, watching, watch_left, by_filter, resets, trials;
  char kind;
  real length, length_multipliers;
  twx_reference watched;
} twx_search;
typedef enum { TWX_STEP, TWX_NO_STEP, TWX_BACK } twx_outcome;
TWX_INTERNAL twx_outcome twx_line_search(twx_work *w, twx_search *search);
TWX_INTERNAL void twx_accept(twx_work *w, real length, real length_multipliers, real barrier);

/* restoration.c */
TWX_INTERNAL twx_status twx_restore(twx_work *w);
#endif
