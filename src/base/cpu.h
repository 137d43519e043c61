/* SPDX-License-Identifier: Apache-2.0 */
/* Which instruction sets this machine and its operating system offer. */
#ifndef QL_BASE_CPU_H
#define QL_BASE_CPU_H

#include <stdint.h>

enum {
    QL_CPU_AVX2 = 1u << 0,        /* AVX2, FMA and F16C, with OS state */
    QL_CPU_AVX512 = 1u << 1,      /* F, BW, DQ, VL, with OS state; implies QL_CPU_AVX2 */
    QL_CPU_AVX512_BF16 = 1u << 2, /* implies QL_CPU_AVX512 */
    QL_CPU_NEON = 1u << 3
};

uint32_t ql_cpu_probe(void);

#endif
