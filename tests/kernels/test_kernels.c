/* SPDX-License-Identifier: Apache-2.0 */
/*
 * Every kernel of every instruction set of this machine against its C twin: random shapes down to one pixel and every
 * tail, ordinary and extreme values, odd strides. Each buffer ends at a page that may not be touched, so that a value
 * read or written too far ends the program. No cmocka: it also runs cross compiled.
 *
 * QUELL_SEED=N repeats a run; --bench prints ns per pixel.
 */
#include "base/bf16.h"
#include "base/clock.h"
#include "base/cpu.h"
#include "kernels/kernels.h"
#include "system.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

enum { MAX_BLOCKS = 64, ROUNDS = 60 };

static uint64_t seed_state = 1;
static unsigned num_checks, num_failures;

static struct {
    void *data;
    size_t bytes;
} blocks[MAX_BLOCKS];
static size_t num_blocks;

static uint32_t random_bits(void) /* splitmix64 */
{
    uint64_t z = (seed_state += 0x9e3779b97f4a7c15u);
    z = (z ^ (z >> 30)) * 0xbf58476d1ce4e5b9u;
    z = (z ^ (z >> 27)) * 0x94d049bb133111ebu;
    return (uint32_t)((z ^ (z >> 31)) >> 32);
}

static uint32_t random_below(uint32_t n)
{
    return random_bits() % n;
}

static float random_float(float low, float high)
{
    return low + (high - low) * (float)(random_bits() >> 8) / 16777216.0f;
}

/* num floats whose last one is followed by a forbidden page; freed by release_all. */
static float *guarded(size_t num)
{
    if (num_blocks == MAX_BLOCKS) abort();
    blocks[num_blocks].bytes = num * sizeof(float);
    blocks[num_blocks].data = test_alloc_guarded(num * sizeof(float));
    return blocks[num_blocks++].data;
}

static void release_all(void)
{
    for (size_t i = 0; i < num_blocks; ++i) test_free_guarded(blocks[i].data, blocks[i].bytes);
    num_blocks = 0;
}

/* kind 0: ordinary; 1: radiances over many stops; 2: extremes that a frame may hold once bad pixels are masked. */
static void fill(float *p, size_t num, int kind)
{
    static const float extremes[] = {0.0f, 1e-42f, 1e-38f, 6e-8f, 1.0f, 65504.0f, 1e9f, 1e20f};
    for (size_t i = 0; i < num; ++i) {
        if (kind == 0)
            p[i] = random_float(-1.0f, 1.0f);
        else if (kind == 1)
            p[i] = exp2f(random_float(-20.0f, 20.0f));
        else
            p[i] = extremes[random_below(sizeof extremes / sizeof *extremes)];
    }
}

/* Error bounds: |a - b| <= relative * scale, scale being the sum of the magnitudes that went into the value. */
static void expect(const char *what, const char *isa, const float *got, const float *want, const float *scale,
                   size_t num, double relative)
{
    ++num_checks;
    for (size_t i = 0; i < num; ++i) {
        const double error = fabs((double)got[i] - (double)want[i]), bound = relative * (double)scale[i] + 1e-37;
        if (!(error <= bound)) {
            if (++num_failures < 20)
                printf("%s %s: value %zu of %zu is %.9g, C gives %.9g (error %.3g, bound %.3g)\n", isa, what, i, num,
                       (double)got[i], (double)want[i], error, bound);
            return;
        }
    }
}

