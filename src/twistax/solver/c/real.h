/* The type of all numbers, with what its precision decides. TWX_SINGLE is defined where programs compute in single
 * precision; functions of the C library are those of the type.
 */
#ifndef TWX_REAL_H
#define TWX_REAL_H
#include <float.h>
#include <stdint.h>
#ifdef TWX_SINGLE
#include <tgmath.h>
typedef float real;
typedef uint32_t twx_bits;           /* a number as a whole number */
#define TWX_EPSILON FLT_EPSILON
#define TWX_LEAST FLT_MIN            /* the least normal number */
#define TWX_LEAST_PRODUCT ((real)1e-20) /* of factors: times the least slack it is normal still */
#else
#include <math.h>
typedef double real;
typedef uint64_t twx_bits;
#define TWX_EPSILON DBL_EPSILON
#define TWX_LEAST DBL_MIN
#define TWX_LEAST_PRODUCT 1e-200
#endif
#endif
