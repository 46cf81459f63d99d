/* Products of small column-major matrices. */
#include "work.h"

/* C += A B, with A (m, k), B (k, n). Four columns of A at a time: one pass over a column of C for four multiplications. */
void twx_add_product(int32_t m, int32_t n, int32_t k, const double *restrict A, int32_t la, const double *restrict B,
                     int32_t lb, double *restrict C, int32_t lc) {
  for (int32_t j = 0; j < n; j++) {
    double *restrict c = C + (size_t)j * lc;
    const double *b = B + (size_t)j * lb;
    int32_t l = 0;
    for (; l + 4 <= k; l += 4) {
      const double b0 = b[l], b1 = b[l + 1], b2 = b[l + 2], b3 = b[l + 3];
      const double *restrict a0 = A + (size_t)l * la, *restrict a1 = a0 + la, *restrict a2 = a1 + la, *restrict a3 = a2 + la;
      for (int32_t i = 0; i < m; i++) c[i] += a0[i] * b0 + a1[i] * b1 + a2[i] * b2 + a3[i] * b3;
    }
    for (; l < k; l++) {
      const double *restrict a = A + (size_t)l * la;
      for (int32_t i = 0; i < m; i++) c[i] += a[i] * b[l];
    }
  }
}

/* C += A' B, with A (k, m), B (k, n). */
void twx_add_product_transposed(int32_t m, int32_t n, int32_t k, const double *restrict A, int32_t la,
                                const double *restrict B, int32_t lb, double *restrict C, int32_t lc) {
  for (int32_t j = 0; j < n; j++) {
    const double *restrict b = B + (size_t)j * lb;
    for (int32_t i = 0; i < m; i++) {
      const double *restrict a = A + (size_t)i * la;
      double sum = 0;
      for (int32_t l = 0; l < k; l++) sum += a[l] * b[l];
      C[i + (size_t)j * lc] += sum;
    }
  }
}

void twx_add_apply(int32_t m, int32_t n, const double *restrict A, int32_t la, const double *restrict x, double *restrict y) {
  twx_add_product(m, 1, n, A, la, x, n, y, m);
}

void twx_add_apply_transposed(int32_t m, int32_t n, const double *restrict A, int32_t la, const double *restrict x,
                              double *restrict y) {
  twx_add_product_transposed(n, 1, m, A, la, x, m, y, n);
}
