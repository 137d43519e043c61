/* SPDX-License-Identifier: Apache-2.0 */
/* Auxiliary channels. Order and ranges as in training/dgan/features.py: make_auxiliary. */
#include "models/dgan_features.h"

#include "frame/roles.h"
#include "models/kpn.h"

#include <math.h>

static float finite_or_zero(float value)
{
    return isfinite(value) ? value : 0.0f;
}

static float clamp_to_1(float value)
{
    return value < -1.0f ? -1.0f : value > 1.0f ? 1.0f : value;
}

static float squash(float texture)
{
    const float c = texture > 0.0f ? texture : 0.0f;
    return c > 1e30f ? 2.0f : 2.0f * c / (1.0f + c);
}

int ql_dgan_is_hit(const ql_dgan_rows *rows, uint32_t x)
{
    if (rows->depth) return rows->depth[x] > 0.0f && rows->depth[x] < QL_BACKGROUND_DEPTH;
    const float *const *const p = rows->position;
    return p[0] && (p[0][x] != 0.0f || p[1][x] != 0.0f || p[2][x] != 0.0f);
}

void ql_dgan_feature_row(const ql_dgan_scale *scale, const ql_dgan_rows *rows, uint32_t num_pixels, float *out)
{
    const float depth_scale = ldexpf(1.0f, -scale->depth_exponent);
    for (uint32_t x = 0; x < num_pixels; ++x, out += QL_KPN_AUXILIARY) {
        const int hit = ql_dgan_is_hit(rows, x);
        for (uint32_t c = 0; c < 3; ++c) {
            const float *const *const second = rows->texture_2[0], *const *const third = rows->texture_2[1];
            const float glossy = second[0] ? finite_or_zero(second[c][x]) : 0.0f;
            const float transmission = third[0] ? finite_or_zero(third[c][x]) : 0.0f;
            out[c] = rows->normal[0] ? clamp_to_1(finite_or_zero(rows->normal[c][x])) : 0.0f;
            out[3 + c] = 0.0f;
            if (rows->position[0] && hit)
                out[3 + c] =
                    clamp_to_1((finite_or_zero(rows->position[c][x]) - scale->center[c]) * scale->position_scale);
            out[6 + c] = rows->texture_1[0] ? squash(finite_or_zero(rows->texture_1[c][x])) : 0.0f;
            out[9 + c] = squash(glossy + transmission);
        }
        out[12] = rows->depth == NULL ? 0.0f : hit ? 1.0f / (1.0f + rows->depth[x] * depth_scale) : -1.0f;
    }
}
