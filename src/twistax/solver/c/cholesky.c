/* Cholesky factors and their triangular solves, for the dense quadratic program. */
#include "qp_work.h"

/* The lower Cholesky factor in place; 0 where a pivot is not positive beyond rounding. The upper part is left alone. */
int32_t twx_cholesky(int32_t n, double *A, int32_t la) {
  for (int32_t j = 0; j < n; j++) {
    double *a = A + (size_t)j * la;
    double pivot = a[j];
    const double before = fabs(pivot);
    for (int32_t l = 0; l < j; l++) pivot -= A[j + (size_t)l * la] * A[j + (size_t)l * la];
    if (!(pivot > 1e-14 * before) || !isfinite(pivot)) return 0;
    pivot = sqrt(pivot);
    a[j] = pivot;
    for (int32_t l = 0; l < j; l++) {
      const double *restrict left = A + (size_t)l * la;
      const double factor = left[j];
      for (int32_t i = j + 1; i < n; i++) a[i] -= factor * left[i];
    }
    for (int32_t i = j + 1; i < n; i++) a[i] /= pivot;
  }
  return 1;
}

/* B = L^-1 B */
void twx_solve_lower(int32_t n, const double *L, int32_t ll, int32_t columns, double *B, int32_t lb) {
  for (int32_t j = 0; j < columns; j++) {
    double *restrict b = B + (size_t)j * lb;
    for (int32_t i = 0; i < n; i++) {
      const double *restrict column = L + (size_t)i * ll;
      b[i] /= column[i];
      for (int32_t l = i + 1; l < n; l++) b[l] -= column[l] * b[i];
    }
  }
}

/* B = L'^-1 B */
void twx_solve_lower_transposed(int32_t n, const double *L, int32_t ll, int32_t columns, double *B, int32_t lb) {
  for (int32_t j = 0; j < columns; j++) {
    double *restrict b = B + (size_t)j * lb;
    for (int32_t i = n - 1; i >= 0; i--) {
      const double *restrict column = L + (size_t)i * ll;
      double sum = b[i];
      for (int32_t l = i + 1; l < n; l++) sum -= column[l] * b[l];
      b[i] = sum / column[i];
    }
  }
}
