/* SPDX-License-Identifier: Apache-2.0 */
/* From the name of an input to the name of its output. */
#ifndef CLI_PATHS_H
#define CLI_PATHS_H

/* How OUT was meant: one file, a folder, or a pattern. */
enum { CLI_OUT_FILE, CLI_OUT_FOLDER, CLI_OUT_PATTERN };

int cli_out_kind(const char *out);

/* Output path of an input, to be freed; NULL without memory, or when a pattern has '#' and the input's name has no
 * digits (then *why is set).
 *   file     OUT itself
 *   folder   OUT/name.exr
 *   pattern  {name}: the input's name without folder and extension; a run of '#': the last number in it, padded with
 *            zeros to at least the run's length */
char *cli_out_path(const char *out, const char *input, const char **why);

/* The part behind the last separator of folders. */
const char *cli_base_name(const char *path);

#endif
