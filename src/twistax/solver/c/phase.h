/* What the files of a transcription share: memory of a phase, and its functions by file. */
#ifndef TWX_PHASE_H
#define TWX_PHASE_H
#include "transcription.h"
#include "work.h"

#define TWX_LANES 4 /* intervals side by side: a vector or two of any processor */

typedef struct { /* arrays of a window of a phase: K intervals, S substeps, s stages; size = n + m + p */
  const twx_phase *phase;
  size_t first, K, n, size, stages, points, blocks; /* first: interval of the window; stages: S s; points: S + 1 + S s;
                                                       blocks: of TWX_LANES intervals */
  const real *starts, *widths; /* of its intervals */
  real *state;                /* how far the memory is filled: 1 integrated, 2 differentiated too */
  real *at;                   /* the point for which it is; both only where the window is the whole phase */
  real *q, *shares;           /* (S + 1 + S s, K, size), (S + 1 + S s, K): ends of substeps, then stages */
  real *slopes;               /* (S s, K, n): of the stages */
  real *shared;               /* (S s, K, functions): elementary functions in the rate of the stages */
  real *J;                    /* (S s, K, n, size): derivatives of the rate by q */
  real *maps;                 /* (places, blocks, n, size, lanes): sensitivities of eta, but for starts, where they are one */
  real *along;                /* of implicit stages (s, blocks, n, size, lanes): sensitivities of their slopes */
  real *H;                    /* (blocks, size, size, lanes): second derivatives, the upper triangle */
  real *lane_rows, *lane_moved; /* scratch: a matrix of a block, and another */
  int32_t *list;                /* (2 size) scratch */
  real *gap_slopes, *turns;   /* (K, n, n), in memory of `row_slopes` and of `lane_rows` */
  real *defects;              /* (K, n) */
  real *adjoint;              /* (K, n): of the end of an interval, then of its substeps' starts */
  real *adjoints, *through;   /* (s, K, n) */
  real *pulls;                /* (points, K, n): gradients by eta of rows and cost, weighted */
  real *rows;                 /* (K, max(path_rows + 1, rows of a node)) */
  real *row_slopes;           /* (K, as many, size) */
  real *bends, *cost_bends;   /* (K, size, size): second derivatives by q; those of the cost at a stage */
  real *moved;                /* scratch: (size, size), and of a join */
  real *map;                  /* (n, size): of an interval */
  real *matrix, *right;       /* of implicit stages: (K, s n, s n), (s n, size) */
  real *weights;              /* (K, as many rows, or n) */
  real *q_node;               /* (n + p) */
} twx_memory;

typedef struct {
  size_t work, scratch; /* numbers */
} twx_phase_sizes;
TWX_INTERNAL twx_phase_sizes twx_lay_out(twx_memory *memory, const twx_phase *phase, real *work, real *scratch);
TWX_INTERNAL size_t twx_window_of(const twx_phase *phase); /* intervals that are evaluated together */
TWX_INTERNAL int32_t twx_is_kept(const twx_phase *phase);
TWX_INTERNAL void twx_open_window(twx_memory *memory, size_t first);
/* Sizes of a phase, constants where a program solves one problem alone. */
#ifdef TWX_STATES
#define N_OF(t) ((void)(t), (size_t)TWX_STATES)
#define SIZE_OF(t) ((void)(t), (size_t)TWX_STATES + TWX_CONTROLS + TWX_PARAMETERS)
#define M_OF(f) ((void)(f), (size_t)TWX_CONTROLS)
#define P_OF(f) ((void)(f), (size_t)TWX_PARAMETERS)
#define STAGES_OF(f) ((void)(f), (size_t)TWX_STAGES)
#else
#define N_OF(t) ((t)->n)
#define SIZE_OF(t) ((t)->size)
#define M_OF(f) ((size_t)(f)->m)
#define P_OF(f) ((size_t)(f)->p)
#define STAGES_OF(f) ((size_t)(f)->stages)
#endif
#define FOR_WINDOWS(t) \
  for (size_t begin = 0; begin < (size_t)(t).phase->intervals && (twx_open_window(&(t), begin), 1); begin += twx_window_of((t).phase))
