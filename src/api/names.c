/* SPDX-License-Identifier: Apache-2.0 */
/* Names of numbers: versions, status codes, roles. */
#include "frame/roles.h"

#include "quell.h"

#define TEXT_(x) #x
#define TEXT(x) TEXT_(x)

#define STATUS_TABLE(X)                                                                                                \
    X(QUELL_OK)                                                                                                        \
    X(QUELL_ERR_INVALID_ARGUMENT)                                                                                      \
    X(QUELL_ERR_OUT_OF_MEMORY)                                                                                         \
    X(QUELL_ERR_CANCELLED)                                                                                             \
    X(QUELL_ERR_FILE_NOT_FOUND)                                                                                        \
    X(QUELL_ERR_FILE_READ)                                                                                             \
    X(QUELL_ERR_FILE_WRITE)                                                                                            \
    X(QUELL_ERR_NOT_EXR)                                                                                               \
    X(QUELL_ERR_UNSUPPORTED)                                                                                           \
    X(QUELL_ERR_NO_LAYER)                                                                                              \
    X(QUELL_ERR_SIZE_MISMATCH)                                                                                         \
    X(QUELL_ERR_BAD_MODEL)                                                                                             \
    X(QUELL_ERR_LIMIT)                                                                                                 \
    X(QUELL_ERR_INTERNAL)

const char *quell_status_name(quell_status status)
{
    switch (status) {
#define CASE(name)                                                                                                     \
    case name: return #name;
        STATUS_TABLE(CASE)
#undef CASE
    default: return "QUELL_ERR_UNKNOWN";
    }
}

const char *quell_version_string(void)
{
    return TEXT(QUELL_VERSION_MAJOR) "." TEXT(QUELL_VERSION_MINOR) "." TEXT(QUELL_VERSION_PATCH);
}

uint32_t quell_version_number(void)
{
    return QUELL_VERSION_MAJOR * 10000u + QUELL_VERSION_MINOR * 100u + QUELL_VERSION_PATCH;
}

const char *quell_role_name(int32_t role)
{
    return ql_role_name(role);
}
