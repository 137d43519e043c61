/* SPDX-License-Identifier: Apache-2.0 */
/* Files at byte offsets, from several threads, and outputs that appear whole or not at all. */
#ifndef QL_EXR_FILE_H
#define QL_EXR_FILE_H

#include "base/memory.h"
#include "base/status.h"

#include <stdint.h>

typedef struct ql_file ql_file;

/* Opens a regular file for reading. */
quell_status ql_file_open(ql_memory *memory, const char *path, ql_file **out, ql_error *err);
void ql_file_close(ql_file *file); /* NULL is allowed */
uint64_t ql_file_size(const ql_file *file);
const char *ql_file_path(const ql_file *file);

/* Reads exactly that many bytes, from any thread. 0, or -1 with the reason in *reason (static or strerror text). */
int ql_file_read(const ql_file *file, void *buffer, size_t num_bytes, uint64_t offset, const char **reason);

/* Begins an output that will stand under `path`: a file of a temporary name in the same folder. */
quell_status ql_file_create(ql_memory *memory, const char *path, ql_file **out, ql_error *err);

/* Writes all bytes at an offset. */
quell_status ql_file_write(ql_file *file, const void *data, size_t num_bytes, uint64_t offset, ql_error *err);

/* Makes the output durable and gives it its name; until then whatever stood there is untouched. Always frees `file`,
 * and on failure removes the temporary file. */
quell_status ql_file_commit(ql_file *file, ql_error *err);

/* Gives an output up: removes the temporary file and frees `file`. NULL is allowed. */
void ql_file_discard(ql_file *file);

#endif
