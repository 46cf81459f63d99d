/* Products of small column-major matrices. */
#include "dense.h"

/* C += A B, with A (m, k), B (k, n). Four columns of A at a time: one pass over a column of C for four multiplications. */
void twx_add_product(int32_t m, int32_t n, int32_t k, const real *restrict A, int32_t la, const real *restrict B,
                     int32_t lb, real *restrict C, int32_t lc) {
  for (int32_t j = 0; j < n; j++) {
    real *restrict c = C + (size_t)j * lc;
    const real *b = B + (size_t)j * lb;
    int32_t l = 0;
    for (; l + 4 <= k; l += 4) {
      const real b0 = b[l], b1 = b[l + 1], b2 = b[l + 2], b3 = b[l + 3];
      const real *restrict a0 = A + (size_t)l * la, *restrict a1 = a0 + la, *restrict a2 = a1 + la, *restrict a3 = a2 + la;
      for (int32_t i = 0; i < m; i++) c[i] += a0[i] * b0 + a1[i] * b1 + a2[i] * b2 + a3[i] * b3;
    }
    for (; l < k; l++) {
      const real *restrict a = A + (size_t)l * la;
      for (int32_t i = 0; i < m; i++) c[i] += a[i] * b[l];
    }
  }
}

/* out_i += factor a_i'b for columns a_i of A (k, m); out has a stride. Four sums at a time: one waits for itself. */
void twx_add_dots(int32_t m, int32_t k, real factor, const real *restrict A, int32_t la, const real *restrict b,
                  real *restrict out, int32_t stride) {
  int32_t i = 0;
  for (; i + 4 <= m; i += 4) {
    const real *restrict a0 = A + (size_t)i * la, *restrict a1 = a0 + la, *restrict a2 = a1 + la, *restrict a3 = a2 + la;
    real s0 = 0, s1 = 0, s2 = 0, s3 = 0;
    for (int32_t l = 0; l < k; l++) s0 += a0[l] * b[l], s1 += a1[l] * b[l], s2 += a2[l] * b[l], s3 += a3[l] * b[l];
    real *const to = out + (size_t)i * stride;
    to[0] += factor * s0, to[stride] += factor * s1, to[2 * stride] += factor * s2, to[3 * stride] += factor * s3;
  }
  for (; i < m; i++) {
    const real *restrict a = A + (size_t)i * la;
    real sum = 0;
    for (int32_t l = 0; l < k; l++) sum += a[l] * b[l];
    out[(size_t)i * stride] += factor * sum;
  }
}

static inline void add_rows(int32_t rows, int32_t k, real factor, const real *restrict A, int32_t la,
                            const real *restrict b, real *restrict out) {
  real sums[8] = {0};
  for (int32_t l = 0; l < k; l++)
    for (int32_t i = 0; i < rows; i++) sums[i] += A[i + (size_t)l * la] * b[l];
  for (int32_t i = 0; i < rows; i++) out[i] += factor * sums[i];
}

/* out += factor A b, with A (m, k): the sums of `twx_add_dots`, many rows at a time. */
void twx_add_sums(int32_t m, int32_t k, real factor, const real *A, int32_t la, const real *b, real *out) {
  int32_t i = 0;
  for (; i + 8 <= m; i += 8) add_rows(8, k, factor, A + i, la, b, out + i);
  if (m - i >= 4) add_rows(4, k, factor, A + i, la, b, out + i), i += 4;
  if (m - i >= 2) add_rows(2, k, factor, A + i, la, b, out + i), i += 2;
  if (m - i >= 1) add_rows(1, k, factor, A + i, la, b, out + i);
}

/* C += A' B, with A (k, m), B (k, n). */
void twx_add_product_transposed(int32_t m, int32_t n, int32_t k, const real *A, int32_t la, const real *B, int32_t lb,
                                real *C, int32_t lc) {
  for (int32_t j = 0; j < n; j++) twx_add_dots(m, k, 1, A, la, B + (size_t)j * lb, C + (size_t)j * lc, 1);
}

void twx_add_apply(int32_t m, int32_t n, const real *restrict A, int32_t la, const real *restrict x, real *restrict y) {
  twx_add_product(m, 1, n, A, la, x, n, y, m);
}

void twx_add_apply_transposed(int32_t m, int32_t n, const real *restrict A, int32_t la, const real *restrict x,
                              real *restrict y) {
  twx_add_product_transposed(n, 1, m, A, la, x, m, y, n);
}
