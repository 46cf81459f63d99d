/* What the files of the quadratic program share.
 *
 * All constraints are one list: the n bounds of variables, then the rows of A and of C, in G. With t = (x, G x), they
 * are lower <= t <= upper; an equality has equal bounds. Where rows are soft, t = G x - soft z: the cost then has
 * |t - G x|^2 / (2 soft). Data are in the solver's units: x = D x', rows times E, the cost times `cost_scale`.
 */
#ifndef TWX_QP_WORK_H
#define TWX_QP_WORK_H
#include "dense.h"
#include "qp.h"

typedef struct { /* a point and what is computed from it */
  double *x, *z;          /* (n), (constraints): multipliers, positive at upper bounds */
  double *t, *Hx, *Gz;    /* (constraints), (n), (n): t, H x, G' of the multipliers of rows */
  double *residual;       /* (n): H x + g + G'z + z of the variables */
  double X, Z;            /* sizes of primal and of dual quantities */
  double error, stationarity, violation, complementarity;
} twx_qp_point;

typedef enum { TWX_QP_FREE, TWX_QP_BOUNDED, TWX_QP_FIXED } twx_qp_kind;

typedef struct {
  const twx_qp *problem;
  const twx_qp_options *options;
  twx_qp_statistics *statistics;
  int32_t n, m, k;        /* variables, rows, constraints = n + m */
  double *D, *E, cost_scale;
  double *H, *g, *G, *Gt; /* (n, n), (n), (m, n), (n, m) */
  double *lower, *upper;  /* (constraints) */
  int32_t *kind, *active, *tried; /* (constraints): twx_qp_kind; -1, 0, 1: at the lower bound, between, at the upper */
  double first_gradient;  /* |H x| at the start of an interior point: at a solution of cost 0 all else vanishes */
  double softness;        /* of constraints in the linear system, see qp_newton.c */
  int32_t proving;        /* no longer the problem as stated, but one whose solution shows why that has none */
  double soft;            /* of rows: 0, or 1 in the search for the least violation */
  double *M, *weights;    /* (n, n): the factor; (constraints) */
  twx_qp_point point, trial, best;
  double *v, *sl, *su, *zl, *zu; /* of the interior point: t strictly inside of its bounds; slacks; their multipliers */
  double *dx, *dt, *dz, *dv, *dzl, *dzu, *dz0, *r; /* a step and its right side */
  double *scratch;        /* (max(n, m)) */
} twx_qp_work;

/* qp_scale.c */
TWX_INTERNAL size_t twx_qp_carve(twx_qp_work *w, const twx_qp *problem, double *base);
TWX_INTERNAL int32_t twx_qp_load(twx_qp_work *w, const twx_qp_solution *solution);
TWX_INTERNAL void twx_qp_reload(twx_qp_work *w);
TWX_INTERNAL void twx_qp_unload(const twx_qp_work *w, twx_qp_solution *solution);

/* qp_measure.c */
TWX_INTERNAL void twx_qp_measure(const twx_qp_work *w, twx_qp_point *at);
TWX_INTERNAL void twx_qp_copy(const twx_qp_work *w, twx_qp_point *to, const twx_qp_point *from); /* x and z */
TWX_INTERNAL double twx_qp_infeasible(twx_qp_work *w, const twx_qp_point *at);
TWX_INTERNAL double twx_qp_unbounded(const twx_qp_work *w, const twx_qp_point *at);

/* qp_newton.c */
TWX_INTERNAL int32_t twx_qp_factorize(twx_qp_work *w, double identity);
TWX_INTERNAL int32_t twx_qp_factorize_regularized(twx_qp_work *w);
TWX_INTERNAL double twx_qp_softness(const twx_qp_work *w, int32_t i);
TWX_INTERNAL void twx_qp_step(twx_qp_work *w, const twx_qp_point *at);

/* qp_active.c, qp_interior.c */
TWX_INTERNAL void twx_qp_guess(const twx_qp_work *w, const twx_qp_point *at, const double *t, int32_t *active);
TWX_INTERNAL int32_t twx_qp_active_set(twx_qp_work *w, int32_t changes);
TWX_INTERNAL twx_qp_status twx_qp_interior(twx_qp_work *w);

/* qp_proof.c */
TWX_INTERNAL twx_qp_status twx_qp_prove(twx_qp_work *w, twx_qp_status status);

/* cholesky.c */
TWX_INTERNAL int32_t twx_cholesky(int32_t n, double *A, int32_t la);
TWX_INTERNAL void twx_solve_lower(int32_t n, const double *L, int32_t ll, int32_t columns, double *B, int32_t lb);
TWX_INTERNAL void twx_solve_lower_transposed(int32_t n, const double *L, int32_t ll, int32_t columns, double *B, int32_t lb);
#endif
