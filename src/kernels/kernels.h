/* SPDX-License-Identifier: Apache-2.0 */
/* The table of hot loops, filled once for the machine and then constant. */
#ifndef QL_KERNELS_KERNELS_H
#define QL_KERNELS_KERNELS_H

#include <stdint.h>

typedef struct ql_kernels {
    const char *name; /* "c", "avx2", "avx512", "neon" */
} ql_kernels;

void ql_kernels_init(ql_kernels *kernels, uint32_t cpu); /* cpu: QL_CPU_* bits that may be used */

#endif
