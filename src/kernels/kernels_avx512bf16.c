/* SPDX-License-Identifier: Apache-2.0 */
/* AVX512_BF16: VDPBF16PS multiplies and adds twice as many numbers as a fused multiply-add of floats does. */
#if !defined(__AVX512BF16__) || !defined(__AVX512BW__) || !defined(__AVX512VL__)
#error "compile with -mavx512bf16 -mavx512f -mavx512bw -mavx512vl"
#endif

#include "kernels/kernels.h"

#include <immintrin.h>
#include <string.h>

#define QL_UNROLL _Pragma("GCC unroll 32")
#define QL_INLINE static inline __attribute__((always_inline))

enum { W = 16 /* floats of a vector: one block of output channels */ };

QL_INLINE __m256i rounded(__m512 x)
{
    const __m256bh packed = _mm512_cvtneps_pbh(x);
    __m256i bits;
    memcpy(&bits, &packed, sizeof bits);
    return bits;
}

QL_INLINE __m512 expanded(__m256i x)
{
    return _mm512_castsi512_ps(_mm512_slli_epi32(_mm512_cvtepu16_epi32(x), 16));
}

/* Two neighbouring values for all lanes. */
QL_INLINE __m512bh pair(const uint16_t *p)
{
    int32_t both;
    memcpy(&both, p, sizeof both);
    return (__m512bh)_mm512_set1_epi32(both);
}

QL_INLINE __m512bh weight_pairs(const uint16_t *p)
{
    return (__m512bh)_mm512_load_si512(p);
}

/* num pixels by num_blocks blocks of channels in registers, both constants where this is called. */
QL_INLINE void conv_tile(const ql_bf16_conv_row *conv, size_t x, size_t c, const size_t num, const size_t num_blocks)
{
    const size_t block_weights = (size_t)conv->num_rows * conv->num_k * QL_BLOCK, stride = conv->stride;
    const uint16_t *const weights = conv->weights + c / QL_BLOCK * block_weights;
    __m512 sums[12][4];
    QL_UNROLL for (size_t v = 0; v < num_blocks; ++v)
    {
        const __m512 bias = _mm512_load_ps(conv->bias + c + v * W);
        QL_UNROLL for (size_t p = 0; p < num; ++p) sums[p][v] = bias;
    }
    size_t offset = 0;
    for (size_t r = 0; r < conv->num_rows; ++r) {
        const uint16_t *in = conv->rows[r] + x * stride;
        for (size_t k = 0; k < conv->num_k; k += 2, offset += 2 * QL_BLOCK, in += 2) {
            __m512bh w[4];
            QL_UNROLL for (size_t v = 0; v < num_blocks; ++v) w[v] = weight_pairs(weights + v * block_weights + offset);
            QL_UNROLL for (size_t p = 0; p < num; ++p)
            {
                const __m512bh value = pair(in + p * stride);
                QL_UNROLL for (size_t v = 0; v < num_blocks; ++v) sums[p][v] =
                    _mm512_dpbf16_ps(sums[p][v], value, w[v]);
            }
        }
    }
    QL_UNROLL for (size_t p = 0; p < num; ++p)
    {
        QL_UNROLL for (size_t v = 0; v < num_blocks; ++v)
        {
            const size_t at = (x + p) * conv->num_out + c + v * W;
            const __m512 sum = conv->relu ? _mm512_max_ps(sums[p][v], _mm512_setzero_ps()) : sums[p][v];
            if (conv->out)
                _mm256_storeu_si256((__m256i *)(void *)(conv->out + at), rounded(sum));
            else
                _mm512_storeu_ps(conv->sums + at, sum);
        }
    }
}

/* Blocks of channels by pixels, as kernels_avx512.c has them: 24 sums, up to 4 weights and a value of 32 registers. */
QL_INLINE void conv_columns(const ql_bf16_conv_row *conv, size_t c, const size_t num, const size_t num_blocks)
{
    size_t x = 0;
    for (; x + num <= conv->num_pixels; x += num) conv_tile(conv, x, c, num, num_blocks);
    for (; x < conv->num_pixels; ++x) conv_tile(conv, x, c, 1, num_blocks);
}

static void conv_columns_1(const ql_bf16_conv_row *conv, size_t c)
{
    conv_columns(conv, c, 12, 1);
}

static void conv_columns_2(const ql_bf16_conv_row *conv, size_t c)
{
    conv_columns(conv, c, 12, 2);
}

static void conv_columns_3(const ql_bf16_conv_row *conv, size_t c)
{
    conv_columns(conv, c, 8, 3);
}

static void conv_columns_4(const ql_bf16_conv_row *conv, size_t c)
{
    conv_columns(conv, c, 6, 4);
}

static void bf16_conv_row(const ql_bf16_conv_row *conv)
{
    size_t c = 0, left = conv->num_out / W;
    for (; left > 4 || left == 3; left -= 3, c += 3 * W) conv_columns_3(conv, c);
    if (left == 4) conv_columns_4(conv, c);
    if (left == 2) conv_columns_2(conv, c);
    if (left == 1) conv_columns_1(conv, c);
}

static __mmask16 first_lanes(size_t num)
{
    const uint32_t bits = num < W ? (1u << num) - 1u : 0xffffu;
    return (__mmask16)bits;
}

static void bf16_round_row(const float *in, uint16_t *out, uint32_t num)
{
    for (size_t i = 0; i < num; i += W) {
        const __mmask16 mask = first_lanes(num - i);
        _mm256_mask_storeu_epi16(out + i, mask, rounded(_mm512_maskz_loadu_ps(mask, in + i)));
    }
}

static void bf16_expand_row(const uint16_t *in, float *out, uint32_t num)
{
    for (size_t i = 0; i < num; i += W) {
        const __mmask16 mask = first_lanes(num - i);
        _mm512_mask_storeu_ps(out + i, mask, expanded(_mm256_maskz_loadu_epi16(mask, in + i)));
    }
}

static void bf16_add_row(const float *add, uint16_t *map, uint32_t num_channels, uint32_t num_pixels)
{
    for (size_t x = 0; x < num_pixels; ++x, map += num_channels) {
        const float *const from = add + x / 2 * num_channels;
        for (size_t c = 0; c < num_channels; c += W) {
            __m256i *const at = (__m256i *)(void *)(map + c);
            const __m512 sum = _mm512_add_ps(expanded(_mm256_loadu_si256(at)), _mm512_loadu_ps(from + c));
            _mm256_storeu_si256(at, rounded(_mm512_max_ps(sum, _mm512_setzero_ps())));
        }
    }
}

void ql_kernels_init_avx512bf16(ql_kernels *kernels)
{
    kernels->name = "avx512bf16";
    kernels->bf16 = QL_BF16_FAST;
    kernels->bf16_conv_row = bf16_conv_row;
    kernels->bf16_round_row = bf16_round_row;
    kernels->bf16_expand_row = bf16_expand_row;
    kernels->bf16_add_row = bf16_add_row;
}
