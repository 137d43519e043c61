/* SPDX-License-Identifier: Apache-2.0 */
/* A bar on stderr where that is a terminal; nothing elsewhere. */
#ifndef CLI_PROGRESS_H
#define CLI_PROGRESS_H

#include <stdint.h>

typedef struct cli_progress {
    const char *label;
    int is_shown;
} cli_progress;

void cli_progress_begin(cli_progress *progress, const char *label, int is_quiet);
int32_t cli_progress_update(void *progress, double fraction); /* a quell_progress_fn */
void cli_progress_end(cli_progress *progress);                /* wipes the bar */

#endif
