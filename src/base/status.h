/* SPDX-License-Identifier: Apache-2.0 */
/* Failures inside the library: a status to branch on and one sentence to read. An ql_error belongs to one caller; workers
 * fill their own, and the lowest task's wins, so that the message does not depend on timing. */
#ifndef QL_BASE_STATUS_H
#define QL_BASE_STATUS_H

#include "quell.h"

#define QL_ERROR_TEXT_BYTES 1024

typedef struct ql_error {
    quell_status status;
    char text[QL_ERROR_TEXT_BYTES];
} ql_error;

/* Stores status and the formatted sentence in err (NULL allowed) and returns status, so that callers write
 * `return ql_fail(err, QUELL_ERR_..., "...", ...)`. Texts are UTF-8, without newline. */
quell_status ql_fail(ql_error *err, quell_status status, const char *format, ...)
#if defined(__GNUC__)
    __attribute__((format(printf, 3, 4)))
#endif
    ;

/* Forwards a failure. */
#define QL_TRY(call)                                                                                                   \
    do {                                                                                                               \
        const quell_status ql_try_status = (call);                                                                     \
        if (ql_try_status != QUELL_OK) return ql_try_status;                                                           \
    } while (0)

/* The same where something must be released at a `fail:` label; `status` is the function's variable. */
#define QL_TRY_GOTO(call)                                                                                              \
    do {                                                                                                               \
        status = (call);                                                                                               \
        if (status != QUELL_OK) goto fail;                                                                             \
    } while (0)

#endif
