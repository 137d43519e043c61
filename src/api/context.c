/* SPDX-License-Identifier: Apache-2.0 */
/* Contexts: threads, memory limit, kernels, last error. Knows nothing of images. */
#include "api/context.h"

#include "api/structs.h"
#include "base/cpu.h"
#include "base/os.h"

#include <stdlib.h>
#include <string.h>

#define OPTIONS_V1 QL_STRUCT_V1(quell_context_options, log_user)
#define MAX_THREADS 1024u
#define DEFAULT_MEMORY_BYTES (UINT64_C(4) << 30)
#define DEFAULT_IMAGE_PIXELS (UINT64_C(1) << 30)

static quell_status choose_cpu(int32_t wanted, uint32_t *bits, ql_error *err)
{
    const uint32_t present = ql_cpu_probe();
    const uint32_t avx512 = QL_CPU_AVX2 | QL_CPU_AVX512, bf16 = avx512 | QL_CPU_AVX512_BF16;
    uint32_t allowed = 0, needed = 0;
    switch (wanted) {
    case QUELL_CPU_AUTO: allowed = present; break;
    case QUELL_CPU_C: break;
    case QUELL_CPU_AVX2: allowed = needed = QL_CPU_AVX2; break;
    case QUELL_CPU_AVX512: allowed = avx512, needed = QL_CPU_AVX512; break;
    case QUELL_CPU_AVX512BF16: allowed = needed = bf16; break;
    case QUELL_CPU_NEON: allowed = needed = QL_CPU_NEON; break;
    default: return ql_fail(err, QUELL_ERR_INVALID_ARGUMENT, "quell_context_options.cpu: no such kernels (%d)", wanted);
    }
    if ((present & needed) != needed) {
        return ql_fail(err, QUELL_ERR_UNSUPPORTED, "this machine lacks the instructions of the kernels asked for (%d)",
                       wanted);
    }
    *bits = present & allowed;
    return QUELL_OK;
}

static quell_status read_options(const quell_context_options *given, quell_context_options *options, ql_error *err)
{
    QL_TRY(ql_struct_read(options, sizeof *options, OPTIONS_V1, given, "quell_context_options", err));
    if (options->reserved0 != 0) {
        return ql_fail(err, QUELL_ERR_INVALID_ARGUMENT, "quell_context_options.reserved0 must be 0");
    }
    if (options->num_threads > MAX_THREADS) {
        return ql_fail(err, QUELL_ERR_INVALID_ARGUMENT, "%u threads asked for; %u are allowed", options->num_threads,
                       MAX_THREADS);
    }
    if (options->num_threads == 0) {
        const uint32_t cores = ql_os_num_cores();
        options->num_threads = cores < MAX_THREADS ? cores : MAX_THREADS;
    }
    if (options->max_memory_bytes == 0) options->max_memory_bytes = DEFAULT_MEMORY_BYTES;
    if (options->max_image_pixels == 0) options->max_image_pixels = DEFAULT_IMAGE_PIXELS;
    return QUELL_OK;
}

/* Threads inherit the floating-point mode of the one that makes them. */
static quell_status create_pool(quell_context *ctx, uint32_t num_threads, ql_error *err)
{
    fenv_t before;
    ql_os_set_default_fp_mode(&before);
    const quell_status status = ql_pool_create(num_threads, &ctx->pool_memory, &ctx->pool, err);
    fesetenv(&before);
    return status;
}

static quell_status create_context(const quell_context_options *given, quell_context **out, ql_error *err)
{
    quell_context_options options;
    uint32_t cpu = 0;
    QL_TRY(read_options(given, &options, err));
    QL_TRY(choose_cpu(options.cpu, &cpu, err));

    quell_context *ctx = calloc(1, sizeof *ctx); /* the counted memory lives inside it */
    if (!ctx) return ql_fail(err, QUELL_ERR_OUT_OF_MEMORY, "no memory for a context");
    ql_memory_init(&ctx->memory, options.max_memory_bytes);
    ctx->memory.keeps_spare = 1; /* within a call: ql_call_end gives them back */
    ql_memory_init(&ctx->pool_memory, 0);
    atomic_init(&ctx->cancel, 0);
    ql_kernels_init(&ctx->kernels, cpu);
    ctx->max_memory_bytes = options.max_memory_bytes;
    ctx->max_image_pixels = options.max_image_pixels;
    ctx->log = options.log;
    ctx->log_user = options.log_user;

    const quell_status status = create_pool(ctx, options.num_threads, err);
    if (status != QUELL_OK) {
        free(ctx);
        return status;
    }
    *out = ctx;
    return QUELL_OK;
}

quell_status quell_context_create(const quell_context_options *options, quell_context **out)
{
    if (!out) return QUELL_ERR_INVALID_ARGUMENT;
    *out = NULL;
    ql_error err = {QUELL_OK, ""};
    const quell_status status = create_context(options, out, &err);
    /* There is no context yet to hold the sentence. */
    if (status != QUELL_OK && options && options->struct_size >= OPTIONS_V1 && options->log) {
        options->log(options->log_user, QUELL_LOG_WARNING, err.text);
    }
    return status;
}

void quell_context_destroy(quell_context *ctx)
{
    if (!ctx) return;
    ql_pool_destroy(ctx->pool);
    free(ctx);
}

const char *quell_context_last_error(const quell_context *ctx)
{
    return ctx ? ctx->error.text : "";
}

const char *quell_context_cpu_name(const quell_context *ctx)
{
    return ctx ? ctx->kernels.name : "";
}

uint32_t quell_context_num_threads(const quell_context *ctx)
{
    return ctx ? ql_pool_num_threads(ctx->pool) : 0;
}

void quell_cancel(quell_context *ctx)
{
    if (ctx) atomic_store(&ctx->cancel, 1);
}

quell_status ql_call_begin(quell_context *ctx, ql_call *call)
{
    if (!ctx) return QUELL_ERR_INVALID_ARGUMENT;
    ctx->error.status = QUELL_OK;
    ctx->error.text[0] = '\0';
    atomic_store(&ctx->cancel, 0);
    *call = (ql_call){
        .ctx = ctx,
        .err = &ctx->error,
        .env = {.memory = &ctx->memory,
                .pool = ctx->pool,
                .cancel = &ctx->cancel,
                .progress_to = 1.0,
                .log = ctx->log,
                .log_user = ctx->log_user},
    };
    atomic_store(&ctx->memory.peak_bytes, atomic_load(&ctx->memory.used_bytes));
    ql_os_set_default_fp_mode(&call->fp_mode);
    return QUELL_OK;
}

quell_status ql_call_end(ql_call *call, quell_status status)
{
    ql_memory_drop_spare(&call->ctx->memory);
    fesetenv(&call->fp_mode);
    if (status == QUELL_OK) {
        call->err->text[0] = '\0'; /* a failure on the way that was made good again */
    } else if (status == QUELL_ERR_CANCELLED) {
        return ql_fail(call->err, status, "cancelled");
    } else if (call->err->text[0] == '\0') {
        return ql_fail(call->err, status, "%s", quell_status_name(status));
    }
    call->err->status = status;
    return status;
}