static void test_conv(const ql_kernels *c, const ql_kernels *k)
{
    static const uint32_t channels[] = {1, 3, 16, 28, 48};
    const uint32_t num_rows = 1 + random_below(QL_MAX_CONV_ROWS), in = channels[random_below(5)],
                   num_pixels = 1 + random_below(40);
    const uint32_t num_out = QL_BLOCK * (1 + random_below(12)), num_k = num_rows * in;
    const uint32_t stride = num_rows == 2 ? num_k : in;
    const size_t row = (size_t)(num_pixels - 1) * stride + num_k, num = (size_t)num_pixels * num_out;
    float *const weights = guarded((size_t)num_rows * num_k * num_out), *const bias = guarded(num_out);
    float *const add = guarded(num), *const a = guarded(num), *const b = guarded(num), *const scale = guarded(num);
    ql_conv_row conv = {.weights = weights, .bias = bias, .num_rows = num_rows, .num_k = num_k, .stride = stride};
    const int kind = (int)random_below(2);
    for (uint32_t r = 0; r < num_rows; ++r) {
        float *const p = guarded(row);
        fill(p, row, kind);
        conv.rows[r] = p;
    }
    fill(weights, (size_t)num_rows * num_k * num_out, 0);
    fill(bias, num_out, 0);
    fill(add, num, kind);
    conv.add = random_below(2) ? add : NULL;
    conv.relu = (int32_t)random_below(2);
    conv.num_pixels = num_pixels;
    conv.num_out = num_out;
    conv.out = a;
    k->conv_row(&conv);
    conv.out = b;
    c->conv_row(&conv);
    for (uint32_t x = 0; x < num_pixels; ++x)
        for (uint32_t o = 0; o < num_out; ++o) {
            float sum = fabsf(bias[o]) + (conv.add ? fabsf(add[x * num_out + o]) : 0.0f);
            for (uint32_t r = 0; r < num_rows; ++r)
                for (uint32_t i = 0; i < num_k; ++i) sum += fabsf(conv.rows[r][x * stride + i]);
            scale[x * num_out + o] = sum;
        }
    expect("conv_row", k->name, a, b, scale, num, 4e-7 * 4);
}

/* Planes with a margin, so that taps outside a row are inside memory; returns (0, 0) of a plane. */
static float *plane(uint32_t width, uint32_t height, uint32_t margin, int kind)
{
    const size_t stride = width + 2 * margin, num = stride * (height + 2 * margin);
    float *const p = guarded(num);
    fill(p, num, kind);
    for (size_t i = 0; i < num; ++i) p[i] = fabsf(p[i]);
    return p + margin * stride + margin;
}

static void largest(const float *p, ptrdiff_t stride, uint32_t width, uint32_t height, uint32_t margin, float *scale,
                    size_t num)
{
    float top = 0.0f;
    for (ptrdiff_t y = -(ptrdiff_t)margin; y < (ptrdiff_t)(height + margin); ++y)
        for (ptrdiff_t x = -(ptrdiff_t)margin; x < (ptrdiff_t)(width + margin); ++x)
            top = fmaxf(top, fabsf(p[y * stride + x]));
    for (size_t i = 0; i < num; ++i) scale[i] = top;
}

enum { DIMS = 5 };

/* Embeddings of a row and of what its taps see, with a margin; sharpness over many stops now and then. */
static ql_affinity random_affinity(uint32_t width, uint32_t other_width, uint32_t margin)
{
    const size_t stride = other_width + 2 * (size_t)margin, other_plane = stride * (1 + 2 * (size_t)margin);
    float *const own = guarded((size_t)DIMS * width), *const sharpness = guarded((size_t)DIMS * width);
    float *const other = guarded(DIMS * other_plane);
    fill(own, (size_t)DIMS * width, 0);
    fill(other, DIMS * other_plane, 0);
    const float stops = random_below(4) ? 2.0f : 11.0f;
    for (size_t i = 0; i < (size_t)DIMS * width; ++i) sharpness[i] = exp2f(random_float(-stops, stops));
    return (ql_affinity){own,       width, other + margin * stride + margin, other_plane, (ptrdiff_t)stride,
                         sharpness, width, DIMS};
}

/* Bound for logits as large as these: their own rounding, times what exp makes of it. */
static double logit_bound(const ql_affinity *a, uint32_t width)
{
    float top = 0.0f;
    for (size_t i = 0; i < (size_t)DIMS * width; ++i) top = fmaxf(top, a->sharpness[i]);
    return 2e-6 + 4e-7 * DIMS * 4.0 * (double)top;
}

static void test_filter(const ql_kernels *c, const ql_kernels *k)
{
    enum { CHANNELS = 3 };
    const uint32_t width = 1 + random_below(50);
    const int kind = (int)random_below(3);
    float *const centre = guarded(width), *const table = guarded(25), *const scale = guarded(width);
    const float *in[CHANNELS];
    float *a[CHANNELS], *b[CHANNELS];
    fill(centre, width, 0);
    fill(table, 25, 0);
    for (int i = 0; i < CHANNELS; ++i) {
        in[i] = plane(width, 1, 2, kind);
        a[i] = guarded(width);
        b[i] = guarded(width);
    }
    ql_filter_row filter = {
        random_affinity(width, width, 2), centre, table, in, (ptrdiff_t)width + 4, a, CHANNELS, width};
    k->filter_row(&filter);
    filter.out = b;
    c->filter_row(&filter);
    for (int i = 0; i < CHANNELS; ++i) {
        largest(in[i], (ptrdiff_t)width + 4, width, 1, 2, scale, width);
        expect("filter_row", k->name, a[i], b[i], scale, width, logit_bound(&filter.affinity, width));
    }
}

