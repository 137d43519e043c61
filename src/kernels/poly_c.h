/* SPDX-License-Identifier: Apache-2.0 */
/* Exponential and logarithm of the C kernels; poly.h says where the coefficients come from. */
#ifndef QL_KERNELS_POLY_C_H
#define QL_KERNELS_POLY_C_H

#include "kernels/poly.h"

#include <math.h>
#include <stdint.h>
#include <string.h>

static inline float exp_poly(float x)
{
    x = x < QL_EXP_MIN ? QL_EXP_MIN : x;
    x = x > QL_EXP_MAX ? QL_EXP_MAX : x;
    const float n = rintf(x * QL_LOG2E);
    const float r = (x - n * QL_LN2_HIGH) - n * QL_LN2_LOW;
    float p = QL_EXP_C7;
    p = p * r + QL_EXP_C6;
    p = p * r + QL_EXP_C5;
    p = p * r + QL_EXP_C4;
    p = p * r + QL_EXP_C3;
    p = p * r + QL_EXP_C2;
    p = p * r + 1.0f;
    p = p * r + 1.0f;
    const uint32_t bits = (uint32_t)((int32_t)n + 127) << 23;
    float scale;
    memcpy(&scale, &bits, sizeof scale);
    return p * scale;
}

static inline float log_poly(float z) /* z >= 1, finite */
{
    uint32_t bits;
    memcpy(&bits, &z, sizeof bits);
    float e = (float)((int32_t)(bits >> 23) - 127);
    bits = (bits & 0x007fffffu) | 0x3f800000u;
    float m;
    memcpy(&m, &bits, sizeof m);
    if (m > QL_SQRT2) {
        m *= 0.5f;
        e += 1.0f;
    }
    const float s = (m - 1.0f) / (m + 1.0f), s2 = s * s;
    float p = QL_LOG_C9;
    p = p * s2 + QL_LOG_C7;
    p = p * s2 + QL_LOG_C5;
    p = p * s2 + QL_LOG_C3;
    p = p * s2 + 2.0f;
    return e * QL_LN2 + p * s;
}

#endif
