/* SPDX-License-Identifier: Apache-2.0 */
/* Shares of blocks, active cells, and rectangles round them. */
#include "plan/cells.h"

#include "base/log2.h"

#include <math.h>
#include <string.h>

/* Noise below this part of the mean cannot be told from detail, nor seen; from the second on all of the result may be
 * used. */
#define QUIET_NOISE 0.01f
#define VISIBLE_NOISE 0.03f
/* Networks are trained with 1 to 64 samples per pixel; at 8 times as many a finished render was asked for. */
#define TRAINED_SAMPLES 64.0f
#define FINISHED_SAMPLES 512.0f
/* Variance of one sample relative to the mean in the quiet quarter of a picture: 0.1 to 1.2 in the samples. A file states
 * the samples that were asked for; adaptive sampling and time limits take fewer, and the noise tells. */
#define QUIET_SAMPLE_VARIANCE 1.5f

static float ramp(float value, float from, float to)
{
    const float t = (value - from) / (to - from);
    return t < 0.0f ? 0.0f : t > 1.0f ? 1.0f : t;
}

float ql_plan_trust(float samples, float quiet_variance)
{
    if (quiet_variance * samples > QUIET_SAMPLE_VARIANCE) samples = QUIET_SAMPLE_VARIANCE / quiet_variance;
    if (!(samples > TRAINED_SAMPLES)) return 1.0f;
    return 1.0f - ramp(ql_log2f(samples), ql_log2f(TRAINED_SAMPLES), ql_log2f(FINISHED_SAMPLES));
}

float ql_plan_share(float variance, float samples)
{
    if (!isfinite(variance)) return 1.0f;
    if (samples >= FINISHED_SAMPLES && variance * FINISHED_SAMPLES <= QUIET_SAMPLE_VARIANCE) return 0.0f;
    return ramp(sqrtf(variance), QUIET_NOISE, VISIBLE_NOISE);
}

quell_status ql_plan_cells_create(ql_plan_cells *cells, uint32_t width, uint32_t height, ql_memory *memory,
                                  ql_error *err)
{
    *cells = (ql_plan_cells){.width = width, .height = height};
    cells->across = (width + QL_PLAN_CELL - 1) / QL_PLAN_CELL;
    cells->down = (height + QL_PLAN_CELL - 1) / QL_PLAN_CELL;
    cells->active = ql_alloc_zero(memory, cells->down, cells->across);
    cells->sums = ql_alloc_zero(memory, (size_t)cells->down + 1, ((size_t)cells->across + 1) * sizeof *cells->sums);
    if (cells->active == NULL || cells->sums == NULL)
        return ql_fail(err, QUELL_ERR_OUT_OF_MEMORY, "out of memory: map of what needs work");
    return QUELL_OK;
}

void ql_plan_cells_free(ql_plan_cells *cells, ql_memory *memory)
{
    ql_free(memory, cells->active);
    ql_free(memory, cells->sums);
    memset(cells, 0, sizeof *cells);
}

void ql_plan_cells_fill(ql_plan_cells *cells)
{
    cells->num_active = cells->across * cells->down;
    memset(cells->active, 1, cells->num_active);
}

static void activate(ql_plan_cells *cells, uint32_t x, uint32_t y)
{
    uint8_t *const cell = &cells->active[(size_t)y * cells->across + x];
    cells->num_active += *cell == 0;
    *cell = 1;
}

void ql_plan_cells_add(ql_plan_cells *cells, const float *share)
{
    enum { BLOCKS = QL_PLAN_CELL / QL_PLAN_BLOCK };
    const uint32_t across = (cells->width + QL_PLAN_BLOCK - 1) / QL_PLAN_BLOCK;
    const uint32_t down = (cells->height + QL_PLAN_BLOCK - 1) / QL_PLAN_BLOCK;
    for (uint32_t y = 0; y < down; ++y)
        for (uint32_t x = 0; x < across; ++x) {
            if (share[(size_t)y * across + x] <= 0.0f) continue;
            const uint32_t x0 = (x > 0 ? x - 1 : 0) / BLOCKS, x1 = (x + 1 < across ? x + 1 : x) / BLOCKS;
            const uint32_t y0 = (y > 0 ? y - 1 : 0) / BLOCKS, y1 = (y + 1 < down ? y + 1 : y) / BLOCKS;
            activate(cells, x0, y0);
            activate(cells, x1, y0);
            activate(cells, x0, y1);
            activate(cells, x1, y1);
        }
}

/* ---- Rectangles ---------------------------------------------------------------------------------------------------- */

