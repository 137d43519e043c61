/* SPDX-License-Identifier: Apache-2.0 */
/* The `quell` tool: picks the subcommand, and answers --help and --version. */
#include "cli/cli.h"
#include "cli/model.h"
#include "cli/platform.h"

#include <stdio.h>
#include <string.h>

#ifndef CLI_OPENEXR_VERSION
#define CLI_OPENEXR_VERSION "unknown"
#endif

static const char help_text[] =
    "Usage: quell COMMAND [OPTION...] FILE...\n"
    "\n"
    "Denoises renders of Blender's Cycles: multilayer EXR in, the same EXR with clean light passes out.\n"
    "\n"
    "Commands:\n"
    "  denoise IN.exr... -o OUT      denoise the light passes of files\n"
    "  inspect IN.exr...             layers, their roles, and what denoise would do with them\n"
    "  compare A.exr REF.exr [REF2]  errors per layer against one or two references\n"
    "  preview IN.exr... -o OUT.png  a picture for the screen, several files side by side\n"
    "  bench                         time and memory of a denoise on this machine\n"
    "\n"
    "  quell COMMAND --help          the options of a command\n"
    "  quell --version [-v]          the version; -v: models, kernels and libraries too\n"
    "\n"
    "Exit codes: 0 done, 1 several files failed for different reasons, 2 wrong use, 3 file or folder not found,\n"
    "  4 unreadable input, 5 no such layer or nothing to denoise, 6 cannot write, 7 bad weight file, 8 sizes differ,\n"
    "  9 out of memory, 130 interrupted\n";

static int print_models(quell_context *ctx)
{
    for (uint32_t i = 0; quell_model_builtin_name(i); i++) {
        quell_model *model;
        const quell_status status = quell_model_open(ctx, quell_model_builtin_name(i), &model);
        if (status != QUELL_OK) return cli_error_status(NULL, ctx, status);
        quell_model_info info = {.struct_size = sizeof info};
        if (quell_model_get_info(model, &info) == QUELL_OK) {
            char text[512];
            cli_model_describe(&info, text, sizeof text);
            printf("model %s%s: %s, %s\n", info.name, i == 0 ? " (default)" : "", text, info.description);
            printf("  SHA-256 %s\n", info.sha256);
            printf("  %llu parameters, %.0f to %.0f multiply-adds per pixel\n", (unsigned long long)info.num_parameters,
                   info.macs_per_pixel, info.macs_per_pixel_all);
        }
        quell_model_destroy(model);
    }
    return CLI_EXIT_OK;
}

/* Levels whose weight file the build lacked. */
static void print_missing_levels(quell_context *ctx)
{
    for (int32_t quality = QUELL_QUALITY_FAST; quell_quality_name(quality); quality++) {
        quell_model *model;
        if (quell_model_open_quality(ctx, quality, &model) == QUELL_OK)
            quell_model_destroy(model);
        else
            printf("%s\n", quell_context_last_error(ctx));
    }
}

static void print_kernels(void)
{
    printf("kernels:");
    for (int32_t cpu = QUELL_CPU_C; cpu <= QUELL_CPU_AVX512BF16; cpu++) {
        quell_context_options options = {.struct_size = sizeof options, .num_threads = 1, .cpu = cpu};
        quell_context *ctx;
        if (quell_context_create(&options, &ctx) != QUELL_OK) continue;
        printf(" %s", quell_context_cpu_name(ctx));
        quell_context_destroy(ctx);
    }
    printf("\n");
}

static int print_version(int is_verbose)
{
    printf("quell %s\n", quell_version_string());
    if (!is_verbose) return CLI_EXIT_OK;

    const cli_common common = {0};
    quell_context *ctx;
    int code = cli_context_create(&common, &ctx);
    if (code != CLI_EXIT_OK) return code;
    print_kernels();
    printf("in use here: %s, %u threads\n", quell_context_cpu_name(ctx), quell_context_num_threads(ctx));
    printf("OpenEXRCore %s\n", CLI_OPENEXR_VERSION);
    code = print_models(ctx);
    print_missing_levels(ctx);
    cli_context_destroy(ctx);
    return code;
}

static int is_verbose_flag(const char *text)
{
    return strcmp(text, "-v") == 0 || strcmp(text, "--verbose") == 0;
}

static int run(int argc, char **argv)
{
    static const struct {
        const char *name;
        int (*run)(int argc, char **argv);
    } commands[] = {
        {"denoise", cli_denoise}, {"inspect", cli_inspect}, {"compare", cli_compare},
        {"preview", cli_preview}, {"bench", cli_bench},
    };

    if (argc < 2) {
        fputs(help_text, stderr);
        return CLI_EXIT_USAGE;
    }
    for (size_t i = 0; i < sizeof commands / sizeof *commands; i++) {
        if (strcmp(argv[1], commands[i].name) == 0) return commands[i].run(argc - 1, argv + 1);
    }
    if (strcmp(argv[1], "--help") == 0 || strcmp(argv[1], "-h") == 0 || strcmp(argv[1], "help") == 0) {
        fputs(help_text, stdout);
        return CLI_EXIT_OK;
    }
    if (strcmp(argv[1], "--version") == 0 || (is_verbose_flag(argv[1]) && argc > 2)) {
        return print_version(argc > 2 && (is_verbose_flag(argv[1]) || is_verbose_flag(argv[2])));
    }
    return cli_usage_error(NULL, "'%s' is no command of quell", argv[1]);
}

int cli_main(int argc, char **argv)
{
    const int code = run(argc, argv);
    /* A full disk behind a redirected stdout must not look like success. */
    if (fflush(stdout) != 0 && code == CLI_EXIT_OK) {
        cli_error(NULL, "cannot write to standard output");
        return CLI_EXIT_OUTPUT;
    }
    return code;
}
