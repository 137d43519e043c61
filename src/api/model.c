/* SPDX-License-Identifier: Apache-2.0 */
/* Models. A quell_model is a ql_model under its public name. */
#include "models/model.h"
#include "models/quality.h"

#include "api/context.h"
#include "api/structs.h"

#define INFO_V1 QL_STRUCT_V1(quell_model_info, macs_per_pixel_all)

quell_status quell_model_open(quell_context *ctx, const char *name_or_path, quell_model **out)
{
    ql_call call;
    if (out) *out = NULL;
    QL_TRY(ql_call_begin(ctx, &call));
    if (!out) return ql_call_end(&call, ql_fail(call.err, QUELL_ERR_INVALID_ARGUMENT, "out is NULL"));

    ql_model *model = NULL;
    const quell_status status = ql_model_open(name_or_path, &model, call.err);
    if (status == QUELL_OK) *out = (quell_model *)model;
    return ql_call_end(&call, status);
}

quell_status quell_model_open_quality(quell_context *ctx, int32_t quality, quell_model **out)
{
    ql_call call;
    if (out) *out = NULL;
    QL_TRY(ql_call_begin(ctx, &call));
    if (!out) return ql_call_end(&call, ql_fail(call.err, QUELL_ERR_INVALID_ARGUMENT, "out is NULL"));

    ql_model *model = NULL;
    const quell_status status = ql_quality_open(quality, &model, call.err);
    if (status == QUELL_OK) *out = (quell_model *)model;
    return ql_call_end(&call, status);
}

quell_status quell_model_open_memory(quell_context *ctx, const void *data, size_t size_bytes, quell_model **out)
{
    ql_call call;
    if (out) *out = NULL;
    QL_TRY(ql_call_begin(ctx, &call));
    if (!out || !data) {
        return ql_call_end(&call, ql_fail(call.err, QUELL_ERR_INVALID_ARGUMENT, "data or out is NULL"));
    }

    ql_model *model = NULL;
    const quell_status status = ql_model_open_memory(data, size_bytes, &model, call.err);
    if (status == QUELL_OK) *out = (quell_model *)model;
    return ql_call_end(&call, status);
}

void quell_model_destroy(quell_model *model)
{
    ql_model_destroy((ql_model *)model);
}

quell_status quell_model_get_info(const quell_model *model, quell_model_info *info)
{
    if (!model) return QUELL_ERR_INVALID_ARGUMENT;
    QL_TRY(ql_struct_check_out(info, INFO_V1, "quell_model_info", NULL));
    quell_model_info full = {.struct_size = sizeof full};
    ql_model_get_info((const ql_model *)model, &full);
    ql_struct_write(info, &full, sizeof full);
    return QUELL_OK;
}

const char *quell_model_builtin_name(uint32_t index)
{
    return ql_model_builtin_name(index);
}

const char *quell_quality_name(int32_t quality)
{
    return ql_quality_name(quality);
}