typedef struct { /* what a kernel reads: rows of `width` and `weight_width` numbers; target NULL: the node after base */
  const real *z, *share, *base, *target, *weights, *shared;
  size_t width, weight_width;
  size_t stage; /* of the first row */
} twx_inputs;
TWX_INTERNAL void twx_call(const twx_kernel *f, const twx_memory *t, twx_inputs in, size_t rows, real *result, size_t size);
/* out (rows, columns) = A (rows, n) B (n, columns) */
TWX_INTERNAL void twx_multiply(size_t rows, size_t n, size_t columns, const real *restrict A, const real *restrict B, real *restrict out);
/* Blocks and rows of stages. */
TWX_INTERNAL real *twx_at_stage(real *array, const int64_t *offsets, size_t k);
TWX_INTERNAL real *twx_row_at(const twx_phase *f, size_t k, int32_t place, real *h, real *e);
TWX_INTERNAL real twx_weight_of(const twx_phase *f, size_t k, int32_t place, const real *y, const real *ye);
TWX_INTERNAL void twx_add_row(const twx_phase *f, size_t k, int32_t place, const real *row, size_t stride, size_t count,
                              size_t skipped, real *Jh, real *Je);
/* lanes.c */
TWX_INTERNAL size_t twx_lanes_of(const twx_memory *t, size_t block); /* intervals of a block */
TWX_INTERNAL void twx_pack(const twx_memory *t, size_t block, size_t stride, size_t width, const real *rows, real *lanes);
TWX_INTERNAL real *twx_maps_at(const twx_memory *t, size_t place, size_t block);
TWX_INTERNAL void twx_lanes_along(const twx_memory *t, size_t rows, const real *M, size_t width, const real *maps, real *out);
TWX_INTERNAL void twx_lanes_bends(const twx_memory *t, const real *M, size_t width, const real *maps, real *H);
TWX_INTERNAL int32_t twx_is_start(const twx_memory *t, size_t place); /* sensitivities there are one */
TWX_INTERNAL void twx_map_of(const twx_memory *t, size_t place, size_t k, real *map);
/* nodes.c */
TWX_INTERNAL real twx_node_values(twx_memory *t, const real *z, real *h, real *e);
TWX_INTERNAL void twx_node_jacobians(twx_memory *t, const real *z, real *gradient, real *Jh, real *Je);
TWX_INTERNAL void twx_node_hessians(twx_memory *t, const real *z, real weight, const real *y, const real *ye, real *H);
TWX_INTERNAL void twx_join_values(const twx_memory *t, const real *z, real *c);
TWX_INTERNAL void twx_join_jacobians(twx_memory *t, const real *z, real *F);
TWX_INTERNAL void twx_join_hessians(twx_memory *t, const real *z, const real *lambda, real *H);
/* M (rows, n + rest) by q along maps (n, size): out = M[:, :n] maps + [0 | M[:, n:]]. */
TWX_INTERNAL void twx_along(size_t rows, size_t n, size_t size, const real *M, const real *maps, real *out);
TWX_INTERNAL int32_t twx_lu(size_t n, real *A, real *pivots);
TWX_INTERNAL void twx_lu_solve(size_t n, const real *A, const real *pivots, size_t columns, real *B);
TWX_INTERNAL void twx_lu_solve_transposed(size_t n, const real *A, const real *pivots, real *b);
TWX_INTERNAL twx_inputs twx_inputs_at(const twx_memory *t, const real *z, size_t place);
TWX_INTERNAL int32_t twx_integrate(twx_memory *t, const real *z);
TWX_INTERNAL int32_t twx_sensitivities(twx_memory *t, const real *z);
TWX_INTERNAL void twx_adjoint_stages(twx_memory *t, size_t substep, real *adjoint);
#endif
