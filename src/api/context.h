/* SPDX-License-Identifier: Apache-2.0 */
/* What stands behind quell_context, and the frame round each call on it. */
#ifndef QL_API_CONTEXT_H
#define QL_API_CONTEXT_H

#include "base/memory.h"
#include "base/pool.h"
#include "base/status.h"
#include "kernels/kernels.h"

#include <fenv.h>
#include <stdatomic.h>

struct quell_context {
    ql_memory memory;      /* working memory of the running call, with the caller's limit */
    ql_memory pool_memory; /* apart, so that a small limit does not eat up its own pool */
    ql_pool *pool;
    ql_kernels kernels;
    atomic_int cancel;
    ql_error error;
    uint64_t max_memory_bytes;
    uint64_t max_image_pixels;
    quell_log_fn log;
    void *log_user;
};

/* One running call. */
typedef struct ql_call {
    quell_context *ctx;
    ql_error *err;
    ql_env env;
    fenv_t fp_mode; /* the caller's */
} ql_call;

/* Forgets the last error and any cancel, and sets the default floating-point mode: a host program may round otherwise
 * or flush denormals, and results must not depend on it. Returns QUELL_ERR_INVALID_ARGUMENT when ctx is NULL, else
 * QUELL_OK; ql_call_end must follow then. */
quell_status ql_call_begin(quell_context *ctx, ql_call *call);

/* Gives the caller's floating-point mode back and returns status, with a sentence where nobody wrote one. */
quell_status ql_call_end(ql_call *call, quell_status status);

#endif
