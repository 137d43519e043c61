/* SPDX-License-Identifier: Apache-2.0 */
#include "cli/progress.h"

#include "cli/cli.h"
#include "cli/platform.h"

#include <stdio.h>

#define BAR_WIDTH 30

void cli_progress_begin(cli_progress *progress, const char *label, int is_quiet)
{
    progress->label = label;
    progress->is_shown = !is_quiet && cli_has_terminal();
    (void)cli_progress_update(progress, 0.0);
}

int32_t cli_progress_update(void *user, double fraction)
{
    const cli_progress *progress = user;
    if (!progress->is_shown) return cli_is_interrupted();

    char bar[BAR_WIDTH + 1];
    const int filled = (int)(fraction * BAR_WIDTH);
    for (int i = 0; i < BAR_WIDTH; i++) bar[i] = i < filled ? '#' : '-';
    bar[BAR_WIDTH] = '\0';
    fprintf(stderr, "\r\033[K%s [%s] %3.0f %%", progress->label, bar, 100.0 * fraction);
    fflush(stderr);
    return cli_is_interrupted();
}

void cli_progress_end(cli_progress *progress)
{
    if (!progress->is_shown) return;
    fputs("\r\033[K", stderr);
    fflush(stderr);
}
