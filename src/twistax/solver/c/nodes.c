/* Conditions at single nodes, the final cost among them, and joins between phases. */
#include "phase.h"

/* ---- conditions at nodes -------------------------------------------------------------------------------------- */

/* What the conditions at a node read: (eta, p) with eta the node's step, the share of the node, its point. */
static twx_inputs node_inputs(const twx_memory *t, const real *z, const twx_node *node, real *share) {
  const twx_phase *f = t->phase;
  const size_t k = (size_t)node->stage;
  for (size_t i = 0; i < t->n; i++) t->q_node[i] = f->steps ? f->steps[k * t->n + i] : 0;
  memcpy(t->q_node + t->n, z + f->parameters_z, sizeof(real) * (size_t)f->p);
  *share = k < (size_t)f->intervals ? f->starts[k] : f->starts[k - 1] + f->widths[k - 1];
  return (twx_inputs){.z = t->q_node, .width = t->n + (size_t)f->p, .share = share, .base = z + f->at.z[k],
                      .weights = t->weights, .weight_width = (size_t)node->function.rows, .stage = k};
}

/* Controls of a stage: those of the last one are of the join. */
static size_t controls_at(const twx_phase *f, size_t k) {
  return k < (size_t)f->intervals ? (size_t)f->m : f->join ? (size_t)f->join->free_count : 0;
}

static int32_t has_cost(const twx_phase *f, int32_t node) { return node == f->nodes - 1; }

real twx_node_values(twx_memory *t, const real *z, real *h, real *e) {
  const twx_phase *f = t->phase;
  real share, cost = 0;
  for (int32_t i = 0; i < f->nodes; i++) {
    const twx_node *node = f->node + i;
    const int32_t rows = node->function.rows - has_cost(f, i);
    twx_call(&node->function.value, t, node_inputs(t, z, node, &share), 1, t->rows, (size_t)node->function.rows);
    for (int32_t r = 0; r < rows; r++) {
      real *to = twx_row_at(f, (size_t)node->stage, node->place[r], h, e);
      if (to) *to = t->rows[r] + node->margins[r];
    }
    if (has_cost(f, i)) cost = t->rows[rows];
  }
  return cost;
}

void twx_node_jacobians(twx_memory *t, const real *z, real *gradient, real *Jh, real *Je) {
  const twx_phase *f = t->phase;
  real share;
  for (int32_t i = 0; i < f->nodes; i++) {
    const twx_node *node = f->node + i;
    const size_t k = (size_t)node->stage, n = t->n, columns = n + (size_t)f->p;
    const int32_t rows = node->function.rows - has_cost(f, i);
    twx_call(&node->function.slopes, t, node_inputs(t, z, node, &share), 1, t->row_slopes, (size_t)node->function.rows * columns);
    for (int32_t r = 0; r < rows; r++)
      twx_add_row(f, k, node->place[r], t->row_slopes + (size_t)r * columns, 1, columns, controls_at(f, k), Jh, Je);
    for (size_t j = n; has_cost(f, i) && j < columns; j++)
      f->cost_slopes[(size_t)f->intervals * (columns - n) + j - n] = t->row_slopes[(size_t)rows * columns + j];
    for (size_t j = 0; has_cost(f, i) && j < columns; j++)
      gradient[j < n ? (size_t)f->at.v[k] + j : (size_t)f->parameters_v + j - n] += t->row_slopes[(size_t)rows * columns + j];
  }
}

/* Adds second derivatives by (eta, p) of a node. */
static void add_node_bends(const twx_phase *f, size_t k, const real *bends, real *H) {
  const size_t n = (size_t)f->n, columns = n + (size_t)f->p, skipped = controls_at(f, k);
  real *const block = twx_at_stage(H, f->at.H, k);
  for (size_t r = 0; r < columns; r++)
    for (size_t j = 0; j < columns; j++)
      block[(r < n ? r : r + skipped) * (columns + skipped) + (j < n ? j : j + skipped)] += bends[r * columns + j];
}

