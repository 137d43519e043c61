/* SPDX-License-Identifier: Apache-2.0 */
/* Metrics through the public interface. */
#include "metrics/metrics.h"

#include "api/context.h"
#include "api/structs.h"

#define METRICS_V1 QL_STRUCT_V1(quell_metrics, num_non_finite)

typedef struct sized_view {
    ql_view view;
    uint32_t width, height;
} sized_view;

static quell_status check_same(const sized_view *image, const sized_view *reference, const char *what, ql_error *err)
{
    if (image->width == reference->width && image->height == reference->height &&
        image->view.num_channels == reference->view.num_channels) {
        return QUELL_OK;
    }
    return ql_fail(err, QUELL_ERR_SIZE_MISMATCH, "the image has %u x %u pixels of %u channels, %s %u x %u of %u",
                   image->width, image->height, image->view.num_channels, what, reference->width, reference->height,
                   reference->view.num_channels);
}

static quell_status compare(ql_call *call, const quell_image *image, const quell_image *reference_a,
                            const quell_image *reference_b, quell_metrics *out)
{
    sized_view x, a, b;
    ql_error *err = call->err;
    QL_TRY(ql_struct_check_out(out, METRICS_V1, "quell_metrics", err));
    QL_TRY(ql_image_read(image, "the image", &x.view, &x.width, &x.height, err));
    QL_TRY(ql_image_read(reference_a, "the reference", &a.view, &a.width, &a.height, err));
    QL_TRY(check_same(&x, &a, "the reference", err));
    if (reference_b) {
        QL_TRY(ql_image_read(reference_b, "the second reference", &b.view, &b.width, &b.height, err));
        QL_TRY(check_same(&x, &b, "the second reference", err));
    }
    if ((uint64_t)x.width * x.height > call->ctx->max_image_pixels) {
        return ql_fail(err, QUELL_ERR_LIMIT, "%u x %u pixels are over the limit of %llu", x.width, x.height,
                       (unsigned long long)call->ctx->max_image_pixels);
    }

    quell_metrics full = {.struct_size = sizeof full};
    QL_TRY(
        ql_metrics_compare(&call->env, x.width, x.height, &x.view, &a.view, reference_b ? &b.view : NULL, &full, err));
    ql_struct_write(out, &full, sizeof full);
    return QUELL_OK;
}

quell_status quell_compare(quell_context *ctx, const quell_image *image, const quell_image *reference_a,
                           const quell_image *reference_b, quell_metrics *out)
{
    ql_call call;
    QL_TRY(ql_call_begin(ctx, &call));
    return ql_call_end(&call, compare(&call, image, reference_a, reference_b, out));
}
