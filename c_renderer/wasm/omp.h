/* Where there is one thread, as in WebAssembly: what frame/ asks of OpenMP. */
#ifndef PENUMBRA_OMP_H
#define PENUMBRA_OMP_H

static inline int omp_get_thread_num(void)
{
    return 0;
}

#endif
