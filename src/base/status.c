/* SPDX-License-Identifier: Apache-2.0 */
/* Formats the sentence of a failure. Knows nothing of contexts: who keeps the error is the caller's business. */
#include "base/status.h"

#include <stdarg.h>
#include <stdio.h>
#include <string.h>

/* A sentence that was cut must not end inside a UTF-8 character: file names go into it as they are. */
static void trim_partial_character(char *text)
{
    size_t end = strlen(text);
    size_t start = end;
    while (start > 0 && ((unsigned char)text[start - 1] & 0xc0u) == 0x80u) start--;
    if (start == 0) return;

    const unsigned char lead = (unsigned char)text[start - 1];
    const size_t expected = lead >= 0xf0u ? 3 : lead >= 0xe0u ? 2 : lead >= 0xc0u ? 1 : 0;
    if (end - start < expected) text[start - 1] = '\0';
}

quell_status ql_fail(ql_error *err, quell_status status, const char *format, ...)
{
    if (!err) return status;

    va_list args;
    va_start(args, format);
    const int length = vsnprintf(err->text, sizeof err->text, format, args);
    va_end(args);
    if (length < 0) err->text[0] = '\0';
    if (length >= (int)sizeof err->text) trim_partial_character(err->text);

    /* One line, whatever a file name contains. */
    for (char *c = err->text; *c; c++) {
        if ((unsigned char)*c < 0x20u || *c == 0x7f) *c = '?';
    }
    err->status = status;
    return status;
}
