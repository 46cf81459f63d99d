/* Weighted least squares within linear constraints, for differential controllers: a quadratic program of qp.h.
 *
 *   minimise    sum_i w_i (J_i x - r_i)^2 / 2 + damping |x|^2 / 2
 *   subject to  A x = b,   row_lower <= C x <= row_upper,   lower <= x <= upper
 *
 * The problem is one array, matrices row by row:
 *
 *   J (rows, n), w (rows), r (rows), damping, A (equalities, n), b, C (inequalities, n), row_lower, row_upper,
 *   lower (n), upper (n), start
 *
 * and the result is x (n), multipliers y, z, w (n) of the constraints, scales, 1 where these are a warm start, then the
 * status, the error and the iterations. Its entries up to and with the 1 are the start of the next problem; zeros are
 * no start. Where the status is not SOLVED, x is zero: never NaN.
 */
#ifndef TWX_SQUARES_H
#define TWX_SQUARES_H
#include "qp.h"

typedef struct { int32_t variables, rows, equalities, inequalities; } twx_squares;

size_t twx_squares_problem(const twx_squares *sizes);   /* doubles of a problem */
size_t twx_squares_start(const twx_squares *sizes);     /* doubles of a start */
size_t twx_squares_result(const twx_squares *sizes);    /* doubles of a result */
size_t twx_squares_workspace(const twx_squares *sizes); /* doubles; 0 where the sizes cannot be */
int32_t twx_squares_solve(const twx_squares *sizes, const double *problem, double *result, double *workspace);
#endif
