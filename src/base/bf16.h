/* SPDX-License-Identifier: Apache-2.0 */
/* bfloat16, the upper half of a float, as processors compute with it: rounded to nearest even, and numbers below 2^-126
 * are zero. The plain twins of the SIMD converters. */
#ifndef QL_BASE_BF16_H
#define QL_BASE_BF16_H

#include <stdint.h>
#include <string.h>

static inline float ql_bf16_to_float(uint16_t value)
{
    const uint32_t bits = (uint32_t)value << 16;
    float out;
    memcpy(&out, &bits, sizeof out);
    return out;
}

/* Infinities stay, NaN stays NaN; what rounds beyond the largest number becomes infinite. */
static inline uint16_t ql_bf16_from_float(float value)
{
    uint32_t bits;
    memcpy(&bits, &value, sizeof bits);
    const uint32_t magnitude = bits & 0x7fffffffu;
    if (magnitude > 0x7f800000u) return (uint16_t)(bits >> 16 | 0x40u); /* quiet */
    if (magnitude < 0x00800000u) return (uint16_t)(bits >> 16 & 0x8000u);
    return (uint16_t)((bits + 0x7fffu + (bits >> 16 & 1u)) >> 16);
}

#endif
