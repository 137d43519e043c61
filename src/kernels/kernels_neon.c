/* SPDX-License-Identifier: Apache-2.0 */
/* NEON of AArch64. */
#if !defined(__aarch64__)
#error "for AArch64 alone"
#endif

#include <arm_neon.h>
#include <stddef.h>

#define QL_W 4
typedef float32x4_t vf;

/* 32 registers: 24 sums, up to 4 weights, one value. */
#define QL_TILE1 14
#define QL_TILE2 12
#define QL_TILE3 8
#define QL_TILE4 6

#define v_load(p) vld1q_f32(p)
#define v_store(p, v) vst1q_f32(p, v)
#define v_set1 vdupq_n_f32
#define v_add vaddq_f32
#define v_sub vsubq_f32
#define v_mul vmulq_f32
#define v_div vdivq_f32
#define v_min vminq_f32
#define v_max vmaxq_f32
#define v_fma(a, b, c) vfmaq_f32(c, a, b)
#define v_round vrndnq_f32
#define v_gt_select(a, b, x, y) vbslq_f32(vcgtq_f32(a, b), x, y)

static inline vf v_load_n(const float *p, size_t n)
{
    float lanes[4] = {0.0f, 0.0f, 0.0f, 0.0f};
    for (size_t i = 0; i < n; ++i) lanes[i] = p[i];
    return vld1q_f32(lanes);
}

static inline void v_store_n(float *p, vf v, size_t n)
{
    float lanes[4];
    vst1q_f32(lanes, v);
    for (size_t i = 0; i < n; ++i) p[i] = lanes[i];
}

static inline vf v_pow2(vf n)
{
    return vreinterpretq_f32_s32(vshlq_n_s32(vaddq_s32(vcvtnq_s32_f32(n), vdupq_n_s32(127)), 23));
}

static inline vf v_frexp1(vf z, vf *exponent)
{
    const uint32x4_t bits = vreinterpretq_u32_f32(z);
    *exponent = vcvtq_f32_s32(vsubq_s32(vreinterpretq_s32_u32(vshrq_n_u32(bits, 23)), vdupq_n_s32(127)));
    return vreinterpretq_f32_u32(vorrq_u32(vandq_u32(bits, vdupq_n_u32(0x007fffff)), vdupq_n_u32(0x3f800000)));
}

static inline vf v_twice(const float *p, size_t n)
{
    const float a = p[0], b = n > 2 ? p[1] : 0.0f;
    const float lanes[4] = {a, a, b, b};
    return vld1q_f32(lanes);
}

static inline void v_deinterleave(const float *p, size_t n, vf *even, vf *odd)
{
    if (n >= 4) {
        const float32x4x2_t pair = vld2q_f32(p);
        *even = pair.val[0];
        *odd = pair.val[1];
        return;
    }
    float lanes[2][4] = {{0.0f, 0.0f, 0.0f, 0.0f}, {0.0f, 0.0f, 0.0f, 0.0f}};
    for (size_t i = 0; i < n; ++i) {
        lanes[0][i] = p[2 * i];
        lanes[1][i] = p[2 * i + 1];
    }
    *even = vld1q_f32(lanes[0]);
    *odd = vld1q_f32(lanes[1]);
}

static inline void v_transpose_pairs(vf *r)
{
    const float64x2_t a = vreinterpretq_f64_f32(r[0]), b = vreinterpretq_f64_f32(r[1]);
    r[0] = vreinterpretq_f32_f64(vzip1q_f64(a, b));
    r[1] = vreinterpretq_f32_f64(vzip2q_f64(a, b));
}

static inline void v_transpose(vf *r)
{
    vf low[2] = {vzip1q_f32(r[0], r[1]), vzip1q_f32(r[2], r[3])};
    vf high[2] = {vzip2q_f32(r[0], r[1]), vzip2q_f32(r[2], r[3])};
    v_transpose_pairs(low);
    v_transpose_pairs(high);
    r[0] = low[0];
    r[1] = low[1];
    r[2] = high[0];
    r[3] = high[1];
}

#include "kernels/simd_tmpl.h"
#include "kernels/wide_tmpl.h"

void ql_kernels_init_neon(ql_kernels *kernels)
{
    fill_table(kernels, "neon");
    fill_wide(kernels);
}