static void test_upsample(const ql_kernels *c, const ql_kernels *k)
{
    enum { CHANNELS = 2 };
    const uint32_t width = 2 * (1 + random_below(30));
    const int kind = (int)random_below(3);
    float *const table = guarded(18), *const blend = guarded(width), *const scale = guarded(width);
    const float *in[CHANNELS];
    float *a[CHANNELS], *b[CHANNELS];
    fill(table, 18, 0);
    fill(blend, width, 0);
    for (size_t i = 0; i < width; ++i) blend[i] *= 10.0f;
    for (int i = 0; i < CHANNELS; ++i) {
        in[i] = plane(width / 2, 1, 1, kind);
        a[i] = guarded(width);
        b[i] = guarded(width);
        fill(a[i], width, kind);
        memcpy(b[i], a[i], width * sizeof(float));
    }
    float *const before = guarded(width);
    memcpy(before, a[0], width * sizeof(float));
    ql_upsample_row up = {random_affinity(width, width / 2, 1), blend, {table, table + 9}, in,
                          (ptrdiff_t)width / 2 + 2,             a,     CHANNELS,           width};
    k->upsample_row(&up);
    up.out = b;
    c->upsample_row(&up);
    for (int i = 0; i < CHANNELS; ++i) {
        largest(in[i], (ptrdiff_t)width / 2 + 2, width / 2, 1, 1, scale, width);
        for (size_t x = 0; x < width; ++x) scale[x] += fabsf(b[i][x]) + fabsf(before[x]);
        expect("upsample_row", k->name, a[i], b[i], scale, width, logit_bound(&up.affinity, width));
    }
}

static void test_partition(const ql_kernels *c, const ql_kernels *k)
{
    const uint32_t cells = 1 + random_below(40), width = 2 * cells;
    const int kind = (int)random_below(3);
    float *const logits = guarded((size_t)2 * width), *const in = guarded((size_t)2 * width);
    float *a[1] = {guarded(cells)}, *b[1] = {guarded(cells)}, *const scale = guarded(cells);
    const float *inputs[1] = {in};
    fill(logits, (size_t)2 * width, 0);
    fill(in, (size_t)2 * width, kind);
    ql_partition_row partition = {{logits, logits + width}, inputs, (ptrdiff_t)width, a, 1, cells};
    k->partition_row(&partition);
    partition.out = b;
    c->partition_row(&partition);
    for (uint32_t x = 0; x < cells; ++x) {
        scale[x] = 0.0f;
        for (uint32_t i = 0; i < 4; ++i) scale[x] += fabsf(in[(i / 2) * width + 2 * x + i % 2]);
    }
    expect("partition_row", k->name, a[0], b[0], scale, cells, 2e-6);
}

static void test_rows(const ql_kernels *c, const ql_kernels *k)
{
    const uint32_t width = 1 + random_below(50);
    float *const in = guarded(width), *const a = guarded(width), *const b = guarded(width), *const one = guarded(width);
    for (uint32_t x = 0; x < width; ++x) one[x] = 1.0f;
    fill(in, width, 0);
    for (uint32_t x = 0; x < width; ++x) in[x] *= 30.0f;
    k->sigmoid_row(in, a, width);
    c->sigmoid_row(in, b, width);
    expect("sigmoid_row", k->name, a, b, one, width, 4e-7);
    for (uint32_t x = 0; x < width; ++x) one[x] = 1.0f / (1.0f + expf(-fmaxf(-12.0f, fminf(12.0f, in[x]))));
    expect("sigmoid_row against libm", k->name, a, one, one, width, 4e-6);

    k->exp_row(in, a, width);
    c->exp_row(in, b, width);
    for (uint32_t x = 0; x < width; ++x) one[x] = expf(fmaxf(-8.0f, fminf(8.0f, in[x])));
    expect("exp_row", k->name, a, b, one, width, 4e-7);
    expect("exp_row against libm", k->name, a, one, one, width, 4e-7);

    fill(in, width, (int)random_below(3));
    const float scale = exp2f((float)random_below(20) - 10.0f);
    k->tone_row(in, scale, a, width);
    c->tone_row(in, scale, b, width);
    for (uint32_t x = 0; x < width; ++x) one[x] = 50.0f;
    expect("tone_row", k->name, a, b, one, width, 4e-7);
    for (uint32_t x = 0; x < width; ++x) b[x] = (float)(0.5 * log1p(8.0 * (double)fmaxf(0.0f, in[x] * scale)));
    expect("tone_row against libm", k->name, a, b, one, width, 4e-7);

    const uint32_t planes = 1 + random_below(40), group = 1 + random_below(2),
                   stride = planes * group + random_below(9);
    float *const from = guarded((size_t)(width - 1) * stride + planes * group), *const wide = guarded((size_t)planes *
                                                                                                      group * width);
    float *const want = guarded((size_t)planes * group * width);
    fill(from, (size_t)(width - 1) * stride + planes * group, 0);
    k->planes_row(from, stride, planes, group, wide, (size_t)group * width, width);
    c->planes_row(from, stride, planes, group, want, (size_t)group * width, width);
    ++num_checks;
    if (memcmp(wide, want, (size_t)planes * group * width * sizeof *want) != 0) {
        ++num_failures;
        printf("%s planes_row: %u planes in groups of %u over %u pixels differ\n", k->name, planes, group, width);
    }
}

