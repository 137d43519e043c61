/* SPDX-License-Identifier: Apache-2.0 */
/*
 * Guided kernels applied, with their gradients, for training on a CPU. Called from training/native/__init__.py through
 * ctypes; training/models/pyramid.py holds the plain PyTorch form of the same operations, which the tests compare with.
 *
 *   logit_k(p) = table_k + [k is the centre] centre(p) - sum_e exp(scale_e(p)) * (embedding_e(p) - other_e(q_k))^2
 *   out_c(p)   = sum_k softmax_k(logit)(p) * source_c(q_k)
 *
 * All tensors are float, contiguous, planar. Nothing of 25 planes is ever stored for more than a row. Outside the image
 * everything is zero (values and validity alike, see pyramid.py).
 */
#include <math.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>

enum { MAX_TAPS = 25, MAX_DIMS = 16, BLOCK = 16 /* pixels; even */ };

/* Where the taps of pixel (x, y) lie: for a filter the pixel itself plus an offset, for an upsampling its parent
 * (x / 2, y / 2) plus an offset. */
typedef struct geometry {
    long width, height;               /* of the output */
    long source_width, source_height; /* of the source and of `other` */
    long radius;                      /* 2 for 5x5, 1 for 3x3 */
    long shift;                       /* 0: filter, 1: upsampling by 2 */
    long channels, dims;              /* of the source, of the embedding */
} geometry;

/* One image's share of every tensor; gradients are NULL on the way forward. */
typedef struct item {
    const float *source;    /* [channels][source_height][source_width] */
    const float *embedding; /* [dims][height][width] */
    const float *other;     /* [dims][source_height][source_width]; the embedding itself for a filter */
    const float *scale;     /* [dims][height][width] */
    const float *centre;    /* [height][width] or NULL */
    const float *table;     /* [1 or 4 parities][taps] */
    const float *grad;      /* [channels][height][width] */
    float *out;
    float *grad_source, *grad_embedding, *grad_other, *grad_scale, *grad_centre, *grad_table;
} item;

/* Sources are padded by the radius and, for an upsampling, doubled along x: then each tap of a row of pixels is a row.
 * BLOCK more, so that the last block of a row may be read and added to whole. */
static long padded_width(const geometry *g) { return ((g->source_width + 2 * g->radius) << g->shift) + BLOCK; }
static long padded_size(const geometry *g) { return padded_width(g) * (g->source_height + 2 * g->radius); }
static long num_taps(const geometry *g) { return (2 * g->radius + 1) * (2 * g->radius + 1); }

static void pad(const geometry *g, long planes, const float *source, float *padded)
{
    memset(padded, 0, (size_t)(planes * padded_size(g)) * sizeof *padded);
    for (long c = 0; c < planes; ++c)
        for (long y = 0; y < g->source_height; ++y) {
            const float *const from = source + (c * g->source_height + y) * g->source_width;
            float *const to =
                padded + c * padded_size(g) + (y + g->radius) * padded_width(g) + (g->radius << g->shift);
            if (g->shift == 0)
                memcpy(to, from, (size_t)g->source_width * sizeof *to);
            else
                for (long x = 0; x < g->source_width; ++x) to[2 * x] = to[2 * x + 1] = from[x];
        }
}

static void unpad_add(const geometry *g, long planes, const float *padded, float *target)
{
    for (long c = 0; c < planes; ++c)
        for (long y = 0; y < g->source_height; ++y) {
            const float *const from =
                padded + c * padded_size(g) + (y + g->radius) * padded_width(g) + (g->radius << g->shift);
            float *const to = target + (c * g->source_height + y) * g->source_width;
            if (g->shift == 0)
                for (long x = 0; x < g->source_width; ++x) to[x] += from[x];
            else
                for (long x = 0; x < g->source_width; ++x) to[x] += from[2 * x] + from[2 * x + 1];
        }
}

/* offset[k]: from the start of a padded plane to tap k of the first pixel of row y. */
static void tap_offsets(const geometry *g, long y, long *offset)
{
    const long side = 2 * g->radius + 1;
    for (long k = 0; k < side * side; ++k)
        offset[k] = ((y >> g->shift) + k / side) * padded_width(g) + ((k % side) << g->shift);
}

