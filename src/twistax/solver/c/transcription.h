/* Stage functions of optimal control: phases whose intervals are integrated by Runge-Kutta methods on manifolds.
 *
 * Interval k of a phase is integrated in exponential coordinates eta about its first node, x = x_k Exp(eta), over shares
 * of the phase's duration: eta' = rate(q, share, x_k, data) with q = (eta, u_k, p). It gives
 *
 *   c_k = log(x_(k+1)^-1 x_k Exp(eta_end)),  rows of path constraints at the ends of its substeps, and its running cost.
 *
 * First derivatives are sensitivities of the stages by q. Second derivatives follow from their adjoints: each stage adds
 * G' M G, with M the second derivative of the rate weighted by its adjoint and G its sensitivity.
 *
 * For solvers that know no manifolds nodes are steps d_k in charts at points that stay: eta begins at d_k, the defect is
 * c_k - d_(k+1) as it is, and all derivatives are by d_k, exact at any step.
 *
 * The functions rate, point, gap and so on are kernels: machine code for batches of rows. A phase calls each with a row
 * for every interval. Arrays of kernels are row-major, blocks of the core are column-major.
 */
#ifndef TWX_TRANSCRIPTION_H
#define TWX_TRANSCRIPTION_H
#include "core.h"

/* What kernels read: q, or (eta, p); the share of the duration; points of nodes; numbers of the problem; numbers of the
 * kernel; weights; the numbers of a node; those of the phase; elementary functions that values and derivatives share. */
typedef enum {
  TWX_Z, TWX_SHARE, TWX_BASE, TWX_TARGET, TWX_DATA, TWX_NUMBERS, TWX_WEIGHTS, TWX_ROW, TWX_PHASE,
  TWX_SHARED, TWX_ARGUMENTS
} twx_argument;

typedef struct { /* rows of the arrays in a table, from first to end; NULL: the result is zero */
  void (*run)(const int64_t *table, int64_t first, int64_t end);
  int32_t reads, argument[TWX_ARGUMENTS];
  const real *numbers; /* that stay: problems that differ in these alone share machine code */
} twx_kernel;

typedef struct { /* a vector with its first derivative, and the second of a weighted sum */
  twx_kernel value, slopes, bends, shared; /* shared: elementary functions that the others read; of the rate alone */
  int32_t rows, shared_width;
} twx_smooth;

/* Where a row stands: number of an inequality of its stage, or -1: nowhere, or -2 - number of an equality. */
typedef struct { /* conditions on one node of (eta, p) */
  twx_smooth function;
  int32_t stage;
  const int32_t *place;
  const real *margins;
} twx_node;

typedef struct { /* where the next phase starts: log(x_next^-1 jump(x_last, p)), zero in entries that are free */
  twx_smooth function;          /* of (eta, p) at the last node; its target is the first node of the next phase */
  twx_kernel turn;              /* as of the next phase */
  int32_t free_count;
  const int32_t *free;          /* entries of the next start that nothing decides: controls of the join are its steps */
} twx_join;

typedef struct { /* offsets by stage, K + 1 each */
  const int64_t *z, *v, *c, *h, *e, *F, *Jh, *Je, *H;
  const int32_t *inequalities, *equalities;
} twx_offsets;

typedef struct {
  int32_t n, m, p, point, intervals, substeps, stages, implicit, path_rows, nodes, iterations;
  real close;                 /* implicit methods: relative size of a Newton step after which one more is the last */
  int64_t parameters_z, parameters_v; /* where p stands in points and in variables */
  const real *a, *b, *c;      /* of the method; a is row-major */
  const real *weights;        /* of the running cost, of a unit interval: of the ends of substeps, then of all stages */
  const real *starts, *widths; /* of the intervals, shares of the duration */
  const real *data;
  const real *of_phase;       /* numbers of this phase within data: its ends and the limits of its duration */
  const real *node_rows;      /* (intervals + 1, node_width) numbers of the nodes */
  int32_t node_width;
  const int32_t *place;         /* of path rows: (intervals, substeps + 1, path_rows) */
  const real *margins;        /* by which path rows are tightened, the same */
  const real *steps;          /* (K + 1, n): nodes are these steps from their points, in the charts there; NULL: zero */
  twx_offsets at;
  twx_smooth rate, rows, gap;   /* rows: path constraints, then the density of the running cost */
  twx_kernel retract, turn;     /* turn: the left Jacobian of a defect, where the manifold is not flat */
  const twx_node *node;         /* the last one is the end, with the final cost as its last row */
  const twx_join *join;         /* to the next phase, or NULL */
  int32_t window;               /* intervals that are evaluated together, or 0: all, and sensitivities are kept */
  real *cost_slopes;          /* (intervals + 1, p): what each stage adds to the gradient of the cost by p, of the last jacobians */
  real *work, *scratch;       /* scratch: of derivatives; where not all intervals are evaluated together nothing in it is kept */
} twx_phase;

typedef struct {
  int32_t phases;
  twx_phase *phase;
} twx_transcription;

size_t twx_phase_work(const twx_phase *f); /* numbers */
size_t twx_phase_scratch(const twx_phase *f);
/* Functions for `twx_problem`; user is a twx_transcription. */
int32_t twx_transcribed_values(void *user, const real *z, real *cost, real *c, real *h, real *e);
int32_t twx_transcribed_jacobians(void *user, const real *z, real *gradient, real *F, real *Jh, real *Je);
int32_t twx_transcribed_hessians(void *user, const real *z, real weight, const real *lambda, const real *y,
                                 const real *ye, real *H);
/* eta where a substep of the last integrated point ends, of all intervals of a phase: (K, n). */
void twx_phase_states(const twx_phase *f, int32_t substep, real *eta);
int32_t twx_transcribed_retract(void *user, const real *z, const real *d, real *moved);
#endif
