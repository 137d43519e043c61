/* SPDX-License-Identifier: Apache-2.0 */
/* Denoising through the public interface, and what its report says. A quell_report is a ql_report under its public
 * name. */
#include "denoise/denoise.h"

#include "api/context.h"
#include "api/structs.h"

#define OPTIONS_V1 QL_STRUCT_V1(quell_options, progress_user)
#define DGAN_OPTIONS_V1 QL_STRUCT_V1(quell_dgan_options, reserved0)
#define REPORT_LAYER_V1 QL_STRUCT_V1(quell_report_layer, mean_after)
#define REPORT_SUMMARY_V1 QL_STRUCT_V1(quell_report_summary, model_name)
#define KNOWN_FLAGS                                                                                                    \
    ((uint32_t)(QUELL_DENOISE_KEEP_NOISY | QUELL_DENOISE_NO_SKIP | QUELL_DENOISE_NO_BLEND | QUELL_DENOISE_DEBUG_LAYERS))

/* dgan: receives the settings that given points to, and options then points to it. */
static quell_status read_options(const quell_options *given, quell_options *options, quell_dgan_options *dgan,
                                 ql_error *err)
{
    QL_TRY(ql_struct_read(options, sizeof *options, OPTIONS_V1, given, "quell_options", err));
    if (options->reserved0 != 0 || options->reserved1 != 0)
        return ql_fail(err, QUELL_ERR_INVALID_ARGUMENT, "quell_options.reserved0 and reserved1 must be 0");
    if (options->flags & ~KNOWN_FLAGS) {
        return ql_fail(err, QUELL_ERR_UNSUPPORTED, "quell_options.flags has bits that this version does not know: %#x",
                       options->flags & ~KNOWN_FLAGS);
    }
    if (options->dgan) {
        QL_TRY(ql_struct_read(dgan, sizeof *dgan, DGAN_OPTIONS_V1, options->dgan, "quell_dgan_options", err));
        options->dgan = dgan;
    }
    return QUELL_OK;
}

/* A borrowed layer's result belongs into the caller's memory. Nothing in here can fail, so that the caller never sees
 * half of a result. */
static void give_back_borrowed(ql_frame *frame)
{
    for (uint32_t i = 0; i < frame->num_layers; i++) {
        ql_layer *layer = &frame->layers[i];
        if (!layer->result) continue;
        layer->is_denoised = 1;
        if (layer->owned || !layer->pixels.data) continue;

        const float *in = layer->result;
        for (uint32_t c = 0; c < layer->num_channels; c++) {
            for (uint32_t y = 0; y < frame->height; y++, in += frame->width) {
                ql_view_write_row(&layer->pixels, frame->width, c, y, in);
            }
        }
        ql_free(frame->memory, layer->result);
        layer->result = NULL;
    }
}

static quell_status run(ql_call *call, const ql_model *model, ql_frame *frame, const quell_options *given, int dry,
                        quell_report **out_report)
{
    quell_options options;
    quell_dgan_options dgan;
    if (!model || !frame) return ql_fail(call->err, QUELL_ERR_INVALID_ARGUMENT, "model or frame is NULL");
    if (dry && !out_report) return ql_fail(call->err, QUELL_ERR_INVALID_ARGUMENT, "out_report is NULL");
    QL_TRY(read_options(given, &options, &dgan, call->err));
    if (!dry) {
        call->env.progress = options.progress;
        call->env.progress_user = options.progress_user;
    }

    ql_report *report = NULL;
    QL_TRY(ql_denoise_frame(&call->env, &call->ctx->kernels, model, frame, &options, call->ctx->max_memory_bytes, dry,
                            &report, call->err));
    if (!dry) give_back_borrowed(frame);
    if (out_report) {
        *out_report = (quell_report *)report;
    } else {
        ql_report_destroy(report);
    }
    return QUELL_OK;
}

quell_status quell_denoise(quell_context *ctx, const quell_model *model, quell_frame *frame,
                           const quell_options *options, quell_report **out_report)
{
    ql_call call;
    if (out_report) *out_report = NULL;
    QL_TRY(ql_call_begin(ctx, &call));
    return ql_call_end(&call, run(&call, (const ql_model *)model, (ql_frame *)frame, options, 0, out_report));
}

quell_status quell_plan(quell_context *ctx, const quell_model *model, const quell_frame *frame,
                        const quell_options *options, quell_report **out_report)
{
    ql_call call;
    if (out_report) *out_report = NULL;
    QL_TRY(ql_call_begin(ctx, &call));
    return ql_call_end(&call, run(&call, (const ql_model *)model, (ql_frame *)frame, options, 1, out_report));
}

void quell_report_destroy(quell_report *report)
{
    ql_report_destroy((ql_report *)report);
}

quell_status quell_report_get_summary(const quell_report *report, quell_report_summary *summary)
{
    if (!report) return QUELL_ERR_INVALID_ARGUMENT;
    QL_TRY(ql_struct_check_out(summary, REPORT_SUMMARY_V1, "quell_report_summary", NULL));
    ql_struct_write(summary, &((const ql_report *)report)->summary, sizeof(quell_report_summary));
    return QUELL_OK;
}

quell_status quell_report_get_layer(const quell_report *report, uint32_t index, quell_report_layer *layer)
{
    const ql_report *r = (const ql_report *)report;
    if (!r || index >= r->summary.num_layers) return QUELL_ERR_INVALID_ARGUMENT;
    QL_TRY(ql_struct_check_out(layer, REPORT_LAYER_V1, "quell_report_layer", NULL));
    ql_struct_write(layer, &r->layers[index], sizeof r->layers[index]);
    return QUELL_OK;
}