/* What follows works on blocks of pixels of a row, so that sums over taps stay in registers. */
typedef float block __attribute__((vector_size(BLOCK * sizeof(float))));
typedef int int_block __attribute__((vector_size(BLOCK * sizeof(int))));
typedef float loose_block __attribute__((vector_size(BLOCK * sizeof(float)), aligned(4)));

static block load(const float *p) { return *(const loose_block *)p; }

/* The first n lanes, the others 0. */
static block load_some(const float *p, long n)
{
    block v = {0};
    if (n >= BLOCK) return load(p);
    memcpy(&v, p, (size_t)n * sizeof *p);
    return v;
}

static void store_some(float *p, block v, long n)
{
    if (n >= BLOCK)
        *(loose_block *)p = v;
    else
        memcpy(p, &v, (size_t)n * sizeof *p);
}

static block larger(block a, block b)
{
    const int_block m = a > b;
    return (block)((m & (int_block)a) | (~m & (int_block)b));
}

/* exp(x) = 2^n 2^f, |f| <= 1/2, by a polynomial in f (least squares of the relative error, which stays below 2e-7);
 * -80 <= x < 80. */
static block exp_block(block x)
{
    const block y = larger(x, (block){0} - 80.0f) * 1.44269504f;
    const int_block n = __builtin_convertvector(y + 200.5f, int_block) - 200; /* to the nearest: the cast cuts off */
    const block f = y - __builtin_convertvector(n, block);
    block p = f * 0.00132669704f + 0.00967545975f;
    p = p * f + 0.0555074262f;
    p = p * f + 0.240221218f;
    p = p * f + 0.693146949f;
    p = p * f + 1.00000007f;
    return p * (block)((n + 127) << 23);
}

/* Sum of the lanes whose index is `parity` modulo `step`. */
static float sum_lanes(block v, long parity, long step)
{
    float sum = 0.0f;
    for (long i = parity; i < BLOCK; i += step) sum += v[i];
    return sum;
}

/* weights[k]: softmax of the logits of pixels x0 .. x0 + n - 1 of row y; sharpness[e] = exp(scale). */
static void weights_block(const geometry *g, const item *t, const float *other, const long *offset, long y, long x0,
                          long n, block *sharpness, block *weights)
{
    const long w = g->width, plane = w * g->height, taps = num_taps(g), at = y * w + x0;
    const float *const even = g->shift ? t->table + (y & 1) * 2 * taps : t->table, *const odd = even + taps * g->shift;
    block a[MAX_DIMS], odd_lane, top, sum = {0};
    for (long i = 0; i < BLOCK; ++i) odd_lane[i] = (float)(i & 1);
    for (long e = 0; e < g->dims; ++e) {
        sharpness[e] = exp_block(load_some(t->scale + e * plane + at, n));
        a[e] = load_some(t->embedding + e * plane + at, n);
    }
    for (long k = 0; k < taps; ++k) {
        block l = even[k] + odd_lane * (odd[k] - even[k]);
        if (t->centre && k == taps / 2) l += load_some(t->centre + at, n);
        const float *const b = other + offset[k] + x0;
        for (long e = 0; e < g->dims; ++e) {
            const block d = a[e] - load(b + e * padded_size(g));
            l -= sharpness[e] * d * d;
        }
        weights[k] = l;
        top = k == 0 ? l : larger(l, top);
    }
    for (long k = 0; k < taps; ++k) {
        weights[k] = exp_block(weights[k] - top);
        sum += weights[k];
    }
    sum = 1.0f / sum;
    for (long k = 0; k < taps; ++k) weights[k] *= sum;
}

