/* A primal-dual interior point for problems in stages. C99, no allocation, no global state, re-entrant.
 *
 *   minimise    sum over k of l_k(x_k, u_k, p)
 *   subject to  x_(k+1) = f_k(x_k, u_k, p)      k < N
 *               h_k(x_k, u_k, p) <= 0           inequalities
 *               e_k(x_k, u_k, p)  = 0           equalities
 *               lower <= (x_0, u_0, ..., x_N, u_N, p) <= upper
 *
 * States may lie on a manifold. The core then sees tangent steps alone: a node has a point z_k (any representation),
 * `retract` moves it along a step d_k of the tangent space, and the defect c_k = log(z_(k+1)^-1 f(z_k, u_k, p)) is taken
 * in coordinates about the node where the interval ends. The core wants rows whose derivative by d_(k+1) is -1. That of
 * the logarithm is -J_l(c)^-1, the inverse left Jacobian: rows are multiplied by J_l(c), which leaves c itself as it is.
 * Second derivatives are those of log(z_(k+1)^-1 f(z_k, u_k, p)) by (x_k, u_k, p), with the weights J_l(c)' lambda; the
 * mixed ones by d_(k+1) vanish along directions that keep the rows.
 *
 * Matrices are column-major. Blocks of stages follow one another: of variables v = (x_0, u_0, ..., x_N, u_N, p), of
 * points z = (z_0, u_0, ..., z_N, u_N, p), of rows h and e by stages, of defects c_0 ... c_(N-1).
 */
#ifndef TWX_CORE_H
#define TWX_CORE_H
#include <stddef.h>
#include <stdint.h>
#include "real.h"

typedef enum {
  TWX_SOLVED = 0,            /* the scaled error is at most the tolerance; so is the excess of the cost, where measured */
  TWX_MAX_ITERATIONS = 1,
  TWX_INFEASIBLE = 2,        /* a stationary point of the violation */
  TWX_STALLED = 3,           /* the search direction is too small, or the line search fails at a feasible point */
  TWX_NON_FINITE = 4,        /* a function is not finite at the start or where the solver must differentiate it */
  TWX_UNBOUNDED_CURVATURE = 5, /* no multiple of the identity makes the step a descent */
  TWX_STOPPED = 6,           /* `stop` returned other than 0 */
  TWX_BAD_PROBLEM = 7,       /* sizes or bounds that cannot be */
  TWX_UNBOUNDED = 8,         /* the cost falls without end while the constraints hold */
  TWX_ACCEPTABLE = 9         /* errors are acceptable, and did not fall to the tolerance in so many iterations */
} twx_status;

typedef struct { /* weights of a sum of functions, in the problem's units */
  real cost;
  const real *lambda, *y, *ye;
} twx_multipliers;

typedef struct { /* where derivatives are written, as `jacobians` and `hessians` have them; H may be NULL */
  real *gradient, *F, *Jh, *Je, *H;
} twx_derivatives;

/* Functions return 0, or another number where the point must be rejected. Outputs of values, jacobians and hessians are
 * zero before the call; `retract` writes all of `moved`, `transport` changes lambda in place. */
