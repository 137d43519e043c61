/* SPDX-License-Identifier: Apache-2.0 */
/* Errors pixel by pixel, and the luminance planes that the measures of structure work on. The formulas with two
 * references are those of quell.h: the references' noise is independent, so the mean of the product of both
 * differences is free of it. Single pixels may be negative and are never clipped. */
#include "metrics/metrics.h"

#include <math.h>
#include <string.h>

#define MAX_CHANNELS 3
#define REL_MSE_EPSILON 0.01 /* Rousselle et al. 2011, keeps dark pixels from deciding alone */

/* Rec. 709. */
static const double luminance_weights[MAX_CHANNELS] = {0.2126, 0.7152, 0.0722};

typedef struct band_sums {
    double mse, rel_mse, tone_mapped;
    uint64_t num_non_finite;
} band_sums;

typedef struct compare_job {
    uint32_t width, height, num_channels;
    const ql_view *image, *a, *b; /* b is never NULL */
    float *rows;                  /* [worker][3][width] */
    band_sums *bands;
    float *image_plane, *reference_plane; /* [height][width]: luminance after t */
} compare_job;

/* t(z) = z / (1 + z), negatives clamped to 0. */
static double tone_map(double z)
{
    return z > 0.0 ? z / (1.0 + z) : 0.0;
}

static double finite_or_zero(float value)
{
    return isfinite(value) ? (double)value : 0.0;
}

static double channel_weight(uint32_t channel, uint32_t num_channels)
{
    return num_channels == MAX_CHANNELS ? luminance_weights[channel] : 1.0 / (double)num_channels;
}

static void compare_row(const compare_job *job, uint32_t y, float *rows, band_sums *sums)
{
    const size_t width = job->width;
    float *x_row = rows, *a_row = rows + width, *b_row = rows + 2 * width;
    float *image_luminance = job->image_plane + y * width;
    float *reference_luminance = job->reference_plane + y * width;
    memset(image_luminance, 0, width * sizeof *image_luminance);
    memset(reference_luminance, 0, width * sizeof *reference_luminance);

    for (uint32_t c = 0; c < job->num_channels; c++) {
        const double weight = channel_weight(c, job->num_channels);
        ql_view_read_row(job->image, job->width, c, y, x_row);
        ql_view_read_row(job->a, job->width, c, y, a_row);
        ql_view_read_row(job->b, job->width, c, y, b_row);
        for (size_t i = 0; i < width; i++) {
            const double x = finite_or_zero(x_row[i]), a = finite_or_zero(a_row[i]), b = finite_or_zero(b_row[i]);
            const double m = 0.5 * (a + b);
            const double product = (x - a) * (x - b);
            const double tx = tone_map(x);
            sums->num_non_finite += isfinite(x_row[i]) ? 0 : 1;
            sums->mse += product;
            sums->rel_mse += product / (m * m + REL_MSE_EPSILON);
            sums->tone_mapped += (tx - tone_map(a)) * (tx - tone_map(b));
            image_luminance[i] += (float)(weight * tx);
            reference_luminance[i] += (float)(weight * tone_map(m));
        }
    }
}

static void compare_band(void *user, uint32_t task, uint32_t worker)
{
    compare_job *job = user;
    float *rows = job->rows + (size_t)worker * 3 * job->width;
    const uint32_t begin = task * QL_METRICS_BAND;
    for (uint32_t y = begin; y < job->height && y - begin < QL_METRICS_BAND; y++) {
        compare_row(job, y, rows, &job->bands[task]);
    }
}

static void sum_bands(const compare_job *job, uint32_t num_bands, quell_metrics *out)
{
    band_sums total = {0};
    for (uint32_t i = 0; i < num_bands; i++) {
        total.mse += job->bands[i].mse;
        total.rel_mse += job->bands[i].rel_mse;
        total.tone_mapped += job->bands[i].tone_mapped;
        total.num_non_finite += job->bands[i].num_non_finite;
    }
    const double num_values = (double)job->width * (double)job->height * (double)job->num_channels;
    const double tone_mapped = total.tone_mapped / num_values;
    out->mse = total.mse / num_values;
    out->rel_mse = total.rel_mse / num_values;
    /* With two references the mean may come out at or below 0: no error that they could show. */
    out->psnr = tone_mapped > 0.0 ? -10.0 * log10(tone_mapped) : INFINITY;
    out->num_non_finite = total.num_non_finite;
}

quell_status ql_metrics_compare(ql_env *env, uint32_t width, uint32_t height, const ql_view *image,
                                const ql_view *reference_a, const ql_view *reference_b, quell_metrics *out,
                                ql_error *err)
{
    const uint32_t num_bands = (height + QL_METRICS_BAND - 1) / QL_METRICS_BAND;
    compare_job job = {
        .width = width,
        .height = height,
        .num_channels = image->num_channels < MAX_CHANNELS ? image->num_channels : MAX_CHANNELS,
        .image = image,
        .a = reference_a,
        .b = reference_b ? reference_b : reference_a,
    };
    quell_status status = QUELL_ERR_OUT_OF_MEMORY;
    size_t num_pixels, num_rows;
    if (ql_mul_size(width, height, &num_pixels) != 0 || ql_mul_size(ql_pool_num_threads(env->pool), 3, &num_rows) != 0)
        goto fail;
    job.rows = ql_alloc(env->memory, num_rows, (size_t)width * sizeof *job.rows);
    job.bands = ql_alloc_zero(env->memory, num_bands, sizeof *job.bands);
    job.image_plane = ql_alloc(env->memory, num_pixels, sizeof *job.image_plane);
    job.reference_plane = ql_alloc(env->memory, num_pixels, sizeof *job.reference_plane);
    if (!job.rows || !job.bands || !job.image_plane || !job.reference_plane) goto fail;

    QL_TRY_GOTO(ql_env_run(env, num_bands, compare_band, &job));
    sum_bands(&job, num_bands, out);
    QL_TRY_GOTO(ql_metrics_ssim(env, width, height, job.image_plane, job.reference_plane, &out->ssim, err));
    QL_TRY_GOTO(ql_metrics_gmsd(env, width, height, job.image_plane, job.reference_plane, &out->gmsd, err));

fail:
    ql_free(env->memory, job.reference_plane);
    ql_free(env->memory, job.image_plane);
    ql_free(env->memory, job.bands);
    ql_free(env->memory, job.rows);
    if (status == QUELL_ERR_OUT_OF_MEMORY) {
        return ql_fail(err, status, "no memory to compare images of %u x %u pixels", width, height);
    }
    return status;
}