static void forward_block(const geometry *g, const item *t, const float *padded, const long *offset, long y, long x0,
                          long n)
{
    block sharpness[MAX_DIMS], weights[MAX_TAPS];
    weights_block(g, t, padded + g->channels * padded_size(g), offset, y, x0, n, sharpness, weights);
    for (long c = 0; c < g->channels; ++c) {
        const float *const source = padded + c * padded_size(g) + x0;
        block sum = {0};
        for (long k = 0; k < num_taps(g); ++k) sum += weights[k] * load(source + offset[k]);
        store_some(t->out + (c * g->height + y) * g->width + x0, sum, n);
    }
}

static void forward_one(const geometry *g, const item *t)
{
    float *const padded = malloc((size_t)((g->channels + g->dims) * padded_size(g)) * sizeof *padded);
    pad(g, g->channels, t->source, padded);
    pad(g, g->dims, t->other, padded + g->channels * padded_size(g));
    for (long y = 0; y < g->height; ++y) {
        long offset[MAX_TAPS];
        tap_offsets(g, y, offset);
        for (long x0 = 0; x0 < g->width; x0 += BLOCK) forward_block(g, t, padded, offset, y, x0, g->width - x0);
    }
    free(padded);
}

/* What one row of pixels passes on to its taps, each plane with zeros on both sides. Taps gather it row by row: adding
 * block by block to addresses that overlap would have every load wait for the store before it. */
typedef struct row_share {
    long stride, margin;
    float *weight, *logit;          /* [taps]: softmax, gradient of the logit */
    float *grad;                    /* [channels] */
    float *sharpness, *sharp_place; /* [dims]: 2 sharpness, 2 sharpness * embedding */
    block table[2][MAX_TAPS];       /* gradient of the logits over all pixels, by parity of y */
} row_share;

static long share_stride(const geometry *g) { return g->width + 2 * (2 * g->radius << g->shift) + 2 * BLOCK; }

static row_share divide_share(const geometry *g, float *memory)
{
    const long stride = share_stride(g), taps = num_taps(g);
    row_share r = {.stride = stride, .margin = 2 * g->radius << g->shift, .weight = memory, .table = {{{0}}}};
    r.logit = r.weight + taps * stride;
    r.grad = r.logit + taps * stride;
    r.sharpness = r.grad + g->channels * stride;
    r.sharp_place = r.sharpness + g->dims * stride;
    return r;
}

static long share_floats(const geometry *g) { return (2 * num_taps(g) + g->channels + 2 * g->dims) * share_stride(g); }

/* The pixels' own gradients, and what their taps will need. Lanes beyond the row have no gradient. */
static void backward_block(const geometry *g, const item *t, const float *padded, row_share *r,
                           const long *offset, long y, long x0, long n)
{
    const long w = g->width, plane = w * g->height, size = padded_size(g), taps = num_taps(g), at = y * w + x0;
    const long place = r->margin + x0;
    block sharpness[MAX_DIMS], weights[MAX_TAPS], d[MAX_TAPS], mean = {0};
    weights_block(g, t, padded + g->channels * size, offset, y, x0, n, sharpness, weights);
    memset(d, 0, sizeof d);
    for (long c = 0; c < g->channels; ++c) {
        const float *const source = padded + c * size + x0;
        const block grad = load_some(t->grad + c * plane + at, n);
        store_some(r->grad + c * r->stride + place, grad, n);
        for (long k = 0; k < taps; ++k) d[k] += grad * load(source + offset[k]);
    }
    for (long k = 0; k < taps; ++k) mean += weights[k] * d[k];
    for (long k = 0; k < taps; ++k) { /* d becomes the gradient of the logits */
        d[k] = weights[k] * (d[k] - mean);
        r->table[y & 1][k] += d[k];
        store_some(r->weight + k * r->stride + place, weights[k], n);
        store_some(r->logit + k * r->stride + place, d[k], n);
    }
    if (t->centre) store_some(t->grad_centre + at, d[taps / 2], n);
    for (long e = 0; e < g->dims; ++e) {
        const float *const b = padded + (g->channels + e) * size + x0;
        const block a = load_some(t->embedding + e * plane + at, n), s = 2.0f * sharpness[e];
        block sum = {0}, squares = {0};
        for (long k = 0; k < taps; ++k) {
            const block difference = a - load(b + offset[k]), step = d[k] * difference;
            sum += step;
            squares += step * difference;
        }
        store_some(t->grad_embedding + e * plane + at, load_some(t->grad_embedding + e * plane + at, n) - s * sum, n);
        store_some(t->grad_scale + e * plane + at, -0.5f * s * squares, n);
        store_some(r->sharpness + e * r->stride + place, s, n);
        store_some(r->sharp_place + e * r->stride + place, s * a, n);
    }
}