static void test_softmax(const ql_kernels *c, const ql_kernels *k)
{
    const uint32_t width = 1 + random_below(50), planes = 1 + random_below(400);
    const size_t stride = width + random_below(5), num = (size_t)(planes - 1) * stride + width;
    float *const a = guarded(num), *const b = guarded(num), *const one = guarded(num);
    fill(a, num, 0);
    for (size_t i = 0; i < num; ++i) {
        a[i] *= 30.0f;
        one[i] = 1.0f;
    }
    if (random_below(2)) a[random_below((uint32_t)num)] = -1e30f; /* a tap that is dropped */
    memcpy(b, a, num * sizeof *a);
    k->softmax_row(a, stride, planes, width);
    c->softmax_row(b, stride, planes, width);
    expect("softmax_row", k->name, a, b, one, num, 2e-6);
    for (uint32_t x = 0; x < width; ++x) {
        double sum = 0.0;
        for (uint32_t p = 0; p < planes; ++p) sum += (double)a[p * stride + x];
        ++num_checks;
        if (fabs(sum - 1.0) < 1e-5) continue;
        ++num_failures;
        printf("%s softmax_row: weights sum to %.9g\n", k->name, sum);
    }
}

static void test_gather(const ql_kernels *c, const ql_kernels *k)
{
    enum { CHANNELS = 4 };
    const uint32_t radius = random_below(11), taps = (2 * radius + 1) * (2 * radius + 1);
    const uint32_t width = 1 + random_below(50), channels = 1 + random_below(CHANNELS);
    float *const weights = guarded((size_t)taps * width), *const scale = guarded(width);
    const float *in[CHANNELS];
    float *a[CHANNELS], *b[CHANNELS];
    fill(weights, (size_t)taps * width, 0);
    for (size_t i = 0; i < (size_t)taps * width; ++i) weights[i] = fabsf(weights[i]) / (float)taps;
    const int kind = (int)random_below(3);
    for (uint32_t i = 0; i < channels; ++i) {
        in[i] = plane(width, 1, radius, kind);
        a[i] = guarded(width);
        b[i] = guarded(width);
    }
    const ptrdiff_t stride = (ptrdiff_t)(width + 2 * radius);
    ql_gather_row gather = {weights, width, in, stride, a, radius, channels, width};
    k->gather_row(&gather);
    gather.out = b;
    c->gather_row(&gather);
    for (uint32_t i = 0; i < channels; ++i) {
        largest(in[i], stride, width, 1, radius, scale, width);
        expect("gather_row", k->name, a[i], b[i], scale, width, 4e-6);
    }
}

