/* What this processor can do at most: float32 multiply-adds and divisions a second.
 *
 * usage: fma-peak THREADS
 *
 * Prints JSON: {"threads", "fma_per_second", "divisions_per_second"}, of all threads together, each
 * the median of many repeats, as for frames, so that what slows those slows this alike. Exit status:
 * 1 if the arithmetic was not done, 2 usage. */
#include <stdbool.h>
#include <stdio.h>
#include <stdlib.h>

#include <omp.h>

enum {
    LANES = 16,    /* as in the renderer's packets */
    CHAINS = 12,   /* that do not wait for each other: more than latency times pipes, and with
                      the two constants they fit 16 registers, should there be no more */
    STEPS = 60001, /* odd: see expected */
    REPEATS = 101
};

#define FOR_EACH_CHAIN(DO) DO(0) DO(1) DO(2) DO(3) DO(4) DO(5) DO(6) DO(7) DO(8) DO(9) DO(10) DO(11)
#define LOAD(K) float c##K = x[K][i];
#define STORE(K) x[K][i] = c##K;
#define MULTIPLY_ADD(K) c##K = c##K * a + b;
#define DIVIDE(K) c##K = a / c##K;

/* Variables, not an array, so that each chain stays in its register. */
#define CHAIN_LOOP(NAME, STEP)                                                                     \
    static void NAME(float a, float b, float x[CHAINS][LANES])                                     \
    {                                                                                              \
        (void)b;                                                                                   \
        _Pragma("omp simd simdlen(16)") for (int i = 0; i < LANES; i++)                            \
        {                                                                                          \
            FOR_EACH_CHAIN(LOAD)                                                                   \
            for (int step = 0; step < STEPS; step++) {                                             \
                FOR_EACH_CHAIN(STEP)                                                               \
            }                                                                                      \
            FOR_EACH_CHAIN(STORE)                                                                  \
        }                                                                                          \
    }
CHAIN_LOOP(multiply_add_chains, MULTIPLY_ADD)
CHAIN_LOOP(divide_chains, DIVIDE)

typedef struct {
    void (*run)(float a, float b, float x[CHAINS][LANES]);
    float a, b; /* read from here: the compiler must not know them */
} Operation;

static float start_value(int chain, int lane)
{
    return 1.0f / (float)(1 << (chain + lane) % 8);
}

/* With a = -1, b = 1 a step takes x to 1 - x, with a = 1/2 a division takes x to 1/(2x): exact
 * for these values, and undone by the next step. An odd number of steps is one step. */
static float expected(const Operation *operation, float x)
{
    return operation->b != 0 ? x * operation->a + operation->b : operation->a / x;
}

static bool run_once(const volatile Operation *given, double *seconds, int threads)
{
    const Operation operation = {given->run, given->a, given->b};
    int wrong = 0;
    double start = 0, end = 0;
#pragma omp parallel num_threads(threads) reduction(+ : wrong)
    {
        float x[CHAINS][LANES];
        for (int k = 0; k < CHAINS; k++)
            for (int i = 0; i < LANES; i++)
                x[k][i] = start_value(k, i);
#pragma omp barrier
#pragma omp master
        start = omp_get_wtime();
        operation.run(operation.a, operation.b, x);
#pragma omp barrier
#pragma omp master
        end = omp_get_wtime();
        for (int k = 0; k < CHAINS; k++)
            for (int i = 0; i < LANES; i++)
                wrong += x[k][i] != expected(&operation, start_value(k, i));
    }
    *seconds = end - start;
    return wrong == 0;
}

static int compare_numbers(const void *a, const void *b)
{
    double x = *(const double *)a, y = *(const double *)b;
    return (x > y) - (x < y);
}

/* Operations a second; 0 if they were not done. */
static double peak(volatile Operation operation, int threads)
{
    double seconds[REPEATS];
    for (int repeat = 0; repeat < REPEATS; repeat++)
        if (!run_once(&operation, &seconds[repeat], threads))
            return 0;
    qsort(seconds, REPEATS, sizeof *seconds, compare_numbers);
    return (double)CHAINS * LANES * STEPS * threads / seconds[REPEATS / 2];
}

int main(int argc, char **argv)
{
    int threads = argc == 2 ? atoi(argv[1]) : 0;
    if (threads < 1 || threads > 1024) {
        fputs("usage: fma-peak THREADS\n", stderr);
        return 2;
    }
    double fma = peak((Operation){multiply_add_chains, -1, 1}, threads);
    double divisions = peak((Operation){divide_chains, 0.5f, 0}, threads);
    printf("{\"threads\": %d, \"fma_per_second\": %.6g, \"divisions_per_second\": %.6g}\n", threads,
           fma, divisions);
    return fma > 0 && divisions > 0 ? 0 : 1;
}
