/* Factors A = Q' L D L' Q of symmetric matrices that may be indefinite: Q permutes, D has blocks of one or two rows.
 *
 * Source: J. R. Bunch, L. Kaufman, Some stable methods for calculating inertia and solving symmetric linear systems,
 * Mathematics of Computation 31 (1977), algorithm A.
 */
#include "work.h"

#define ALPHA ((real)0.6403882032022076) /* (1 + sqrt(17)) / 8, which bounds the growth of entries */
#define ROUNDING (45 * TWX_EPSILON)       /* a pivot below this share of what was added up for it */
#define AT(i, j) A[(size_t)(i) + (size_t)(j) * (size_t)n]

twx_factor twx_factor_in(int32_t n, real *memory) {
  const size_t count = (size_t)n;
  real *const tail = memory + count * count;
  return (twx_factor){n, memory, tail, tail + count, tail + 2 * count};
}

size_t twx_factor_size(int32_t n) { return (size_t)n * ((size_t)n + 3); }

static void exchange(real *a, real *b) {
  const real held = *a;
  *a = *b, *b = held;
}

/* Rows and columns a <= b change places, also in the columns of L that are done. */
static void permute(const twx_factor *f, int32_t a, int32_t b) {
  const int32_t n = f->n;
  real *const A = f->A;
  if (a == b) return;
  for (int32_t j = 0; j < a; j++) exchange(&AT(a, j), &AT(b, j));
  for (int32_t i = a + 1; i < b; i++) exchange(&AT(i, a), &AT(b, i));
  for (int32_t i = b + 1; i < n; i++) exchange(&AT(i, a), &AT(i, b));
  exchange(&AT(a, a), &AT(b, b)), exchange(f->row + a, f->row + b), exchange(f->added + a, f->added + b);
}

/* The largest entry of row and column k beside the diagonal, from `first` on. */
static real largest_of(const twx_factor *f, int32_t first, int32_t k, int32_t *place) {
  const int32_t n = f->n;
  const real *const A = f->A;
  real most = 0;
  for (int32_t i = first; i < n; i++) {
    const real entry = i == k ? 0 : fabs(i < k ? AT(k, i) : AT(i, k));
    if (entry > most) most = entry, *place = i;
  }
  return most;
}

/* Rows of the block that is eliminated next, brought to its place. */
static int32_t choose_block(const twx_factor *f, int32_t k) {
  const int32_t n = f->n;
  const real *const A = f->A, here = fabs(AT(k, k));
  int32_t other = k, unused = k;
  const real most = largest_of(f, k, k, &other);
  if (here >= ALPHA * most) return 1;
  const real most_there = largest_of(f, k, other, &unused);
  if (here * most_there >= ALPHA * most * most) return 1;
  if (fabs(AT(other, other)) >= ALPHA * most_there) {
    permute(f, k, other);
    return 1;
  }
  permute(f, k + 1, other);
  return 2;
}

/* Eliminate one row; 0 where its pivot is rounding. */
static int32_t eliminate_one(const twx_factor *f, int32_t k, int32_t *negative) {
  const int32_t n = f->n;
  real *const A = f->A;
  const real pivot = AT(k, k);
  if (!(fabs(pivot) > ROUNDING * f->added[k]) || !isfinite(pivot)) return 0;
  *negative += pivot < 0, f->block[k] = 1;
  for (int32_t j = k + 1; j < n; j++) {
    const real factor = AT(j, k) / pivot;
    if (factor == 0) continue;
    f->added[j] += fabs(factor * AT(j, k));
    for (int32_t i = j; i < n; i++) AT(i, j) -= factor * AT(i, k);
  }
  for (int32_t i = k + 1; i < n; i++) AT(i, k) /= pivot;
  return 1;
}

/* Eliminate two rows; 0 where their determinant is rounding. */
static int32_t eliminate_two(const twx_factor *f, int32_t k, int32_t *negative) {
  const int32_t n = f->n;
  real *const A = f->A;
  const real a = AT(k, k), b = AT(k + 1, k), c = AT(k + 1, k + 1), determinant = a * c - b * b;
  if (!(fabs(determinant) > ROUNDING * (fabs(a * c) + b * b)) || !isfinite(determinant)) return 0;
  *negative += determinant < 0 ? 1 : a < 0 ? 2 : 0;
  f->block[k] = 2, f->block[k + 1] = 0;
  for (int32_t j = k + 2; j < n; j++) {
    const real first = (c * AT(j, k) - b * AT(j, k + 1)) / determinant;
    const real second = (a * AT(j, k + 1) - b * AT(j, k)) / determinant;
    f->added[j] += fabs(first * AT(j, k)) + fabs(second * AT(j, k + 1));
    for (int32_t i = j; i < n; i++) AT(i, j) -= first * AT(i, k) + second * AT(i, k + 1);
    AT(j, k) = first, AT(j, k + 1) = second; /* rows above j of these columns are read no more */
  }
  return 1;
}

