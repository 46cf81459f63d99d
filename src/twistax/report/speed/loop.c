/* What CasADi writes, called for many points and in a loop. Compiled with SOURCE, NAME and the sizes defined. */
#include SOURCE

static void evaluate(const double* a, const double* b, const double* c, double* out)
{
    const double* arguments[SZ_ARG + 1];
    double* results[SZ_RES + 1];
    casadi_int iw[SZ_IW + 1];
    static double w[SZ_W + 1];
    arguments[0] = a;
    arguments[1] = b;
    arguments[2] = c;
    results[0] = out;
    NAME(arguments, results, iw, w, 0);
}

void twistax_batch(long count, const double* a, const double* b, const double* c, double* out)
{
    for (long i = 0; i < count; ++i)
        evaluate(a + i * SIZE_A, b + i * SIZE_B, c + i * SIZE_C, out + i * SIZE_OUT);
}

void twistax_loop(long steps, double tiny, double* a, double* b, double* c, double* out)
{
    for (long i = 0; i < steps; ++i) {
        evaluate(a, b, c, out);
        for (int k = 0; k < SIZE_A && k < SIZE_OUT; ++k) a[k] += tiny * out[k];
        for (int k = 0; k < SIZE_B && k < SIZE_OUT; ++k) b[k] += tiny * out[k];
        for (int k = 0; k < SIZE_C && k < SIZE_OUT; ++k) c[k] += tiny * out[k];
    }
}
