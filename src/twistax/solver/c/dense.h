/* Products of small column-major matrices, and what else all files of the core read. */
#ifndef TWX_DENSE_H
#define TWX_DENSE_H
#include <stddef.h>
#include <stdint.h>
#include <string.h>
#include "real.h"

#ifndef TWX_INTERNAL /* `static` where all files are one */
#define TWX_INTERNAL extern
#endif

/* Small functions: inlined where sizes are constants. */
#if defined(TWX_STATES) && defined(__GNUC__)
#define TWX_INLINE static inline __attribute__((always_inline))
#define TWX_SMALL static inline __attribute__((always_inline))
#else
#define TWX_INLINE static inline
#define TWX_SMALL TWX_INTERNAL
#endif

static inline real twx_max(real a, real b) { return a > b ? a : b; } /* b where a is not a number */
static inline real twx_min(real a, real b) { return a < b ? a : b; }

/* dense.c: C += A B, C += A' B, y += A x, y += A' x. */
TWX_SMALL void twx_add_product(int32_t m, int32_t n, int32_t k, const real *A, int32_t la, const real *B, int32_t lb, real *C, int32_t lc);
TWX_SMALL void twx_add_product_transposed(int32_t m, int32_t n, int32_t k, const real *A, int32_t la, const real *B, int32_t lb, real *C, int32_t lc);
TWX_SMALL void twx_add_dots(int32_t m, int32_t k, real factor, const real *A, int32_t la, const real *b, real *out, int32_t stride);
TWX_SMALL void twx_add_sums(int32_t m, int32_t k, real factor, const real *A, int32_t la, const real *b, real *out);
TWX_SMALL void twx_add_apply(int32_t m, int32_t n, const real *A, int32_t la, const real *x, real *y);
TWX_SMALL void twx_add_apply_transposed(int32_t m, int32_t n, const real *A, int32_t la, const real *x, real *y);
#endif
