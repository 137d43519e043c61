/* SPDX-License-Identifier: Apache-2.0 */
/* Puts the weight files into the library's read-only data, so that one file is all that an add-on ships. */
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

EMBED("ql_balanced", "quell-balanced.qwt");
EMBED("ql_dgan_kpn", "dgan-kpn.qwt");

extern const uint8_t ql_balanced_begin[], ql_balanced_end[], ql_dgan_kpn_begin[], ql_dgan_kpn_end[];

const ql_builtin *ql_builtin_get(uint32_t index)
{
    static const ql_builtin builtins[] = {{"quell-balanced", ql_balanced_begin, ql_balanced_end},
                                          {"dgan-kpn", ql_dgan_kpn_begin, ql_dgan_kpn_end}};
    return index < sizeof builtins / sizeof *builtins ? &builtins[index] : NULL;
}