/* Of the lower triangle of A in f; the count of negative eigenvalues, or -1 where A is singular to rounding. */
int32_t twx_factorize_symmetric(const twx_factor *f) {
  const int32_t n = f->n;
  const real *const A = f->A;
  int32_t negative = 0;
  for (int32_t i = 0; i < n; i++) f->row[i] = i, f->added[i] = fabs(AT(i, i));
  for (int32_t k = 0; k < n;) {
    const int32_t rows = choose_block(f, k);
    if (rows == 1 ? !eliminate_one(f, k, &negative) : !eliminate_two(f, k, &negative)) return -1;
    k += rows;
  }
  return negative;
}

/* Four columns at a time stand side by side in the scratch: r (n, count). */
#define R(i) (r + (size_t)(i) * (size_t)count)

static inline void solve_lower_columns(const twx_factor *f, int32_t count, real *restrict B, real *restrict r) {
  const int32_t n = f->n;
  const real *restrict const A = f->A;
  for (int32_t i = 0; i < n; i++)
    for (int32_t c = 0; c < count; c++) R(i)[c] = B[(size_t)f->row[i] + (size_t)c * (size_t)n];
  for (int32_t k = 0; k < n; k++)
    for (int32_t i = k + (f->block[k] == 2 ? 2 : 1); i < n; i++)
      for (int32_t c = 0; c < count; c++) R(i)[c] -= AT(i, k) * R(k)[c];
  if (count == 1) memcpy(B, r, sizeof(real) * (size_t)n);
  for (int32_t i = 0; i < n && count > 1; i++)
    for (int32_t c = 0; c < count; c++) B[(size_t)i + (size_t)c * (size_t)n] = R(i)[c];
}

/* B = L^-1 Q B of columns; `scratch` (n, 4) */
void twx_solve_lower_part(const twx_factor *f, int32_t columns, real *B, real *scratch) {
  const size_t n = (size_t)f->n;
  int32_t j = 0;
  for (; j + 4 <= columns; j += 4) solve_lower_columns(f, 4, B + (size_t)j * n, scratch);
  for (; j < columns; j++) solve_lower_columns(f, 1, B + (size_t)j * n, scratch);
}

/* B = D^-1 B */
void twx_solve_diagonal_part(const twx_factor *f, int32_t columns, real *B) {
  const int32_t n = f->n;
  const real *const A = f->A;
  for (int32_t j = 0; j < columns; j++) {
    real *const b = B + (size_t)j * (size_t)n;
    for (int32_t k = 0; k < n; k++) {
      if (f->block[k] == 1) b[k] /= AT(k, k);
      if (f->block[k] != 2) continue;
      const real a = AT(k, k), between = AT(k + 1, k), c = AT(k + 1, k + 1), first = b[k];
      const real determinant = a * c - between * between;
      b[k] = (c * first - between * b[k + 1]) / determinant, b[k + 1] = (a * b[k + 1] - between * first) / determinant;
    }
  }
}

static inline void solve_upper_columns(const twx_factor *f, int32_t count, real *restrict B, real *restrict r) {
  const int32_t n = f->n;
  const real *restrict const A = f->A;
  if (count == 1) memcpy(r, B, sizeof(real) * (size_t)n);
  for (int32_t i = 0; i < n && count > 1; i++)
    for (int32_t c = 0; c < count; c++) R(i)[c] = B[(size_t)i + (size_t)c * (size_t)n];
  for (int32_t k = n - 1; k >= 0; k--)
    for (int32_t i = k + (f->block[k] == 2 ? 2 : 1); i < n; i++)
      for (int32_t c = 0; c < count; c++) R(k)[c] -= AT(i, k) * R(i)[c];
  for (int32_t i = 0; i < n; i++)
    for (int32_t c = 0; c < count; c++) B[(size_t)f->row[i] + (size_t)c * (size_t)n] = R(i)[c];
}
#undef R

/* B = Q' L'^-1 B; `scratch` (n, 4) */
void twx_solve_upper_part(const twx_factor *f, int32_t columns, real *B, real *scratch) {
  const size_t n = (size_t)f->n;
  int32_t j = 0;
  for (; j + 4 <= columns; j += 4) solve_upper_columns(f, 4, B + (size_t)j * n, scratch);
  for (; j < columns; j++) solve_upper_columns(f, 1, B + (size_t)j * n, scratch);
}

/* B = A^-1 B; `scratch` (n, 4) */
void twx_solve_symmetric(const twx_factor *f, int32_t columns, real *B, real *scratch) {
  twx_solve_lower_part(f, columns, B, scratch);
  twx_solve_diagonal_part(f, columns, B);
  twx_solve_upper_part(f, columns, B, scratch);
}