/* Row i of the taps of row y: its sources' gradient, and that of the embedding where it stands for a tap's. */
static void gather_row(const geometry *g, const float *padded, float *padded_grad, const row_share *r, long y, long i)
{
    const long side = 2 * g->radius + 1, size = padded_size(g), start = ((y >> g->shift) + i) * padded_width(g);
    for (long x = 0; x < g->width + r->margin; x += BLOCK) {
        for (long c = 0; c < g->channels; ++c) {
            float *const to = padded_grad + c * size + start + x;
            block sum = load(to);
            for (long j = 0; j < side; ++j) {
                const long from = r->margin + x - (j << g->shift);
                sum += load(r->weight + (i * side + j) * r->stride + from) * load(r->grad + c * r->stride + from);
            }
            memcpy(to, &sum, sizeof sum);
        }
        for (long e = 0; e < g->dims; ++e) {
            float *const to = padded_grad + (g->channels + e) * size + start + x;
            block places = {0}, sharpness = {0};
            for (long j = 0; j < side; ++j) {
                const long from = r->margin + x - (j << g->shift);
                const block d = load(r->logit + (i * side + j) * r->stride + from);
                places += d * load(r->sharp_place + e * r->stride + from);
                sharpness += d * load(r->sharpness + e * r->stride + from);
            }
            const block b = load(padded + (g->channels + e) * size + start + x);
            const block sum = load(to) + places - b * sharpness;
            memcpy(to, &sum, sizeof sum);
        }
    }
}

/* The table's gradient, for an upsampling one by each parity of y and x. */
static void add_table(const geometry *g, const row_share *r, float *table)
{
    const long taps = num_taps(g), sides = 1 + g->shift;
    for (long y = 0; y < 2; ++y)
        for (long x = 0; x < sides; ++x)
            for (long k = 0; k < taps; ++k)
                table[(g->shift * (2 * y + x)) * taps + k] += sum_lanes(r->table[y][k], x, sides);
}

/* Adds to grad_embedding, grad_other and grad_table, which several items may share; writes the rest. */
static void backward_one(const geometry *g, const item *t)
{
    const size_t floats = (size_t)((g->channels + g->dims) * padded_size(g));
    float *const padded = malloc(floats * sizeof *padded), *const padded_grad = calloc(floats, sizeof *padded_grad);
    float *const memory = calloc((size_t)share_floats(g), sizeof *memory);
    row_share share = divide_share(g, memory);
    pad(g, g->channels, t->source, padded);
    pad(g, g->dims, t->other, padded + g->channels * padded_size(g));
    for (long y = 0; y < g->height; ++y) {
        long offset[MAX_TAPS];
        tap_offsets(g, y, offset);
        for (long x0 = 0; x0 < g->width; x0 += BLOCK)
            backward_block(g, t, padded, &share, offset, y, x0, g->width - x0);
        for (long i = 0; i < 2 * g->radius + 1; ++i) gather_row(g, padded, padded_grad, &share, y, i);
    }
    add_table(g, &share, t->grad_table);
    memset(t->grad_source, 0, (size_t)(g->channels * g->source_width * g->source_height) * sizeof(float));
    unpad_add(g, g->channels, padded_grad, t->grad_source);
    unpad_add(g, g->dims, padded_grad + g->channels * padded_size(g), t->grad_other);
    free(memory);
    free(padded_grad);
    free(padded);
}

/* n items; image[i] says whose embedding item i uses, group[i] whose table. sizes: geometry's members in their order, then
 * how many images and tables there are. */
