/* SPDX-License-Identifier: Apache-2.0 */
/* quell compare: errors of one file's layers against one or two references. */
#include "cli/cli.h"
#include "cli/json.h"
#include "cli/layers.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>

static const char help_text[] =
    "Usage: quell compare A.exr REF.exr [REF2.exr] [OPTION...]\n"
    "\n"
    "Errors of A's layers against the same layers of a reference: MSE, relMSE, PSNR, SSIM, GMSD and the number of\n"
    "values that are not finite. Two references must be independent renders (different seeds): their own noise then\n"
    "cancels. A layer's counterpart is the one of the same full name, else of the same pass, else of the same role.\n"
    "\n"
    "  -l, --layers WHICH    all: every layer that both have; or names, comma-separated. Default: all whose role is "
    "known\n"
    "      --json            as JSON\n"
    "      --threads N, --max-memory MB, --cpu KERNELS   as in quell denoise\n"
    "  -h, --help\n";

enum { OPT_JSON = CLI_OPT_OWN, MAX_FILES = 3 };

typedef struct compare_args {
    cli_common common;
    const char *layers;
    int is_json;
    char **paths; /* the image, and one or two references */
    int num_paths;
} compare_args;

static int parse(int argc, char **argv, compare_args *args, int *wants_help)
{
    static const struct option options[] = {
        CLI_COMMON_OPTIONS,
        {"layers", required_argument, NULL, 'l'},
        {"json", no_argument, NULL, OPT_JSON},
        {NULL, 0, NULL, 0},
    };
    int code;
    while ((code = getopt_long(argc, argv, "l:h", options, NULL)) != -1) {
        int failure = 0;
        switch (code) {
        case CLI_OPT_HELP: *wants_help = 1; return 0;
        case OPT_JSON: args->is_json = 1; break;
        case 'l': args->layers = optarg; break;
        default: failure = cli_common_option(&args->common, "compare", code, optarg); break;
        }
        if (failure) return failure;
    }
    args->paths = argv + optind;
    args->num_paths = argc - optind;
    if (args->num_paths < 2 || args->num_paths > MAX_FILES) {
        return cli_usage_error("compare", "one file and one or two references are needed, not %d files",
                               args->num_paths);
    }
    return 0;
}

static int is_wanted(const compare_args *args, const quell_layer_info *info)
{
    if (!args->layers) return info->role != QUELL_ROLE_OTHER;
    return strcmp(args->layers, "all") == 0 || cli_layer_listed(args->layers, info);
}

static void print_metrics(const char *name, const quell_metrics *m)
{
    printf("%-40s %11.5g %11.5g %8.3f %8.5f %8.5f %10llu\n", name, m->mse, m->rel_mse, m->psnr, m->ssim, m->gmsd,
           (unsigned long long)m->num_non_finite);
}

/* indices: of the layer in each file. */
static int compare_layer(quell_context *ctx, const compare_args *args, quell_frame *const *frames,
                         const uint32_t *indices, const char *name, cJSON *layers)
{
    quell_image images[MAX_FILES] = {{0}};
    quell_layer_info info = {.struct_size = sizeof info};
    uint32_t num_channels = 3; /* alpha is not compared: a reference may well lack it */
    int code = CLI_EXIT_OK;
    for (int f = 0; f < args->num_paths; f++) {
        if (quell_frame_get_layer(frames[f], indices[f], &info) != QUELL_OK) return CLI_EXIT_FAILED;
        if (info.num_channels < num_channels) num_channels = info.num_channels;
    }
    for (int f = 0; f < args->num_paths && code == CLI_EXIT_OK; f++) {
        code = cli_layer_pixels(ctx, args->paths[f], frames[f], indices[f], num_channels, &images[f]);
    }
    if (code == CLI_EXIT_OK) {
        quell_metrics metrics = {.struct_size = sizeof metrics};
        const quell_image *second = args->num_paths > 2 ? &images[2] : NULL;
        const quell_status status = quell_compare(ctx, &images[0], &images[1], second, &metrics);
        if (status != QUELL_OK) {
            cli_error(args->paths[0], "layer '%s': %s", name, quell_context_last_error(ctx));
            code = cli_exit_code(status);
        } else if (layers) {
            cJSON *json = cli_json_metrics(&metrics);
            cJSON_AddStringToObject(json, "name", name);
            cJSON_AddItemToArray(layers, json);
        } else {
            print_metrics(name, &metrics);
        }
    }
    for (int f = 0; f < MAX_FILES; f++) free(images[f].data);
    return code;
}

static int compare_frames(quell_context *ctx, const compare_args *args, quell_frame *const *frames, cJSON *layers)
{
    int code = CLI_EXIT_OK, num_compared = 0;
    if (!layers) {
        printf("%-40s %11s %11s %8s %8s %8s %10s\n", "layer", "MSE", "relMSE", "PSNR", "SSIM", "GMSD", "non-finite");
    }
    quell_layer_info info = {.struct_size = sizeof info};
    for (uint32_t i = 0; quell_frame_get_layer(frames[0], i, &info) == QUELL_OK && !cli_is_interrupted(); i++) {
        uint32_t indices[MAX_FILES] = {i};
        int is_matched = is_wanted(args, &info);
        for (int f = 1; f < args->num_paths && is_matched; f++) {
            const int64_t index = cli_layer_match(frames[f], &info);
            is_matched = index >= 0;
            indices[f] = is_matched ? (uint32_t)index : 0;
        }
        if (!is_matched) continue;
        code = cli_exit_merge(code, compare_layer(ctx, args, frames, indices, info.full_name, layers));
        num_compared++;
    }
    if (num_compared == 0) {
        cli_error(args->paths[0], "has no layer in common with %s%s", args->paths[1],
                  args->layers ? ", or none of those named by --layers" : "");
        return CLI_EXIT_NO_LAYER;
    }
    return cli_is_interrupted() ? cli_interrupt_code() : code;
}

static int run(quell_context *ctx, const compare_args *args)
{
    quell_frame *frames[MAX_FILES] = {NULL};
    int code = CLI_EXIT_OK;
    for (int f = 0; f < args->num_paths && code == CLI_EXIT_OK; f++) {
        const quell_status status = quell_frame_read_exr(ctx, args->paths[f], &frames[f]);
        if (status != QUELL_OK) code = cli_error_status(args->paths[f], ctx, status);
    }
    if (code == CLI_EXIT_OK && args->is_json) {
        cJSON *json = cJSON_CreateObject();
        cJSON_AddStringToObject(json, "file", args->paths[0]);
        cJSON *references = cJSON_AddArrayToObject(json, "references");
        for (int f = 1; f < args->num_paths; f++) {
            cJSON_AddItemToArray(references, cJSON_CreateString(args->paths[f]));
        }
        code = compare_frames(ctx, args, frames, cJSON_AddArrayToObject(json, "layers"));
        code = cli_exit_merge(code, cli_json_write(json, "-"));
    } else if (code == CLI_EXIT_OK) {
        code = compare_frames(ctx, args, frames, NULL);
    }
    for (int f = 0; f < MAX_FILES; f++) quell_frame_destroy(frames[f]);
    return code;
}

int cli_compare(int argc, char **argv)
{
    compare_args args = {0};
    int wants_help = 0;
    int code = parse(argc, argv, &args, &wants_help);
    if (wants_help) fputs(help_text, stdout);
    if (wants_help || code) return code;

    quell_context *ctx;
    code = cli_context_create(&args.common, &ctx);
    if (code != CLI_EXIT_OK) return code;
    code = run(ctx, &args);
    cli_context_destroy(ctx);
    return code;
}
