/* SPDX-License-Identifier: Apache-2.0 */
/* AVX2 with FMA. */
#if !defined(__AVX2__) || !defined(__FMA__)
#error "compile with -mavx2 -mfma"
#endif

#include <immintrin.h>
#include <stddef.h>
#include <stdint.h>

#define QL_W 8
typedef __m256 vf;

/* 16 registers: 12 sums, up to 2 weights, one value. */
#define QL_TILE1 12
#define QL_TILE2 6

static inline __m256i lanes(size_t n)
{
    return _mm256_cmpgt_epi32(_mm256_set1_epi32((int32_t)n), _mm256_setr_epi32(0, 1, 2, 3, 4, 5, 6, 7));
}

#define v_load(p) _mm256_loadu_ps(p)
#define v_store(p, v) _mm256_storeu_ps(p, v)
#define v_load_n(p, n) _mm256_maskload_ps(p, lanes(n))
#define v_store_n(p, v, n) _mm256_maskstore_ps(p, lanes(n), v)
#define v_set1 _mm256_set1_ps
#define v_add _mm256_add_ps
#define v_sub _mm256_sub_ps
#define v_mul _mm256_mul_ps
#define v_div _mm256_div_ps
#define v_min _mm256_min_ps
#define v_max _mm256_max_ps
#define v_fma _mm256_fmadd_ps
#define v_round(x) _mm256_round_ps(x, _MM_FROUND_TO_NEAREST_INT | _MM_FROUND_NO_EXC)
#define v_gt_select(a, b, x, y) _mm256_blendv_ps(y, x, _mm256_cmp_ps(a, b, _CMP_GT_OQ))

static inline vf v_pow2(vf n)
{
    const __m256i e = _mm256_add_epi32(_mm256_cvtps_epi32(n), _mm256_set1_epi32(127));
    return _mm256_castsi256_ps(_mm256_slli_epi32(e, 23));
}

static inline vf v_frexp1(vf z, vf *exponent)
{
    const __m256i bits = _mm256_castps_si256(z);
    *exponent = _mm256_cvtepi32_ps(_mm256_sub_epi32(_mm256_srli_epi32(bits, 23), _mm256_set1_epi32(127)));
    return _mm256_castsi256_ps(
        _mm256_or_si256(_mm256_and_si256(bits, _mm256_set1_epi32(0x007fffff)), _mm256_set1_epi32(0x3f800000)));
}

static inline vf v_twice(const float *p, size_t n)
{
    const __m128 half = n >= 8 ? _mm_loadu_ps(p) : _mm_maskload_ps(p, _mm256_castsi256_si128(lanes(n / 2)));
    return _mm256_permutevar8x32_ps(_mm256_castps128_ps256(half), _mm256_setr_epi32(0, 0, 1, 1, 2, 2, 3, 3));
}

static inline void v_deinterleave(const float *p, size_t n, vf *even, vf *odd)
{
    const size_t low_lanes = n >= 4 ? 8 : 2 * n, high_lanes = n >= 8 ? 8 : n > 4 ? 2 * n - 8 : 0;
    const vf low = low_lanes == 8 ? v_load(p) : v_load_n(p, low_lanes);
    const vf high = high_lanes == 8 ? v_load(p + 8) : high_lanes ? v_load_n(p + 8, high_lanes) : _mm256_setzero_ps();
    const vf a = _mm256_permute2f128_ps(low, high, 0x20), b = _mm256_permute2f128_ps(low, high, 0x31);
    *even = _mm256_shuffle_ps(a, b, 0x88);
    *odd = _mm256_shuffle_ps(a, b, 0xdd);
}

static inline void v_transpose(vf *r)
{
    vf t[8];
    for (size_t i = 0; i < 8; i += 4) {
        const vf a = _mm256_unpacklo_ps(r[i], r[i + 1]), b = _mm256_unpackhi_ps(r[i], r[i + 1]);
        const vf c = _mm256_unpacklo_ps(r[i + 2], r[i + 3]), d = _mm256_unpackhi_ps(r[i + 2], r[i + 3]);
        t[i] = _mm256_shuffle_ps(a, c, 0x44);
        t[i + 1] = _mm256_shuffle_ps(a, c, 0xee);
        t[i + 2] = _mm256_shuffle_ps(b, d, 0x44);
        t[i + 3] = _mm256_shuffle_ps(b, d, 0xee);
    }
    for (size_t i = 0; i < 4; ++i) {
        r[i] = _mm256_permute2f128_ps(t[i], t[4 + i], 0x20);
        r[4 + i] = _mm256_permute2f128_ps(t[i], t[4 + i], 0x31);
    }
}

static inline void v_transpose_pairs(vf *r)
{
    vf t[4];
    for (size_t i = 0; i < 4; i += 2) {
        t[i] = _mm256_shuffle_ps(r[i], r[i + 1], 0x44);
        t[i + 1] = _mm256_shuffle_ps(r[i], r[i + 1], 0xee);
    }
    for (size_t i = 0; i < 2; ++i) {
        r[i] = _mm256_permute2f128_ps(t[i], t[2 + i], 0x20);
        r[2 + i] = _mm256_permute2f128_ps(t[i], t[2 + i], 0x31);
    }
}

#include "kernels/simd_tmpl.h"
#include "kernels/wide_tmpl.h"

void ql_kernels_init_avx2(ql_kernels *kernels)
{
    fill_table(kernels, "avx2");
    fill_wide(kernels);
}