static item make_item(const geometry *g, long i, const long *image, const long *group, const float *const *in)
{
    const long plane = g->width * g->height, source_plane = g->source_width * g->source_height;
    const long tables = (g->shift ? 4 : 1) * num_taps(g);
    return (item){.source = in[0] + i * g->channels * source_plane,
                  .embedding = in[1] + image[i] * g->dims * plane,
                  .other = in[2] + image[i] * g->dims * source_plane,
                  .scale = in[3] + i * g->dims * plane,
                  .centre = in[4] ? in[4] + i * plane : NULL,
                  .table = in[5] + group[i] * tables};
}

/* in: source [n], embedding [images], other [images], scale [n], centre [n] or NULL, table [groups]. */
void guided_forward(long n, const long *sizes, const long *image, const long *group, const float *const *in, float *out)
{
    const geometry g = {sizes[0], sizes[1], sizes[2], sizes[3], sizes[4], sizes[5], sizes[6], sizes[7]};
#pragma omp parallel for schedule(dynamic)
    for (long i = 0; i < n; ++i) {
        item t = make_item(&g, i, image, group, in);
        t.out = out + i * g.channels * g.width * g.height;
        forward_one(&g, &t);
    }
}

/* out: gradients in the order of `in`; those of embedding, other and table must be zero at first. Items of one image
 * share the first two and are done one after another; each image has a table of its own, added up at the end: sums have
 * one order, whatever the number of threads. */
void guided_backward(long n, const long *sizes, const long *image, const long *group, const float *const *in,
                     const float *grad, float *const *out)
{
    const geometry g = {sizes[0], sizes[1], sizes[2], sizes[3], sizes[4], sizes[5], sizes[6], sizes[7]};
    const long images = sizes[8], table = (g.shift ? 4 : 1) * num_taps(&g), tables = sizes[9] * table;
    const long plane = g.width * g.height, source_plane = g.source_width * g.source_height;
    float *const own_tables = calloc((size_t)(images * tables), sizeof *own_tables);
#pragma omp parallel for schedule(dynamic)
    for (long m = 0; m < images; ++m)
        for (long i = 0; i < n; ++i) {
            if (image[i] != m) continue;
            item t = make_item(&g, i, image, group, in);
            t.grad = grad + i * g.channels * plane;
            t.grad_source = out[0] + i * g.channels * source_plane;
            t.grad_embedding = out[1] + m * g.dims * plane;
            t.grad_other = out[2] + m * g.dims * source_plane;
            t.grad_scale = out[3] + i * g.dims * plane;
            t.grad_centre = out[4] ? out[4] + i * plane : NULL;
            t.grad_table = own_tables + m * tables + group[i] * table;
            backward_one(&g, &t);
        }
    for (long m = 0; m < images; ++m)
        for (long k = 0; k < tables; ++k) out[5][k] += own_tables[m * tables + k];
    free(own_tables);
}

static float from_bfloat16(uint16_t half)
{
    const uint32_t bits = (uint32_t)half << 16;
    float value;
    memcpy(&value, &bits, sizeof value);
    return value;
}

static uint16_t to_bfloat16(float value)
{
    uint32_t bits;
    memcpy(&bits, &value, sizeof bits);
    return (uint16_t)((bits + 0x7fff + (bits >> 16 & 1)) >> 16);
}

static float clamp(float value, float bound) { return value < -bound ? -bound : value > bound ? bound : value; }

/* A head's planes: from [fine * fine][height][width] of float or bfloat16, `from` counting such blocks, to
 * [height * fine][width * fine] of float, clamped to +-bound. fine 1 or 2. */
void take_planes(long count, long half, long fine, long height, long width, const long *from, const float *bound,
                 const void *source, float *const *to)
{
    const long cell = fine * fine, plane = height * width;
#pragma omp parallel for
    for (long i = 0; i < count; ++i)
        for (long k = 0; k < cell; ++k)
            for (long y = 0; y < height; ++y) {
                const long at = (from[i] * cell + k) * plane + y * width;
                float *const row = to[i] + ((y * fine + k / fine) * width) * fine + k % fine;
                if (half)
                    for (long x = 0; x < width; ++x)
                        row[x * fine] = clamp(from_bfloat16(((const uint16_t *)source)[at + x]), bound[i]);
                else
                    for (long x = 0; x < width; ++x) row[x * fine] = clamp(((const float *)source)[at + x], bound[i]);
            }
}

