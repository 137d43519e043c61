/* SPDX-License-Identifier: Apache-2.0 */
/* Asks the processor and the operating system what may be used. CPUID alone is not enough: an operating system (or a
 * hypervisor) that does not save the wide registers makes their use a fault, and says so in XCR0. */
#include "base/cpu.h"

#if defined(__x86_64__)
#include <cpuid.h>

/* Intel SDM volume 1, table 13-1: SSE 1, AVX 2, opmask 5, upper halves of ZMM0-15 6, ZMM16-31 7. */
#define XCR0_AVX 0x06u
#define XCR0_AVX512 0xe6u

static uint32_t read_xcr0(void)
{
    uint32_t low, high;
    __asm__ volatile("xgetbv" : "=a"(low), "=d"(high) : "c"(0));
    (void)high;
    return low;
}

static int has_all(uint32_t value, uint32_t bits)
{
    return (value & bits) == bits;
}

/* Bit numbers: Intel SDM volume 2, CPUID. */
static uint32_t probe_x86(void)
{
    uint32_t a, b, c, d;
    if (!__get_cpuid(1, &a, &b, &c, &d)) return 0;
    const uint32_t fma = 1u << 12, osxsave = 1u << 27, avx = 1u << 28, f16c = 1u << 29;
    if (!has_all(c, fma | osxsave | avx | f16c)) return 0;

    const uint32_t xcr0 = read_xcr0();
    if (!has_all(xcr0, XCR0_AVX)) return 0;

    if (!__get_cpuid_count(7, 0, &a, &b, &c, &d)) return 0;
    const uint32_t max_subleaf = a;
    const uint32_t avx2 = 1u << 5;
    if (!has_all(b, avx2)) return 0;
    uint32_t bits = QL_CPU_AVX2;

    const uint32_t f = 1u << 16, dq = 1u << 17, bw = 1u << 30, vl = 1u << 31;
    if (!has_all(b, f | dq | bw | vl) || !has_all(xcr0, XCR0_AVX512)) return bits;
    bits |= QL_CPU_AVX512;

    const uint32_t bf16 = 1u << 5;
    if (max_subleaf >= 1 && __get_cpuid_count(7, 1, &a, &b, &c, &d) && has_all(a, bf16)) bits |= QL_CPU_AVX512_BF16;
    return bits;
}
#endif

uint32_t ql_cpu_probe(void)
{
#if defined(__x86_64__)
    return probe_x86();
#elif defined(__aarch64__)
    return QL_CPU_NEON; /* part of the base architecture */
#else
    return 0;
#endif
}
