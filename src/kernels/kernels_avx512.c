/* SPDX-License-Identifier: Apache-2.0 */
/* AVX-512 (F, BW, DQ, VL). */
#if !defined(__AVX512F__) || !defined(__AVX512DQ__) || !defined(__AVX512VL__) || !defined(__AVX512BW__)
#error "compile with -mavx512f -mavx512bw -mavx512dq -mavx512vl"
#endif

#include <immintrin.h>
#include <stddef.h>

#define QL_W 16
typedef __m512 vf;

/* 32 registers: 24 sums, up to 4 weights, one value. */
#define QL_TILE1 12
#define QL_TILE2 12
#define QL_TILE3 8
#define QL_TILE4 6

static inline __mmask16 lanes(size_t n)
{
    return (__mmask16)((1u << n) - 1u);
}

#define v_load(p) _mm512_loadu_ps(p)
#define v_store(p, v) _mm512_storeu_ps(p, v)
#define v_load_n(p, n) _mm512_maskz_loadu_ps(lanes(n), p)
#define v_store_n(p, v, n) _mm512_mask_storeu_ps(p, lanes(n), v)
#define v_set1 _mm512_set1_ps
#define v_add _mm512_add_ps
#define v_sub _mm512_sub_ps
#define v_mul _mm512_mul_ps
#define v_div _mm512_div_ps
#define v_min _mm512_min_ps
#define v_max _mm512_max_ps
#define v_fma _mm512_fmadd_ps
#define v_round(x) _mm512_roundscale_ps(x, _MM_FROUND_TO_NEAREST_INT | _MM_FROUND_NO_EXC)
#define v_gt_select(a, b, x, y) _mm512_mask_blend_ps(_mm512_cmp_ps_mask(a, b, _CMP_GT_OQ), y, x)

static inline vf v_pow2(vf n)
{
    const __m512i e = _mm512_add_epi32(_mm512_cvtps_epi32(n), _mm512_set1_epi32(127));
    return _mm512_castsi512_ps(_mm512_slli_epi32(e, 23));
}

static inline vf v_frexp1(vf z, vf *exponent)
{
    const __m512i bits = _mm512_castps_si512(z);
    *exponent = _mm512_cvtepi32_ps(_mm512_sub_epi32(_mm512_srli_epi32(bits, 23), _mm512_set1_epi32(127)));
    return _mm512_castsi512_ps(
        _mm512_or_epi32(_mm512_and_epi32(bits, _mm512_set1_epi32(0x007fffff)), _mm512_set1_epi32(0x3f800000)));
}

static inline vf v_twice(const float *p, size_t n)
{
    const __m512i index = _mm512_setr_epi32(0, 0, 1, 1, 2, 2, 3, 3, 4, 4, 5, 5, 6, 6, 7, 7);
    const __m256 half = _mm256_maskz_loadu_ps((__mmask8)((1u << (n / 2)) - 1u), p);
    return _mm512_permutexvar_ps(index, _mm512_castps256_ps512(half));
}

static inline void v_deinterleave(const float *p, size_t n, vf *even, vf *odd)
{
    const __m512i even_index = _mm512_setr_epi32(0, 2, 4, 6, 8, 10, 12, 14, 16, 18, 20, 22, 24, 26, 28, 30);
    const __m512i odd_index = _mm512_add_epi32(even_index, _mm512_set1_epi32(1));
    const __mmask32 mask = n >= 16 ? 0xffffffffu : (1u << (2 * n)) - 1u;
    const vf low = _mm512_maskz_loadu_ps((__mmask16)mask, p);
    const vf high = n > 8 ? _mm512_maskz_loadu_ps((__mmask16)(mask >> 16), p + 16) : _mm512_setzero_ps();
    *even = _mm512_permutex2var_ps(low, even_index, high);
    *odd = _mm512_permutex2var_ps(low, odd_index, high);
}

/* Blocks of 4x4 values, or 2x2 pairs, within quarters; then the quarters. */
static inline void transpose_quarters(vf *r, const vf *t)
{
    for (size_t i = 0; i < 4; ++i) {
        const vf a = _mm512_shuffle_f32x4(t[i], t[4 + i], 0x88), b = _mm512_shuffle_f32x4(t[i], t[4 + i], 0xdd);
        const vf c = _mm512_shuffle_f32x4(t[8 + i], t[12 + i], 0x88),
                 d = _mm512_shuffle_f32x4(t[8 + i], t[12 + i], 0xdd);
        r[i] = _mm512_shuffle_f32x4(a, c, 0x88);
        r[4 + i] = _mm512_shuffle_f32x4(b, d, 0x88);
        r[8 + i] = _mm512_shuffle_f32x4(a, c, 0xdd);
        r[12 + i] = _mm512_shuffle_f32x4(b, d, 0xdd);
    }
}

static inline void v_transpose(vf *r)
{
    vf t[16];
    for (size_t i = 0; i < 16; i += 4) {
        const __m512d a = _mm512_castps_pd(_mm512_unpacklo_ps(r[i], r[i + 1]));
        const __m512d b = _mm512_castps_pd(_mm512_unpackhi_ps(r[i], r[i + 1]));
        const __m512d c = _mm512_castps_pd(_mm512_unpacklo_ps(r[i + 2], r[i + 3]));
        const __m512d d = _mm512_castps_pd(_mm512_unpackhi_ps(r[i + 2], r[i + 3]));
        t[i] = _mm512_castpd_ps(_mm512_unpacklo_pd(a, c));
        t[i + 1] = _mm512_castpd_ps(_mm512_unpackhi_pd(a, c));
        t[i + 2] = _mm512_castpd_ps(_mm512_unpacklo_pd(b, d));
        t[i + 3] = _mm512_castpd_ps(_mm512_unpackhi_pd(b, d));
    }
    transpose_quarters(r, t);
}

static inline void v_transpose_pairs(vf *r)
{
    vf t[8];
    for (size_t i = 0; i < 8; i += 2) {
        const __m512d a = _mm512_castps_pd(r[i]), b = _mm512_castps_pd(r[i + 1]);
        t[i] = _mm512_castpd_ps(_mm512_unpacklo_pd(a, b));
        t[i + 1] = _mm512_castpd_ps(_mm512_unpackhi_pd(a, b));
    }
    for (size_t i = 0; i < 2; ++i) {
        const vf a = _mm512_shuffle_f32x4(t[i], t[2 + i], 0x88), b = _mm512_shuffle_f32x4(t[i], t[2 + i], 0xdd);
        const vf c = _mm512_shuffle_f32x4(t[4 + i], t[6 + i], 0x88), d = _mm512_shuffle_f32x4(t[4 + i], t[6 + i], 0xdd);
        r[i] = _mm512_shuffle_f32x4(a, c, 0x88);
        r[2 + i] = _mm512_shuffle_f32x4(b, d, 0x88);
        r[4 + i] = _mm512_shuffle_f32x4(a, c, 0xdd);
        r[6 + i] = _mm512_shuffle_f32x4(b, d, 0xdd);
    }
}

#include "kernels/simd_tmpl.h"
#include "kernels/wide_tmpl.h"

void ql_kernels_init_avx512(ql_kernels *kernels)
{
    fill_table(kernels, "avx512");
    fill_wide(kernels);
}
