/* SPDX-License-Identifier: Apache-2.0 */
/* Chooses kernels for the machine: from slowest to fastest, so that each slot always holds a valid function. */
#include "kernels/kernels.h"

#include "base/cpu.h"

void ql_kernels_init(ql_kernels *kernels, uint32_t cpu)
{
    ql_kernels_init_c(kernels);
#if defined(__x86_64__) || defined(_M_X64)
    if (cpu & QL_CPU_AVX2) ql_kernels_init_avx2(kernels);
    if (cpu & QL_CPU_AVX512) ql_kernels_init_avx512(kernels);
    if (cpu & QL_CPU_AVX512_BF16) ql_kernels_init_avx512bf16(kernels);
#elif defined(__aarch64__)
    if (cpu & QL_CPU_NEON) ql_kernels_init_neon(kernels);
#else
    (void)cpu;
#endif
}
