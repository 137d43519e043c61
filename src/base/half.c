/* SPDX-License-Identifier: Apache-2.0 */
/* Half floats by integer arithmetic alone, so that neither compiler flags nor the rounding mode change a bit. The
 * results equal F16C's and NEON's: NaN becomes quiet and keeps the upper bits of its payload. */
#include "base/half.h"

#include <string.h>

#define HALF_MAX 0x7bffu /* 65504 */
#define HALF_INF 0x7c00u

static uint32_t bits_of(float value)
{
    uint32_t bits;
    memcpy(&bits, &value, sizeof bits);
    return bits;
}

static float float_of(uint32_t bits)
{
    float value;
    memcpy(&value, &bits, sizeof value);
    return value;
}

/* value >> shift, rounded to nearest even; shift 1 to 31. */
static uint32_t shift_right_even(uint32_t value, uint32_t shift)
{
    const uint32_t kept = value >> shift;
    const uint32_t rest = value & ((1u << shift) - 1u);
    const uint32_t tie = 1u << (shift - 1u);
    return kept + (rest > tie || (rest == tie && (kept & 1u)) ? 1u : 0u);
}

float ql_half_to_float(uint16_t half)
{
    const uint32_t sign = ((uint32_t)half & 0x8000u) << 16;
    const uint32_t exponent = ((uint32_t)half >> 10) & 0x1fu;
    uint32_t mantissa = (uint32_t)half & 0x3ffu;

    if (exponent == 0x1fu) {
        const uint32_t quiet = mantissa ? 0x400000u : 0u;
        return float_of(sign | 0x7f800000u | quiet | (mantissa << 13));
    }
    if (exponent != 0) return float_of(sign | ((exponent + 112u) << 23) | (mantissa << 13)); /* 112 = 127 - 15 */
    if (mantissa == 0) return float_of(sign);

    /* Subnormal: mantissa * 2^-24; move its leading one to bit 10. */
    uint32_t biased = 113u;
    while (!(mantissa & 0x400u)) {
        mantissa <<= 1;
        biased--;
    }
    return float_of(sign | (biased << 23) | ((mantissa & 0x3ffu) << 13));
}

uint16_t ql_half_from_float(float value)
{
    const uint32_t bits = bits_of(value);
    const uint32_t sign = (bits >> 16) & 0x8000u;
    const uint32_t magnitude = bits & 0x7fffffffu;

    if (magnitude > 0x7f800000u) return (uint16_t)(sign | HALF_INF | 0x200u | ((magnitude >> 13) & 0x3ffu));
    if (magnitude == 0x7f800000u) return (uint16_t)(sign | HALF_INF);
    if (magnitude >= 0x477ff000u) return (uint16_t)(sign | HALF_MAX); /* 65520 and up would round to infinity */
    if (magnitude < 0x33000000u) return (uint16_t)sign;               /* below 2^-25, half the smallest subnormal */

    const uint32_t exponent = magnitude >> 23;
    if (exponent < 113u) { /* below 2^-14: subnormal */
        const uint32_t mantissa = (magnitude & 0x7fffffu) | 0x800000u;
        return (uint16_t)(sign | shift_right_even(mantissa, 126u - exponent));
    }
    /* A carry out of the mantissa moves into the exponent, as it should. */
    return (uint16_t)(sign | shift_right_even(magnitude - (112u << 23), 13u));
}
