/* A matrix of N x N times another one, again and again. Compiled with N defined. */
#include <string.h>

void powers(const double *matrix, double *product, long steps)
{
    double next[N * N];
    for (long k = 0; k < steps; k++) {
        for (int i = 0; i < N; i++)
            for (int j = 0; j < N; j++) {
                double sum = 0.0;
                for (int l = 0; l < N; l++) sum += matrix[N * i + l] * product[N * l + j];
                next[N * i + j] = sum;
            }
        memcpy(product, next, sizeof next);
    }
}