typedef struct {
  int32_t intervals;          /* N */
  int32_t parameters;         /* entries of p, shared by all stages */
  const int32_t *states;      /* (N + 1) entries of x_k, the dimension of its tangent space */
  const int32_t *controls;    /* (N + 1) entries of u_k; of the last stage 0 */
  const int32_t *inequalities; /* (N + 1) rows of h_k */
  const int32_t *equalities;  /* (N + 1) rows of e_k */
  const int32_t *point_states; /* (N + 1) entries of z_k, or NULL where z_k is x_k */
  const int32_t *flat;        /* of v: where z has the entry itself, or -1; NULL: nowhere. Those bounded by 0 are kept equal */
  const real *lower, *upper; /* of v; infinite where there is none; equal where an entry of x_0, u or p is fixed */
  const real *size;         /* of v: units in which the core counts, or NULL for 1 */
  const real *row_size, *equality_size; /* units of the rows h and e, or NULL for 1 */
  real cost_size;           /* unit of the cost */
  const real *largest_step; /* of v: how far a step may move an entry, negative: a share of what it is; NULL: any distance */
  void *user;
  int32_t (*values)(void *user, const real *z, real *cost, real *c, real *h, real *e);
  /* gradient of the cost by v; by (x_k, u_k, p): F_k of c_k (without the -1 of x_(k+1)), rows of h_k and e_k */
  int32_t (*jacobians)(void *user, const real *z, real *gradient, real *F, real *Jh, real *Je);
  /* second derivatives of weight * cost + lambda . c + y . h + ye . e by (x_k, u_k, p) of each stage */
  int32_t (*hessians)(void *user, const real *z, real weight, const real *lambda, const real *y,
                      const real *ye, real *H);
  /* moved = z moved by d, a step of v; NULL where z is v */
  int32_t (*retract)(void *user, const real *z, const real *d, real *moved);
  /* multipliers of c about the node that `retract` moved by d; NULL where they stay */
  int32_t (*transport)(void *user, const real *d, real *lambda);
  int32_t (*stop)(void *user, int32_t iteration, const real *z); /* asked once an iteration; NULL: never */
  /* Both derivatives at once, where that saves work; NULL: `jacobians` and `hessians` are called. */
  int32_t (*derivatives)(void *user, const real *z, const twx_multipliers *weights, const twx_derivatives *result);
  size_t scratch;             /* numbers at the start of the workspace that functions may overwrite while they differentiate */
  int32_t filter_rows;        /* entries of the filter, 0: 400. A solve adds one an iteration at most */
  int32_t without_watchdog;   /* 1: there is no memory for it, which solves of few iterations do not need */
  int32_t discards;           /* 1: a solve whose iterate has no meaning leaves z and the solution as they were */
} twx_problem;

#define OPTION(name, value, source) real name;
typedef struct {
#include "options.def"
} twx_options;
#undef OPTION

typedef struct { /* one iteration */
  real cost, violation, stationarity, barrier, identity, step, step_multipliers, length, trials, kind;
} twx_record;

typedef struct {
  real cost, error, stationarity, violation, complementarity, barrier, cost_scale;
  real minimum;             /* 1: of a solution, the second-order conditions of a minimum hold */
  real excess, worth;       /* estimate of the cost less that of the minimum nearby, NaN where there is none, and what it is
                                 measured by */
  int32_t status, iterations, evaluations, factorizations, corrections, restorations, restoration_iterations,
      filter_resets, inertia_corrections;
  twx_record *log; /* rows for the first `log_rows` iterations, or NULL */
  int32_t log_rows;
} twx_statistics;

/* Numbers of a solution: v | s, slacks of h | lambda | y | ye | zl, zu of the bounds of v. */
typedef struct {
  real *v, *s, *lambda, *y, *ye, *zl, *zu;
} twx_solution;

/* Counts by which arrays are made; 0 where the sizes cannot be. */
typedef struct {
  size_t variables, points, defects, inequalities, equalities, F, Jh, Je, H;
} twx_counts;

int32_t twx_options_count(void);
const char *twx_option_name(int32_t i);
const char *twx_option_source(int32_t i);
void twx_defaults(twx_options *options);
int32_t twx_count(const twx_problem *problem, twx_counts *counts);
/* In numbers of so many bytes, those of a `real` for `twx_solve`; 0 where the sizes cannot be. */
size_t twx_workspace_size(const twx_problem *problem, size_t bytes);

/* Solve from z and v = solution->v. Both hold the result; multipliers are those of the problem as stated, unscaled. */
int32_t twx_solve(const twx_problem *problem, const twx_options *options, real *z, twx_solution *solution,
                  real *workspace, twx_statistics *statistics);

/* A solution, its multipliers, and weights multiplier / slack of bounds (by v) and of inequalities. */
typedef struct {
  const real *z, *lambda, *y, *ye, *bound_weights, *row_weights;
} twx_point;

/* The moves of a solution for `count` right sides v | c | h | e | cost, in place; see linearised.c. Returns TWX_SOLVED,
 * or TWX_UNBOUNDED_CURVATURE where the solution is no strict minimum. */
int32_t twx_linearised(const twx_problem *problem, const twx_options *options, const twx_point *at, int32_t transposed,
                       int32_t count, real *sides, real *workspace);
#endif
