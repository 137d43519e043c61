/* SPDX-License-Identifier: Apache-2.0 */
/* Weight files inside the library. */
#ifndef QL_MODELS_BUILTIN_H
#define QL_MODELS_BUILTIN_H

#include <stddef.h>
#include <stdint.h>

typedef struct ql_builtin {
    const char *name, *file; /* "quell-balanced", "quell-balanced.qwt" */
    const uint8_t *begin, *end;
} ql_builtin;

const ql_builtin *ql_builtin_get(uint32_t index); /* NULL past the end; 0 is the default */
const ql_builtin *ql_builtin_find(const char *name);
const char *ql_builtin_folder(void); /* where the files were when the library was built */

#endif