static void test_norm(const ql_kernels *c, const ql_kernels *k)
{
    const uint32_t channels = QL_BLOCK * (1 + random_below(5)), width = 1 + random_below(30);
    const size_t num = (size_t)channels * width;
    float *const in = guarded(num), *const add = guarded(num), *const a = guarded(num), *const b = guarded(num);
    float *const mean = guarded(channels), *const scale = guarded(channels), *const bound = guarded(num);
    const int kind = (int)random_below(2);
    fill(in, num, kind);
    fill(add, num, kind);
    fill(mean, channels, 0);
    fill(scale, channels, 0);
    for (size_t i = 0; i < num; ++i) bound[i] = fabsf(in[i]) + 1.0f + fabsf(add[i]);
    ql_norm_row norm = {in, mean, scale, random_below(2) ? add : NULL, a, channels, width};
    k->norm_row(&norm);
    norm.out = b;
    c->norm_row(&norm);
    expect("norm_row", k->name, a, b, bound, num, 4e-7);

    double sums[4][QL_BLOCK * 5] = {{0.0}};
    k->moments_row(in, channels, width, sums[0], sums[1]);
    c->moments_row(in, channels, width, sums[2], sums[3]);
    ++num_checks;
    if (memcmp(sums[0], sums[2], 2 * sizeof sums[0]) != 0) {
        ++num_failures;
        printf("%s moments_row: %u channels over %u pixels differ\n", k->name, channels, width);
    }
}

static void test_expm1(const ql_kernels *c, const ql_kernels *k)
{
    const uint32_t width = 1 + random_below(50);
    float *const in = guarded(width), *const a = guarded(width), *const b = guarded(width),
                 *const bound = guarded(width);
    fill(in, width, 0);
    for (uint32_t x = 0; x < width; ++x) in[x] *= 12.0f;
    const float top = random_float(0.5f, 10.0f), scale = exp2f((float)random_below(20) - 10.0f);
    k->expm1_row(in, top, scale, a, width);
    c->expm1_row(in, top, scale, b, width);
    for (uint32_t x = 0; x < width; ++x) bound[x] = scale * expf(top);
    expect("expm1_row", k->name, a, b, bound, width, 4e-7);
    for (uint32_t x = 0; x < width; ++x) b[x] = scale * (float)expm1((double)fminf(fmaxf(in[x], 0.0f), top));
    expect("expm1_row against libm", k->name, a, b, bound, width, 4e-7);
}

/* ---- bfloat16 ----------------------------------------------------------------------------------------------------- */

/* num bfloat16 numbers that end at a forbidden page. kind: as in fill; 3: every pattern of bits but infinities and NaN; 4:
 * numbers from 2^-50 to 2^50, and those that count as 0. */
static uint16_t *guarded_bf16(size_t num, int kind)
{
    if (num_blocks == MAX_BLOCKS) abort();
    blocks[num_blocks].bytes = num * sizeof(uint16_t);
    blocks[num_blocks].data = test_alloc_guarded(num * sizeof(uint16_t));
    uint16_t *const p = blocks[num_blocks++].data;
    for (size_t i = 0; i < num; ++i) {
        float value;
        fill(&value, 1, kind < 3 ? kind : 0);
        p[i] = kind < 3 ? ql_bf16_from_float(value) : (uint16_t)random_bits();
        if ((p[i] & 0x7f80u) == 0x7f80u) p[i] &= 0xbfffu;
        if (kind != 4) continue;
        const uint32_t exponent = random_below(8) ? 77 + random_below(101) : 0;
        p[i] = (uint16_t)((p[i] & 0x807fu) | exponent << 7);
    }
    return p;
}

static void expect_same_bits(const char *what, const char *isa, const void *got, const void *want, size_t num_bytes)
{
    ++num_checks;
    if (memcmp(got, want, num_bytes) == 0) return;
    if (++num_failures < 20) printf("%s %s: the bits of %zu bytes differ from C's\n", isa, what, num_bytes);
}

