/* SPDX-License-Identifier: Apache-2.0 */
/* Puts the weight files into the library's read-only data, so that one file is all that an add-on ships.
 *
 * The Makefile passes QL_WEIGHTS_DIR, their folder, and writes builtin_list.h, with a line QL_BUILTIN(id, "name") for
 * each NAME.qwt in it, the default first. */
#include "models/builtin.h"

#include <string.h>

#ifndef QL_WEIGHTS_DIR
#error "define QL_WEIGHTS_DIR, the folder of the weight files"
#endif

#if defined(__APPLE__)
#define SECTION ".const_data\n"
#define SYMBOL(name) "_" name
#elif defined(_WIN32)
#define SECTION ".section .rdata,\"dr\"\n"
#define SYMBOL(name) name
#else
#define SECTION ".section .rodata\n"
#define SYMBOL(name) name
#endif

/* clang-format off */
#define EMBED(symbol, file)                                                                                            \
    __asm__(SECTION ".balign 64\n"                                                                                     \
            ".globl " SYMBOL(symbol "_begin") "\n"                                                                     \
            ".globl " SYMBOL(symbol "_end") "\n"                                                                       \
            SYMBOL(symbol "_begin") ":\n"                                                                              \
            ".incbin \"" QL_WEIGHTS_DIR "/" file "\"\n"                                                                \
            SYMBOL(symbol "_end") ":\n"                                                                                \
            ".byte 0\n"                                                                                                \
            ".text\n")
/* clang-format on */

#define QL_BUILTIN(id, name) EMBED("ql_builtin_" #id, name ".qwt");
#include "builtin_list.h"
#undef QL_BUILTIN

#define QL_BUILTIN(id, name) extern const uint8_t ql_builtin_##id##_begin[], ql_builtin_##id##_end[];
#include "builtin_list.h"
#undef QL_BUILTIN

const ql_builtin *ql_builtin_get(uint32_t index)
{
    static const ql_builtin builtins[] = {
#define QL_BUILTIN(id, name) {name, name ".qwt", ql_builtin_##id##_begin, ql_builtin_##id##_end},
#include "builtin_list.h"
#undef QL_BUILTIN
    };
    return index < sizeof builtins / sizeof *builtins ? &builtins[index] : NULL;
}

const ql_builtin *ql_builtin_find(const char *name)
{
    const ql_builtin *builtin = NULL;
    for (uint32_t i = 0; (builtin = ql_builtin_get(i)) != NULL; ++i)
        if (strcmp(builtin->name, name) == 0) return builtin;
    return NULL;
}

const char *ql_builtin_folder(void)
{
    return QL_WEIGHTS_DIR;
}
