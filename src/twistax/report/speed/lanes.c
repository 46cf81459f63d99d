/* What CasADi writes, with a vector of LANES points for each number, called for many points by THREADS threads.
   Compiled with SOURCE, NAME and the sizes defined. Sines and the like of vectors are those of glibc's libmvec. */
#include <math.h>

typedef double lanes_real __attribute__((vector_size(8 * LANES)));
#define casadi_real lanes_real

#define ENTRYWISE(name)                                                                                               \
    __attribute__((simd("notinbranch"))) double name(double);                                                         \
    static inline lanes_real lanes_##name(lanes_real x)                                                               \
    {                                                                                                                 \
        lanes_real y;                                                                                                 \
        _Pragma("omp simd") for (int k = 0; k < LANES; ++k) y[k] = name(x[k]);                                        \
        return y;                                                                                                     \
    }
ENTRYWISE(sin)
ENTRYWISE(cos)
#define sin lanes_sin
#define cos lanes_cos
#include SOURCE

/* Entries of the rows i to i + LANES - 1; the last row again where there are fewer. */
static inline void load(lanes_real* x, const double* a, int size, long count, long i)
{
    for (int k = 0; k < size; ++k)
        for (int lane = 0; lane < LANES; ++lane) x[k][lane] = a[(i + lane < count ? i + lane : count - 1) * size + k];
}

void twistax_batch(long count, const double* a, const double* b, const double* c, double* out)
{
#pragma omp parallel for num_threads(THREADS)
    for (long i = 0; i < count; i += LANES) {
        lanes_real u[SIZE_A], v[SIZE_B], w[SIZE_C], y[SIZE_OUT], work[SZ_W + 1];
        const lanes_real* arguments[SZ_ARG + 1] = {u, v, w};
        lanes_real* results[SZ_RES + 1] = {y};
        casadi_int iw[SZ_IW + 1];
        load(u, a, SIZE_A, count, i);
        load(v, b, SIZE_B, count, i);
        load(w, c, SIZE_C, count, i);
        NAME(arguments, results, iw, work, 0);
        for (int lane = 0; lane < LANES && i + lane < count; ++lane)
            for (int k = 0; k < SIZE_OUT; ++k) out[(i + lane) * SIZE_OUT + k] = y[k][lane];
    }
}