/* In cells, both ends exclusive as in ql_plan_rect. */
typedef struct span {
    uint32_t x0, y0, x1, y1;
} span;

/* sums[y][x]: active cells above and left of (x, y), so that counting takes four reads. */
static void fill_sums(ql_plan_cells *cells)
{
    const size_t stride = (size_t)cells->across + 1;
    for (uint32_t y = 0; y < cells->down; ++y) {
        uint32_t row = 0;
        for (uint32_t x = 0; x < cells->across; ++x) {
            row += cells->active[(size_t)y * cells->across + x];
            cells->sums[(y + 1) * stride + x + 1] = cells->sums[y * stride + x + 1] + row;
        }
    }
}

static uint32_t count_active(const ql_plan_cells *cells, span s)
{
    const size_t stride = (size_t)cells->across + 1;
    const uint32_t *const top = cells->sums + s.y0 * stride, *const bottom = cells->sums + s.y1 * stride;
    return bottom[s.x1] - bottom[s.x0] - top[s.x1] + top[s.x0];
}

/* The smallest span round the active cells of s; empty (x1 == x0) without any. */
static span shrink(const ql_plan_cells *cells, span s)
{
    while (s.y0 < s.y1 && count_active(cells, (span){s.x0, s.y0, s.x1, s.y0 + 1}) == 0) ++s.y0;
    if (s.y0 == s.y1) return (span){0};
    while (count_active(cells, (span){s.x0, s.y1 - 1, s.x1, s.y1}) == 0) --s.y1;
    while (count_active(cells, (span){s.x0, s.y0, s.x0 + 1, s.y1}) == 0) ++s.x0;
    while (count_active(cells, (span){s.x1 - 1, s.y0, s.x1, s.y1}) == 0) --s.x1;
    return s;
}

static uint64_t length(uint32_t from, uint32_t to, uint32_t halo, uint32_t limit)
{
    const uint64_t first = (uint64_t)from * QL_PLAN_CELL, last = (uint64_t)to * QL_PLAN_CELL + halo;
    return (last < limit ? last : limit) - (first > halo ? first - halo : 0);
}

/* Pixels that are computed for a span. */
static uint64_t cost(const ql_plan_cells *cells, span s, uint32_t halo)
{
    if (s.x0 == s.x1) return 0;
    return length(s.x0, s.x1, halo, cells->width) * length(s.y0, s.y1, halo, cells->height);
}

/* The cheapest cut of s in two, both shrunk; 0 when none is a twentieth cheaper than s whole. */
static int cut(const ql_plan_cells *cells, span s, uint32_t halo, span out[2])
{
    uint64_t best = cost(cells, s, halo);
    best -= best / 20;
    int found = 0;
    for (int axis = 0; axis < 2; ++axis) {
        const uint32_t from = axis ? s.y0 : s.x0, to = axis ? s.y1 : s.x1;
        for (uint32_t at = from + 1; at < to; ++at) {
            span a = s, b = s;
            if (axis)
                a.y1 = b.y0 = at;
            else
                a.x1 = b.x0 = at;
            a = shrink(cells, a);
            b = shrink(cells, b);
            const uint64_t sum = cost(cells, a, halo) + cost(cells, b, halo);
            if (sum >= best) continue;
            best = sum;
            out[0] = a;
            out[1] = b;
            found = 1;
        }
    }
    return found;
}

uint32_t ql_plan_cells_cover(ql_plan_cells *cells, uint32_t halo, ql_plan_rect *rects, uint32_t capacity)
{
    span spans[QL_PLAN_MAX_RECTS];
    uint32_t num = 0;
    if (capacity > QL_PLAN_MAX_RECTS) capacity = QL_PLAN_MAX_RECTS;
    fill_sums(cells);
    const span whole = shrink(cells, (span){0, 0, cells->across, cells->down});
    if (whole.x0 == whole.x1 || capacity == 0) return 0;
    spans[num++] = whole;
    for (uint32_t i = 0; i < num;) {
        span halves[2];
        if (num == capacity || !cut(cells, spans[i], halo, halves)) {
            ++i;
            continue;
        }
        spans[i] = halves[0];
        spans[num++] = halves[1];
    }
    for (uint32_t i = 0; i < num; ++i) {
        const uint32_t x1 = spans[i].x1 * QL_PLAN_CELL, y1 = spans[i].y1 * QL_PLAN_CELL;
        rects[i] = (ql_plan_rect){spans[i].x0 * QL_PLAN_CELL, spans[i].y0 * QL_PLAN_CELL,
                                  x1 < cells->width ? x1 : cells->width, y1 < cells->height ? y1 : cells->height};
    }
    return num;
}