/* A conversion is exact, of every pattern of bits; NaN stays NaN, but of which bits is not said. */
static void test_bf16_rows(const ql_kernels *c, const ql_kernels *k)
{
    static const uint32_t special[] = {0x00000000u, 0x80000000u, 0x00000001u, 0x007fffffu, 0x00800000u, 0x807f8000u,
                                       0x3f808000u, 0x3f818000u, 0x3f807fffu, 0x3f808001u, 0x7f7fffffu, 0x7f7f7fffu,
                                       0x7f800000u, 0xff800000u, 0x7fc00000u, 0x7f800001u};
    const uint32_t num = 1 + random_below(70);
    float *const in = guarded(num), *const a = guarded(num), *const b = guarded(num);
    for (uint32_t i = 0; i < num; ++i) {
        const uint32_t bits = random_below(3) ? random_bits() : special[random_below(sizeof special / sizeof *special)];
        memcpy(&in[i], &bits, sizeof bits);
    }
    uint16_t *const x = guarded_bf16(num, 3), *const y = guarded_bf16(num, 3);
    k->bf16_round_row(in, x, num);
    c->bf16_round_row(in, y, num);
    for (uint32_t i = 0; i < num; ++i)
        if (isnan(in[i]) && isnan(ql_bf16_to_float(x[i])) && isnan(ql_bf16_to_float(y[i]))) x[i] = y[i];
    expect_same_bits("bf16_round_row", k->name, x, y, num * sizeof *x);
    for (uint32_t i = 0; i < num; ++i) { /* what rounding is, by the distance to both neighbours */
        const float value = ql_bf16_to_float(y[i]);
        if (!isfinite(in[i]) || !isfinite(value) || fabsf(in[i]) < 0x1p-126f) continue;
        const float below = ql_bf16_to_float((uint16_t)(y[i] - 1)), above = ql_bf16_to_float((uint16_t)(y[i] + 1));
        const double error = fabs((double)value - (double)in[i]);
        ++num_checks;
        if (error <= fabs((double)below - (double)in[i]) && error <= fabs((double)above - (double)in[i]) &&
            (error < fabs((double)below - (double)in[i]) || (y[i] & 1) == 0) &&
            (error < fabs((double)above - (double)in[i]) || (y[i] & 1) == 0))
            continue;
        if (++num_failures < 20) printf("C bf16_round_row: %a becomes %a\n", (double)in[i], (double)value);
    }
    uint16_t *const every = guarded_bf16(num, 3);
    k->bf16_expand_row(every, a, num);
    c->bf16_expand_row(every, b, num);
    expect_same_bits("bf16_expand_row", k->name, a, b, num * sizeof *a);
    k->bf16_round_row(a, x, num); /* there and back; what is too small is 0 */
    ++num_checks;
    for (uint32_t i = 0; i < num; ++i) {
        const uint16_t want = every[i] & 0x7f80u ? every[i] : every[i] & 0x8000u;
        if (x[i] == want) continue;
        ++num_failures;
        printf("%s bf16: %#x comes back as %#x\n", k->name, every[i], x[i]);
        break;
    }

    const uint32_t channels = QL_BLOCK * (1 + random_below(4)), width = 1 + random_below(20);
    const size_t size = (size_t)channels * width;
    const int kind = (int)random_below(3);
    float *const add = guarded((size_t)channels * ((width + 1) / 2));
    uint16_t *const map = guarded_bf16(size, kind), *const want = guarded_bf16(size, 0);
    fill(add, (size_t)channels * ((width + 1) / 2), kind ? kind : 0);
    if (random_below(2))
        for (size_t i = 0; i < (size_t)channels * ((width + 1) / 2); ++i) add[i] = -add[i];
    memcpy(want, map, size * sizeof *map);
    k->bf16_add_row(add, map, channels, width);
    c->bf16_add_row(add, want, channels, width);
    expect_same_bits("bf16_add_row", k->name, map, want, size * sizeof *map);
}