void twx_node_hessians(twx_memory *t, const real *z, real weight, const real *y, const real *ye, real *H) {
  const twx_phase *f = t->phase;
  real share;
  for (int32_t i = 0; i < f->nodes; i++) {
    const twx_node *node = f->node + i;
    const size_t k = (size_t)node->stage, n = t->n, columns = n + (size_t)f->p;
    const int32_t rows = node->function.rows - has_cost(f, i);
    if (!node->function.bends.run) continue;
    for (int32_t r = 0; r < rows; r++) t->weights[r] = twx_weight_of(f, k, node->place[r], y, ye);
    if (has_cost(f, i)) t->weights[rows] = weight;
    twx_call(&node->function.bends, t, node_inputs(t, z, node, &share), 1, t->bends, columns * columns);
    add_node_bends(f, k, t->bends, H);
  }
}

/* ---- joins ---------------------------------------------------------------------------------------------------- */

/* The first node of the next phase follows the last one of this, and the controls of the join. */
static twx_inputs join_inputs(const twx_memory *t, const real *z) {
  const twx_phase *f = t->phase;
  const twx_node last = {.stage = f->intervals};
  real share;
  twx_inputs in = node_inputs(t, z, &last, &share);
  in.share = NULL, in.target = in.base + f->point + f->join->free_count, in.weight_width = (size_t)f->join->function.rows;
  return in;
}

void twx_join_values(const twx_memory *t, const real *z, real *c) {
  const twx_phase *f = t->phase;
  const twx_join *join = f->join;
  real *const gap = twx_at_stage(c, f->at.c, (size_t)f->intervals);
  twx_call(&join->function.value, t, join_inputs(t, z), 1, gap, (size_t)join->function.rows);
  for (int32_t i = 0; f[1].steps && i < join->function.rows; i++) gap[i] -= f[1].steps[i];
  for (int32_t i = 0; i < join->free_count; i++) gap[join->free[i]] = z[f->at.z[f->intervals] + f->point + i];
}

/* The left Jacobian of the join's defect, and where rows are not multiplied by it 0. */
static int32_t join_turn(twx_memory *t, const real *z, real *turn) {
  const twx_join *join = t->phase->join;
  const size_t rows = (size_t)join->function.rows;
  if (!join->turn.run || t->phase[1].steps) return 0;
  twx_call(&join->function.value, t, join_inputs(t, z), 1, t->rows, rows);
  twx_call(&join->turn, t, (twx_inputs){.z = t->rows, .width = rows}, 1, turn, rows * rows);
  return 1;
}

void twx_join_jacobians(twx_memory *t, const real *z, real *F) {
  const twx_phase *f = t->phase;
  const twx_join *join = f->join;
  const size_t rows = (size_t)join->function.rows, n = t->n, columns = n + (size_t)f->p, skipped = (size_t)join->free_count;
  real *slopes = t->row_slopes, *const turn = t->moved, *const turned = t->moved + rows * rows;
  real *const to = twx_at_stage(F, f->at.F, (size_t)f->intervals);
  twx_call(&join->function.slopes, t, join_inputs(t, z), 1, slopes, rows * columns);
  if (join_turn(t, z, turn)) twx_multiply(rows, rows, columns, turn, slopes, turned), slopes = turned;
  for (size_t j = 0; j < columns; j++)
    for (size_t i = 0; i < rows; i++) to[(j < n ? j : j + skipped) * rows + i] = slopes[i * columns + j];
  for (int32_t i = 0; i < join->free_count; i++) to[(n + (size_t)i) * rows + (size_t)join->free[i]] = 1;
}

void twx_join_hessians(twx_memory *t, const real *z, const real *lambda, real *H) {
  const twx_phase *f = t->phase;
  const size_t rows = (size_t)f->join->function.rows, columns = t->n + (size_t)f->p;
  const real *const own = lambda + f->at.c[f->intervals];
  if (!f->join->function.bends.run) return;
  memcpy(t->weights, own, sizeof(real) * rows);
  if (join_turn(t, z, t->moved)) twx_multiply(1, rows, rows, own, t->moved, t->weights);
  twx_call(&f->join->function.bends, t, join_inputs(t, z), 1, t->bends, columns * columns);
  add_node_bends(f, (size_t)f->intervals, t->bends, H);
}
