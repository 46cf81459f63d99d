/* A dense convex quadratic program, for controllers. C99, no allocation, no global state, re-entrant.
 *
 *   minimise    x'H x / 2 + g'x
 *   subject to  A x = b,   row_lower <= C x <= row_upper,   lower <= x <= upper
 *
 * H is symmetric and positive semidefinite. Bounds may be infinite, or equal. Multipliers y, z, w satisfy
 *
 *   H x + g + A'y + C'z + w = 0,
 *
 * where z and w are at least 0 at upper bounds, at most 0 at lower bounds, and 0 between them.
 *
 * Two methods share one factorization. A solve without a warm start is a primal-dual interior point with Mehrotra's
 * predictor and corrector, which needs a number of steps that depends little on the problem. When the bounds that it
 * approaches stay the same for two steps, the equations with these bounds active are solved: where the result satisfies
 * the optimality conditions, the solve ends. A warm start begins with the bounds that were active, and changes them
 * where the conditions fail; after a few changes it becomes an interior point.
 *
 * Where it finds no solution, two other programs with the same matrices may prove that there is none, and there are
 * two last attempts: see qp_proof.c.
 *
 * Matrices are column-major. The work is bounded: at most `iterations` steps for each of these five programs, and a few
 * factorizations for each step.
 */
#ifndef TWX_QP_H
#define TWX_QP_H
#include <stddef.h>
#include <stdint.h>

typedef enum {
  TWX_QP_SOLVED = 0,         /* the scaled error is at most the tolerance */
  TWX_QP_MAX_ITERATIONS = 1,
  TWX_QP_INFEASIBLE = 2,     /* no x satisfies the constraints; y, z, w prove it, and x violates the rows least */
  TWX_QP_UNBOUNDED = 3,      /* x is a direction along which the cost falls without end */
  TWX_QP_STALLED = 4,        /* steps became too short, by rounding */
  TWX_QP_NOT_CONVEX = 5,     /* H has a negative eigenvalue */
  TWX_QP_BAD_PROBLEM = 6     /* sizes that cannot be, data that are not finite, H not symmetric, a lower bound
                                above its upper one: nothing is written */
} twx_qp_status;

typedef struct {
  int32_t variables, equalities, inequalities;
  const double *H, *g;                /* (n, n), symmetric; (n) */
  const double *A, *b;                /* (equalities, n), (equalities) */
  const double *C, *row_lower, *row_upper; /* (inequalities, n), (inequalities) */
  const double *lower, *upper;        /* (n); NULL where no variable has such a bound */
} twx_qp;

#define OPTION(name, value, source) double name;
typedef struct {
#include "qp.def"
} twx_qp_options;
#undef OPTION

/* In: of a warm start. Out: in the problem's units. */
typedef struct {
  double *x, *y, *z, *w;              /* (n), (equalities), (inequalities), (n) */
  double *scales;                     /* (n + equalities + inequalities): units of variables, reciprocal ones of rows */
} twx_qp_solution;

typedef struct {
  double cost;
  double error;                       /* largest of the next three, relative, independent of units; see qp_measure.c */
  double stationarity, violation, complementarity;
  double certificate;                 /* of INFEASIBLE, UNBOUNDED: how far from exact it is; else infinite */
  int32_t status;
  int32_t iterations;                 /* of the interior point */
  int32_t changes;                    /* of the set of active bounds, all attempts together */
  int32_t factorizations;
} twx_qp_statistics;

int32_t twx_qp_options_count(void);
const char *twx_qp_option_name(int32_t i);
const char *twx_qp_option_source(int32_t i);
void twx_qp_defaults(twx_qp_options *options);
size_t twx_qp_workspace_size(const twx_qp *problem); /* in doubles; 0 where the sizes cannot be */
int32_t twx_qp_solve(const twx_qp *problem, const twx_qp_options *options, twx_qp_solution *solution,
                     double *workspace, twx_qp_statistics *statistics);
#endif