/* The same bits, as the contract has it. The C version is also compared with exact sums. */
static void test_bf16_conv(const ql_kernels *c, const ql_kernels *k)
{
    static const uint32_t channels[] = {2, 16, 32, 48, 64};
    const uint32_t num_rows = 1 + random_below(QL_MAX_CONV_ROWS), in = channels[random_below(5)],
                   num_pixels = 1 + random_below(40), num_out = QL_BLOCK * (1 + random_below(12)),
                   num_k = (num_rows == 4 ? 2 : num_rows) * in, stride = num_rows == 2 ? num_k : in;
    const size_t row = (size_t)(num_pixels - 1) * stride + num_k, num = (size_t)num_pixels * num_out;
    const int is_extreme = random_below(3) == 0, kind = is_extreme ? 4 : (int)random_below(2);
    float *const bias = guarded(num_out), *const a = guarded(num), *const b = guarded(num);
    float *const exact = guarded(num), *const scale = guarded(num);
    uint16_t *const weights = guarded_bf16((size_t)num_rows * num_k * num_out, is_extreme ? 4 : 0);
    uint16_t *const x = guarded_bf16(num, 0), *const y = guarded_bf16(num, 0);
    ql_bf16_conv_row conv = {.weights = weights, .bias = bias, .num_rows = num_rows, .num_k = num_k, .stride = stride};
    fill(bias, num_out, is_extreme ? 2 : 0);
    for (uint32_t r = 0; r < num_rows; ++r) conv.rows[r] = guarded_bf16(row, kind);
    conv.relu = (int32_t)random_below(2);
    conv.num_pixels = num_pixels;
    conv.num_out = num_out;
    conv.sums = a;
    k->bf16_conv_row(&conv);
    conv.sums = b;
    c->bf16_conv_row(&conv);
    for (size_t i = 0; i < num; ++i) { /* of zeros the sign is not said */
        a[i] += 0.0f;
        b[i] += 0.0f;
    }
    expect_same_bits("bf16_conv_row, sums", k->name, a, b, num * sizeof *a);
    conv.sums = NULL;
    conv.out = x;
    k->bf16_conv_row(&conv);
    conv.out = y;
    c->bf16_conv_row(&conv);
    for (size_t i = 0; i < num; ++i) {
        x[i] = (uint16_t)(x[i] == 0x8000u ? 0 : x[i]);
        y[i] = (uint16_t)(y[i] == 0x8000u ? 0 : y[i]);
    }
    expect_same_bits("bf16_conv_row", k->name, x, y, num * sizeof *x);
    if (is_extreme || strcmp(k->name, "c") != 0) return;
    for (uint32_t p = 0; p < num_pixels; ++p)
        for (uint32_t o = 0; o < num_out; ++o) {
            double sum = (double)bias[o], sizes = fabs(sum);
            for (uint32_t i = 0; i < num_rows * num_k; ++i) {
                const size_t at = ((size_t)(o / QL_BLOCK) * num_rows * num_k / 2 + i / 2) * QL_BLOCK + o % QL_BLOCK;
                const double product = (double)ql_bf16_to_float(conv.rows[i / num_k][p * stride + i % num_k]) *
                                       (double)ql_bf16_to_float(weights[2 * at + i % 2]);
                sum += product;
                sizes += fabs(product);
            }
            exact[p * num_out + o] = (float)(conv.relu && sum < 0.0 ? 0.0 : sum);
            scale[p * num_out + o] = (float)sizes;
        }
    expect("bf16_conv_row against exact sums", k->name, b, exact, scale, num, 1.6e-6);
    for (size_t i = 0; i < num; ++i) a[i] = ql_bf16_to_float(y[i]);
    for (size_t i = 0; i < num; ++i) b[i] = ql_bf16_to_float(ql_bf16_from_float(b[i]));
    expect_same_bits("bf16_conv_row, rounded", k->name, a, b, num * sizeof *a);
}

/* A value must not depend on where in a row it stands: tiles would show. Compares a row with its tail computed alone. */
static void test_position(const ql_kernels *k)
{
    enum { IN = 16, OUT = 96, PIXELS = 37 };
    float *const in = guarded(IN * PIXELS), *const weights = guarded(IN * OUT), *const bias = guarded(OUT);
    float *const a = guarded(OUT * PIXELS), *const b = guarded(OUT * PIXELS);
    fill(in, IN * PIXELS, 0);
    fill(weights, IN * OUT, 0);
    fill(bias, OUT, 0);
    const uint32_t skip = random_below(PIXELS);
    ql_conv_row conv = {{in}, weights, bias, NULL, a, 1, IN, IN, PIXELS, OUT, 1};
    k->conv_row(&conv);
    conv.rows[0] = in + skip * IN;
    conv.out = b;
    conv.num_pixels = PIXELS - skip;
    k->conv_row(&conv);
    ++num_checks;
    if (memcmp(a + skip * OUT, b, (size_t)(PIXELS - skip) * OUT * sizeof *a) != 0) {
        ++num_failures;
        printf("%s conv_row: bits depend on the position in the row\n", k->name);
    }

    uint16_t *const narrow = guarded_bf16(IN * PIXELS, 0), *const pairs = guarded_bf16(IN * OUT, 0);
    uint16_t *const x = guarded_bf16(OUT * PIXELS, 0), *const y = guarded_bf16(OUT * PIXELS, 0);
    ql_bf16_conv_row bf16 = {{narrow}, pairs, bias, x, NULL, 1, IN, IN, PIXELS, OUT, 1};
    k->bf16_conv_row(&bf16);
    bf16.rows[0] = narrow + skip * IN;
    bf16.out = y;
    bf16.num_pixels = PIXELS - skip;
    k->bf16_conv_row(&bf16);
    ++num_checks;
    if (memcmp(x + skip * OUT, y, (size_t)(PIXELS - skip) * OUT * sizeof *x) != 0) {
        ++num_failures;
        printf("%s bf16_conv_row: bits depend on the position in the row\n", k->name);
    }
}

