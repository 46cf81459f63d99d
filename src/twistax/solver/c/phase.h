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
  const double *starts, *widths; /* of its intervals */
  double *state;                /* how far the memory is filled: 1 integrated, 2 differentiated too */
  double *at;                   /* the point for which it is; both only where the window is the whole phase */
  double *q, *shares;           /* (S + 1 + S s, K, size), (S + 1 + S s, K): ends of substeps, then stages */
  double *slopes;               /* (S s, K, n): of the stages */
  double *shared;               /* (S s, K, functions): elementary functions in the rate of the stages */
  double *J;                    /* (S s, K, n, size): derivatives of the rate by q */
  double *maps;                 /* (places, blocks, n, size, lanes): sensitivities of eta, but for starts, where they are one */
  double *along;                /* of implicit stages (s, blocks, n, size, lanes): sensitivities of their slopes */
  double *H;                    /* (blocks, size, size, lanes): second derivatives, the upper triangle */
  double *lane_rows, *lane_moved; /* scratch: a matrix of a block, and another */
  int32_t *list;                /* (2 size) scratch */
  double *gap_slopes, *turns;   /* (K, n, n), in memory of `row_slopes` and of `lane_rows` */
  double *defects;              /* (K, n) */
  double *adjoint;              /* (K, n): of the end of an interval, then of its substeps' starts */
  double *adjoints, *through;   /* (s, K, n) */
  double *pulls;                /* (points, K, n): gradients by eta of rows and cost, weighted */
  double *rows;                 /* (K, max(path_rows + 1, rows of a node)) */
  double *row_slopes;           /* (K, as many, size) */
  double *bends, *cost_bends;   /* (K, size, size): second derivatives by q; those of the cost at a stage */
  double *moved;                /* scratch: (size, size), and of a join */
  double *map;                  /* (n, size): of an interval */
  double *matrix, *right;       /* of implicit stages: (K, s n, s n), (s n, size) */
  double *weights;              /* (K, as many rows, or n) */
  double *q_node;               /* (n + p) */
} twx_memory;

typedef struct {
  size_t work, scratch; /* doubles */
} twx_phase_sizes;
TWX_INTERNAL twx_phase_sizes twx_lay_out(twx_memory *memory, const twx_phase *phase, double *work, double *scratch);
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
  const double *z, *share, *base, *target, *weights, *shared;
  size_t width, weight_width;
  size_t stage; /* of the first row */
} twx_inputs;
TWX_INTERNAL void twx_call(const twx_kernel *f, const twx_memory *t, twx_inputs in, size_t rows, double *result, size_t size);
/* out (rows, columns) = A (rows, n) B (n, columns) */
TWX_INTERNAL void twx_multiply(size_t rows, size_t n, size_t columns, const double *restrict A, const double *restrict B, double *restrict out);
/* Blocks and rows of stages. */
TWX_INTERNAL double *twx_at_stage(double *array, const int64_t *offsets, size_t k);
TWX_INTERNAL double *twx_row_at(const twx_phase *f, size_t k, int32_t place, double *h, double *e);
TWX_INTERNAL double twx_weight_of(const twx_phase *f, size_t k, int32_t place, const double *y, const double *ye);
TWX_INTERNAL void twx_add_row(const twx_phase *f, size_t k, int32_t place, const double *row, size_t stride, size_t count,
                              size_t skipped, double *Jh, double *Je);
/* lanes.c */
TWX_INTERNAL size_t twx_lanes_of(const twx_memory *t, size_t block); /* intervals of a block */
TWX_INTERNAL void twx_pack(const twx_memory *t, size_t block, size_t stride, size_t width, const double *rows, double *lanes);
TWX_INTERNAL double *twx_maps_at(const twx_memory *t, size_t place, size_t block);
TWX_INTERNAL void twx_lanes_along(const twx_memory *t, size_t rows, const double *M, size_t width, const double *maps, double *out);
TWX_INTERNAL void twx_lanes_bends(const twx_memory *t, const double *M, size_t width, const double *maps, double *H);
TWX_INTERNAL int32_t twx_is_start(const twx_memory *t, size_t place); /* sensitivities there are one */
TWX_INTERNAL void twx_map_of(const twx_memory *t, size_t place, size_t k, double *map);
/* nodes.c */
TWX_INTERNAL double twx_node_values(twx_memory *t, const double *z, double *h, double *e);
TWX_INTERNAL void twx_node_jacobians(twx_memory *t, const double *z, double *gradient, double *Jh, double *Je);
TWX_INTERNAL void twx_node_hessians(twx_memory *t, const double *z, double weight, const double *y, const double *ye, double *H);
TWX_INTERNAL void twx_join_values(const twx_memory *t, const double *z, double *c);
TWX_INTERNAL void twx_join_jacobians(twx_memory *t, const double *z, double *F);
TWX_INTERNAL void twx_join_hessians(twx_memory *t, const double *z, const double *lambda, double *H);
/* M (rows, n + rest) by q along maps (n, size): out = M[:, :n] maps + [0 | M[:, n:]]. */
TWX_INTERNAL void twx_along(size_t rows, size_t n, size_t size, const double *M, const double *maps, double *out);
TWX_INTERNAL int32_t twx_lu(size_t n, double *A, double *pivots);
TWX_INTERNAL void twx_lu_solve(size_t n, const double *A, const double *pivots, size_t columns, double *B);
TWX_INTERNAL void twx_lu_solve_transposed(size_t n, const double *A, const double *pivots, double *b);
TWX_INTERNAL twx_inputs twx_inputs_at(const twx_memory *t, const double *z, size_t place);
TWX_INTERNAL int32_t twx_integrate(twx_memory *t, const double *z);
TWX_INTERNAL int32_t twx_sensitivities(twx_memory *t, const double *z);
TWX_INTERNAL void twx_adjoint_stages(twx_memory *t, size_t substep, double *adjoint);
#endif
