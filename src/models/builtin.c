/* SPDX-License-Identifier: Apache-2.0 */
/* Puts weights/quell-balanced.qwt into the library's read-only data, so that one file is all that an add-on ships. */
#include "models/builtin.h"

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

__asm__(SECTION ".balign 64\n"
                ".globl " SYMBOL("ql_balanced_begin") "\n"
                                                      ".globl " SYMBOL("ql_balanced_end") "\n" SYMBOL(
                                                          "ql_balanced_begin") ":\n"
                                                                               ".incbin \"" QL_WEIGHTS_DIR
                                                                               "/quell-balanced.qwt\"\n" SYMBOL(
                                                                                   "ql_balanced_end") ":\n"
                                                                                                      ".byte 0\n"
                                                                                                      ".text\n");

extern const uint8_t ql_balanced_begin[], ql_balanced_end[];

const ql_builtin *ql_builtin_get(uint32_t index)
{
    static const ql_builtin builtins[] = {{"quell-balanced", ql_balanced_begin, ql_balanced_end}};
    return index < sizeof builtins / sizeof *builtins ? &builtins[index] : NULL;
}
