/* Weighted least squares within linear constraints as a quadratic program: H = J'w J + damping, g = -J'w r. */
#include "squares.h"
#include "qp_work.h"

size_t twx_squares_start(const twx_squares *s) {
  return 3 * (size_t)s->variables + 2 * ((size_t)s->equalities + (size_t)s->inequalities) + 1;
}

size_t twx_squares_result(const twx_squares *s) { return twx_squares_start(s) + 3; }

size_t twx_squares_problem(const twx_squares *s) {
  const size_t n = (size_t)s->variables, m = (size_t)s->rows, e = (size_t)s->equalities, i = (size_t)s->inequalities;
  return m * (n + 2) + 1 + e * (n + 1) + i * (n + 2) + 2 * n + twx_squares_start(s);
}

size_t twx_squares_workspace(const twx_squares *s) {
  const twx_qp sizes = {.variables = s->variables, .equalities = s->equalities, .inequalities = s->inequalities};
  const size_t n = (size_t)s->variables, work = s->rows < 0 ? 0 : twx_qp_workspace_size(&sizes);
  return work ? work + n * (n + 1 + (size_t)s->equalities + (size_t)s->inequalities) : 0;
}

/* Rows of zeros cost little: of a task most columns are zero. */
static void squares_cost(int32_t n, int32_t rows, const double *J, const double *weight, const double *r, double damping,
                         double *H, double *g) {
  memset(H, 0, sizeof(double) * (size_t)n * (size_t)n), memset(g, 0, sizeof(double) * (size_t)n);
  for (int32_t i = 0; i < rows; i++) {
    const double *restrict row = J + (size_t)i * (size_t)n;
    for (int32_t k = 0; k < n; k++) {
      const double weighted = weight[i] * row[k];
      if (weighted == 0) continue;
      double *restrict column = H + (size_t)k * (size_t)n;
      for (int32_t j = 0; j <= k; j++) column[j] += weighted * row[j];
      g[k] -= weighted * r[i];
    }
  }
  for (int32_t k = 0; k < n; k++) {
    H[k + (size_t)k * (size_t)n] += damping;
    for (int32_t j = 0; j < k; j++) H[k + (size_t)j * (size_t)n] = H[j + (size_t)k * (size_t)n];
  }
}

static void squares_transpose(int32_t rows, int32_t n, const double *from, double *to) {
  for (int32_t i = 0; i < rows; i++)
    for (int32_t j = 0; j < n; j++) to[i + (size_t)j * (size_t)rows] = from[j + (size_t)i * (size_t)n];
}

static const double *squares_take(const double **at, size_t count) {
  const double *const first = *at;
  *at += count;
  return first;
}

int32_t twx_squares_solve(const twx_squares *s, const double *problem, double *result, double *workspace) {
  const int32_t n = s->variables, e = s->equalities, c = s->inequalities;
  const size_t N = (size_t)n, m = (size_t)s->rows, ne = (size_t)e, nc = (size_t)c, size = twx_squares_start(s);
  double *const H = workspace, *const g = H + N * N, *const A = g + N, *const C = A + ne * N, *const work = C + nc * N;
  const double *at = problem;
  const double *const J = squares_take(&at, m * N), *const weight = squares_take(&at, m), *const r = squares_take(&at, m);
  squares_cost(n, s->rows, J, weight, r, *squares_take(&at, 1), H, g);
  squares_transpose(e, n, squares_take(&at, ne * N), A);
  twx_qp qp = {.variables = n, .equalities = e, .inequalities = c, .H = H, .g = g, .A = A, .C = C};
  qp.b = squares_take(&at, ne);
  squares_transpose(c, n, squares_take(&at, nc * N), C);
  qp.row_lower = squares_take(&at, nc), qp.row_upper = squares_take(&at, nc);
  qp.lower = squares_take(&at, N), qp.upper = squares_take(&at, N);
  memcpy(result, at, sizeof(double) * size);
  twx_qp_options options;
  twx_qp_statistics statistics;
  twx_qp_defaults(&options);
  options.warm_start = result[size - 1] == 1 ? 1 : 0;
  twx_qp_solution solution = {.x = result, .y = result + N};
  solution.z = solution.y + ne, solution.w = solution.z + nc, solution.scales = solution.w + N;
  int32_t status = twx_qp_solve(&qp, &options, &solution, work, &statistics);
  if (status != TWX_QP_SOLVED && options.warm_start > 0) { /* a start is a guess, its scales too */
    options.warm_start = 0;
    status = twx_qp_solve(&qp, &options, &solution, work, &statistics);
  }
  const int32_t solved = status == TWX_QP_SOLVED;
  if (!solved) memset(result, 0, sizeof(double) * size);
  result[size - 1] = solved, result[size] = status;
  result[size + 1] = statistics.error, result[size + 2] = statistics.iterations;
  return status;
}
