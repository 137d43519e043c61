/* SPDX-License-Identifier: Apache-2.0 */
/* Reading and filling the caller's sized structs: the one place that knows how they grow. */
#ifndef QL_API_STRUCTS_H
#define QL_API_STRUCTS_H

#include "base/status.h"
#include "frame/frame.h"

#include <stddef.h>

/* Size of a struct as of the first version that had it: what a caller must at least pass. `last` is the last member of
 * that version, and stays so when members are appended. */
#define QL_STRUCT_V1(type, last) (offsetof(type, last) + sizeof(((type *)0)->last))

/* Copies the caller's struct into full, a zeroed local of full_bytes. A NULL gives all defaults. A struct shorter than
 * its first version is QUELL_ERR_INVALID_ARGUMENT; one from a newer header must have zeros in the part that this
 * library does not know, else QUELL_ERR_UNSUPPORTED. name: of the type, for the sentence. */
quell_status ql_struct_read(void *full, size_t full_bytes, size_t v1_bytes, const void *given, const char *name,
                            ql_error *err);

/* Whether the caller's struct can be filled at all. */
quell_status ql_struct_check_out(const void *given, size_t v1_bytes, const char *name, ql_error *err);

/* Fills the caller's struct up to its own struct_size, which is kept; what this library does not know becomes zero. */
void ql_struct_write(void *given, const void *full, size_t full_bytes);

/* Reads and checks a quell_image. what: "image", "reference", for the sentence. */
quell_status ql_image_read(const quell_image *image, const char *what, ql_view *view, uint32_t *width, uint32_t *height,
                           ql_error *err);

#endif