/* The way back: grad[i] (NULL: none) to the gradient of the source, where the source was within its bound. */
void give_planes(long count, long half, long fine, long height, long width, const long *from, const float *bound,
                 const void *source, const float *const *grad, void *given)
{
    const long cell = fine * fine, plane = height * width;
#pragma omp parallel for
    for (long i = 0; i < count; ++i) {
        if (!grad[i]) continue;
        for (long k = 0; k < cell; ++k)
            for (long y = 0; y < height; ++y) {
                const long at = (from[i] * cell + k) * plane + y * width;
                const float *const row = grad[i] + ((y * fine + k / fine) * width) * fine + k % fine;
                for (long x = 0; x < width; ++x) {
                    const float value = half ? from_bfloat16(((const uint16_t *)source)[at + x])
                                             : ((const float *)source)[at + x];
                    const float share = fabsf(value) <= bound[i] ? row[x * fine] : 0.0f;
                    if (half)
                        ((uint16_t *)given)[at + x] = to_bfloat16(share);
                    else
                        ((float *)given)[at + x] = share;
                }
            }
    }
}

/* Softmax over the four logits of a cell: w[4]. */
static void cell_weights(const float *upper, const float *lower, float *w)
{
    const float top = fmaxf(fmaxf(upper[0], upper[1]), fmaxf(lower[0], lower[1]));
    w[0] = expf(upper[0] - top), w[1] = expf(upper[1] - top), w[2] = expf(lower[0] - top), w[3] = expf(lower[1] - top);
    const float scale = 1.0f / (w[0] + w[1] + w[2] + w[3]);
    for (long k = 0; k < 4; ++k) w[k] *= scale;
}

/* values [n][channels][height][width], logits [n][height][width], out [n][channels][height / 2][width / 2]. */
void partition_forward(long n, long channels, long height, long width, const float *values, const float *logits,
                       float *out)
{
#pragma omp parallel for
    for (long i = 0; i < n; ++i)
        for (long y = 0; y < height / 2; ++y) {
            const float *const l = logits + (i * height + 2 * y) * width;
            for (long x = 0; x < width / 2; ++x) {
                float w[4];
                cell_weights(l + 2 * x, l + width + 2 * x, w);
                for (long c = 0; c < channels; ++c) {
                    const float *const v = values + ((i * channels + c) * height + 2 * y) * width + 2 * x;
                    out[((i * channels + c) * (height / 2) + y) * (width / 2) + x] =
                        w[0] * v[0] + w[1] * v[1] + w[2] * v[width] + w[3] * v[width + 1];
                }
            }
        }
}

void partition_backward(long n, long channels, long height, long width, const float *values, const float *logits,
                        const float *grad, float *grad_values, float *grad_logits)
{
#pragma omp parallel for
    for (long i = 0; i < n; ++i)
        for (long y = 0; y < height / 2; ++y) {
            const long at = (i * height + 2 * y) * width;
            for (long x = 0; x < width / 2; ++x) {
                const long cell = at + 2 * x, place[4] = {0, 1, width, width + 1};
                float w[4], d[4] = {0}, mean = 0.0f;
                cell_weights(logits + cell, logits + cell + width, w);
                for (long c = 0; c < channels; ++c) {
                    const long from = ((i * channels + c) * height + 2 * y) * width + 2 * x;
                    const float g = grad[((i * channels + c) * (height / 2) + y) * (width / 2) + x];
                    for (long k = 0; k < 4; ++k) {
                        d[k] += g * values[from + place[k]];
                        grad_values[from + place[k]] = w[k] * g;
                    }
                }
                for (long k = 0; k < 4; ++k) mean += w[k] * d[k];
                for (long k = 0; k < 4; ++k) grad_logits[cell + place[k]] = w[k] * (d[k] - mean);
            }
        }
}
