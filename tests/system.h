/* SPDX-License-Identifier: Apache-2.0 */
/* What the tests ask of the operating system. */
#ifndef TESTS_SYSTEM_H
#define TESTS_SYSTEM_H

#include <stddef.h>

/* Memory whose last byte is followed by a page that nobody may touch; the program ends when there is none. Freed with
 * test_free_guarded and the same size. */
void *test_alloc_guarded(size_t num_bytes);
void test_free_guarded(void *pointer, size_t num_bytes);

/* Makes an empty folder of its own and writes its name; 0 on success. */
int test_make_folder(char *path, size_t path_bytes);

#endif