enum { IN = 48, PIXELS = 480 };

static void bench_bf16(const ql_kernels *k, const float *bias, int rounds)
{
    const uint16_t *const row = guarded_bf16(3 * IN * (PIXELS + 2), 0), *const weights = guarded_bf16(9 * IN * IN, 0);
    uint16_t *const out = guarded_bf16(IN * PIXELS, 0);
    const ql_bf16_conv_row conv = {{row, row + IN * (PIXELS + 2), row + 2 * IN * (PIXELS + 2)},
                                   weights,
                                   bias,
                                   out,
                                   NULL,
                                   3,
                                   3 * IN,
                                   IN,
                                   PIXELS,
                                   IN,
                                   1};
    k->bf16_conv_row(&conv);
    const double start = ql_clock_seconds();
    for (int i = 0; i < rounds; ++i) k->bf16_conv_row(&conv);
    const double seconds = (ql_clock_seconds() - start) / rounds;
    printf("%-10s the same in bfloat16:     %6.1f ns per pixel, %5.1f G multiply-adds/s\n", k->name,
           seconds / PIXELS * 1e9, 9.0 * IN * IN * PIXELS / seconds * 1e-9);
}

static void bench(const ql_kernels *k)
{
    float *const in = guarded(3 * IN * (PIXELS + 2)), *const weights = guarded(9 * IN * IN), *const bias = guarded(IN);
    float *const out = guarded(IN * PIXELS);
    fill(in, 3 * IN * (PIXELS + 2), 0);
    fill(weights, 9 * IN * IN, 0);
    fill(bias, IN, 0);
    const float *const row = in;
    const ql_conv_row conv = {{row, row + IN * (PIXELS + 2), row + 2 * IN * (PIXELS + 2)},
                              weights,
                              bias,
                              NULL,
                              out,
                              3,
                              3 * IN,
                              IN,
                              PIXELS,
                              IN,
                              1};
    const int rounds = strcmp(k->name, "c") == 0 ? 2 : 100;
    k->conv_row(&conv);
    const double start = ql_clock_seconds();
    for (int i = 0; i < rounds; ++i) k->conv_row(&conv);
    const double seconds = (ql_clock_seconds() - start) / rounds;
    printf("%-10s conv 3x3, 48 to 48 channels: %6.1f ns per pixel, %5.1f G multiply-adds/s\n", k->name,
           seconds / PIXELS * 1e9, 9.0 * IN * IN * PIXELS / seconds * 1e-9);
    if (k->bf16 != QL_BF16_NONE) bench_bf16(k, bias, rounds);
    release_all();
}

int main(int argc, char **argv)
{
    static const uint32_t sets[] = {0, QL_CPU_AVX2, QL_CPU_AVX2 | QL_CPU_AVX512,
                                    QL_CPU_AVX2 | QL_CPU_AVX512 | QL_CPU_AVX512_BF16, QL_CPU_NEON};
    const uint32_t have = ql_cpu_probe();
    const char *const seed = getenv("QUELL_SEED");
    if (seed) seed_state = strtoull(seed, NULL, 10);
    printf("seed %llu\n", (unsigned long long)seed_state);
    ql_kernels c, k;
    ql_kernels_init(&c, 0);
    for (size_t i = 0; i < sizeof sets / sizeof *sets; ++i) {
        if ((have & sets[i]) != sets[i]) continue;
        ql_kernels_init(&k, sets[i]);
        if (argc > 1 && strcmp(argv[1], "--bench") == 0) {
            bench(&k);
            continue;
        }
        for (int round = 0; round < ROUNDS; ++round) {
            test_conv(&c, &k);
            release_all();
            test_filter(&c, &k);
            release_all();
            test_upsample(&c, &k);
            release_all();
            test_partition(&c, &k);
            release_all();
            test_rows(&c, &k);
            release_all();
            test_softmax(&c, &k);
            release_all();
            test_gather(&c, &k);
            release_all();
            test_norm(&c, &k);
            release_all();
            test_expm1(&c, &k);
            release_all();
            test_bf16_rows(&c, &k);
            release_all();
            test_bf16_conv(&c, &k);
            release_all();
            test_position(&k);
            release_all();
        }
        printf("%s: done\n", k.name);
    }
    printf("%u checks, %u failures\n", num_checks, num_failures);
    return num_failures ? 1 : 0;
}
