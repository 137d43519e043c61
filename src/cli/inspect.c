/* SPDX-License-Identifier: Apache-2.0 */
/* quell inspect: what is in a file, and what denoise would do with it. */
#include "cli/cli.h"
#include "cli/json.h"
#include "cli/model.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>

static const char help_text[] =
    "Usage: quell inspect IN.exr [more.exr...] [OPTION...]\n"
    "\n"
    "Lists the layers of EXR files: view layer, pass, view, role, size, type, compression, samples, and what\n"
    "'quell denoise' would do with each, and why.\n"
    "\n"
    "      --json            as JSON, an array with an object for each file\n"
    "      --quality LEVEL, -m, --model NAME|FILE   plan for this network, as in quell denoise\n"
    "  -l, --layers WHICH    plan for this choice of layers, as in quell denoise\n"
    "      --threads N, --max-memory MB, --cpu KERNELS   as in quell denoise\n"
    "  -h, --help\n";

enum { OPT_JSON = CLI_OPT_OWN };

typedef struct inspect_args {
    cli_common common;
    const char *layers;
    int is_json;
    char **inputs;
    int num_inputs;
} inspect_args;

static int parse(int argc, char **argv, inspect_args *args, int *wants_help)
{
    static const struct option options[] = {
        CLI_COMMON_OPTIONS,
        {"model", required_argument, NULL, 'm'},
        {"quality", required_argument, NULL, CLI_OPT_QUALITY},
        {"layers", required_argument, NULL, 'l'},
        {"json", no_argument, NULL, OPT_JSON},
        {NULL, 0, NULL, 0},
    };
    int code;
    while ((code = getopt_long(argc, argv, "m:l:h", options, NULL)) != -1) {
        int failure = 0;
        switch (code) {
        case CLI_OPT_HELP: *wants_help = 1; return 0;
        case OPT_JSON: args->is_json = 1; break;
        case 'l': args->layers = optarg; break;
        case 'm': args->common.model = optarg; break;
        default: failure = cli_common_option(&args->common, "inspect", code, optarg); break;
        }
        if (failure) return failure;
    }
    args->inputs = argv + optind;
    args->num_inputs = argc - optind;
    return args->num_inputs ? 0 : cli_usage_error("inspect", "no input file");
}

/* ---- Text -------------------------------------------------------------------------------------------------------- */

enum { COL_NAME, COL_ROLE, COL_CHANNELS, COL_TYPE, COL_CODEC, COL_SAMPLES, COL_ACTION, NUM_COLUMNS };

static const char *const titles[NUM_COLUMNS] = {"layer", "role", "channels", "type", "codec", "spp", "denoise would"};

/* Columns in characters, not bytes: layer names may be UTF-8. */
static int width_of(const char *text)
{
    int width = 0;
    for (; *text; text++) width += ((unsigned char)*text & 0xc0u) != 0x80u;
    return width;
}

static void row_of(const quell_frame *frame, const quell_report *report, uint32_t index, char samples[16],
                   char action[160], const char *cells[NUM_COLUMNS])
{
    quell_layer_info info = {.struct_size = sizeof info};
    quell_report_layer plan = {.struct_size = sizeof plan};
    if (quell_frame_get_layer(frame, index, &info) != QUELL_OK) return;
    const int is_planned = report && quell_report_get_layer(report, index, &plan) == QUELL_OK;

    snprintf(samples, 16, info.samples ? "%u" : "-", info.samples);
    const char *verb = is_planned ? cli_action_name(plan.action) : "keep";
    const char *reason = is_planned && plan.reason && strcmp(plan.reason, verb) != 0 ? plan.reason : "";
    snprintf(action, 160, "%s%s%s", verb, reason[0] ? ": " : "", reason);
    cells[COL_NAME] = info.full_name;
    cells[COL_ROLE] = quell_role_name(info.role);
    cells[COL_CHANNELS] = info.channels;
    cells[COL_TYPE] = cli_format_name(info.format);
    cells[COL_CODEC] = info.compression;
    cells[COL_SAMPLES] = samples;
    cells[COL_ACTION] = action;
}

static void print_cells(const char *const cells[NUM_COLUMNS], const int widths[NUM_COLUMNS])
{
    fputs(" ", stdout);
    for (int c = 0; c < NUM_COLUMNS; c++) {
        printf(" %s", cells[c]);
        if (c + 1 < NUM_COLUMNS) printf("%*s", widths[c] - width_of(cells[c]) + 1, "");
    }
    fputs("\n", stdout);
}

static void print_table(const char *path, const quell_frame *frame, const quell_report *report)
{
    const uint32_t num_layers = quell_frame_num_layers(frame);
    quell_layer_info first = {.struct_size = sizeof first};
    if (num_layers == 0 || quell_frame_get_layer(frame, 0, &first) != QUELL_OK) {
        printf("%s: no layers\n", path);
        return;
    }
    printf("%s: %u x %u pixels, %u layers\n", path, first.width, first.height, num_layers);

    char samples[16], action[160];
    const char *cells[NUM_COLUMNS];
    int widths[NUM_COLUMNS];
    for (int c = 0; c < NUM_COLUMNS; c++) widths[c] = width_of(titles[c]);
    for (uint32_t i = 0; i < num_layers; i++) {
        row_of(frame, report, i, samples, action, cells);
        for (int c = 0; c < NUM_COLUMNS; c++)
            widths[c] = width_of(cells[c]) > widths[c] ? width_of(cells[c]) : widths[c];
    }
    print_cells(titles, widths);
    for (uint32_t i = 0; i < num_layers; i++) {
        row_of(frame, report, i, samples, action, cells);
        print_cells(cells, widths);
    }
    if (!report) printf("  nothing in here can be denoised\n");
}

static void print_model(const quell_model *model)
{
    quell_model_info info = {.struct_size = sizeof info};
    char text[512];
    if (quell_model_get_info(model, &info) != QUELL_OK) return;
    cli_model_describe(&info, text, sizeof text);
    printf("model %s, %s, SHA-256 %s\n", info.name, text, info.sha256);
}

/* ---- JSON -------------------------------------------------------------------------------------------------------- */

static cJSON *frame_json(const char *path, const quell_frame *frame, const quell_report *report,
                         const quell_model *model)
{
    cJSON *json = cJSON_CreateObject();
    quell_model_info model_info = {.struct_size = sizeof model_info};
    cJSON_AddStringToObject(json, "file", path);
    if (quell_model_get_info(model, &model_info) == QUELL_OK)
        cJSON_AddItemToObject(json, "model", cli_json_model(&model_info));
    quell_report_summary summary = {.struct_size = sizeof summary};
    if (report && quell_report_get_summary(report, &summary) == QUELL_OK) {
        cJSON_AddItemToObject(json, "plan", cli_json_summary(&summary));
    }
    cJSON *layers = cJSON_AddArrayToObject(json, "layers");
    for (uint32_t i = 0; i < quell_frame_num_layers(frame); i++) {
        quell_layer_info info = {.struct_size = sizeof info};
        quell_report_layer plan = {.struct_size = sizeof plan};
        if (quell_frame_get_layer(frame, i, &info) != QUELL_OK) continue;
        cJSON *layer = cli_json_layer(&info);
        const int is_planned = report && quell_report_get_layer(report, i, &plan) == QUELL_OK;
        cJSON_AddStringToObject(layer, "action", is_planned ? cli_action_name(plan.action) : "keep");
        cJSON_AddStringToObject(layer, "reason", is_planned && plan.reason ? plan.reason : "");
        cJSON_AddItemToArray(layers, layer);
    }
    return json;
}

/* ---- Run --------------------------------------------------------------------------------------------------------- */

static int inspect_file(quell_context *ctx, const quell_model *model, const inspect_args *args, const char *path,
                        cJSON *files)
{
    quell_frame *frame;
    quell_status status = quell_frame_read_exr(ctx, path, &frame);
    if (status != QUELL_OK) return cli_error_status(path, ctx, status);

    quell_options options = {.struct_size = sizeof options, .layers = args->layers};
    quell_report *report = NULL;
    int code = CLI_EXIT_OK;
    status = quell_plan(ctx, model, frame, &options, &report);
    /* A file without anything to denoise is still worth looking at. */
    const int is_empty = status == QUELL_ERR_NO_LAYER && !args->layers;
    if (status != QUELL_OK && !is_empty) {
        code = cli_error_status(path, ctx, status);
    } else if (files) {
        cJSON_AddItemToArray(files, frame_json(path, frame, report, model));
    } else {
        print_table(path, frame, report);
    }
    quell_report_destroy(report);
    quell_frame_destroy(frame);
    return code;
}

int cli_inspect(int argc, char **argv)
{
    inspect_args args = {0};
    int wants_help = 0;
    int code = parse(argc, argv, &args, &wants_help);
    if (wants_help) fputs(help_text, stdout);
    if (wants_help || code) return code;

    quell_context *ctx = NULL;
    quell_model *model = NULL;
    code = cli_context_create(&args.common, &ctx);
    if (code != CLI_EXIT_OK) return code;
    code = cli_model_open(&args.common, "inspect", ctx, &model);
    if (code != CLI_EXIT_OK) {
        cli_context_destroy(ctx);
        return code;
    }

    cJSON *files = args.is_json ? cJSON_CreateArray() : NULL;
    if (!args.is_json) print_model(model);
    for (int i = 0; i < args.num_inputs && !cli_is_interrupted(); i++) {
        code = cli_exit_merge(code, inspect_file(ctx, model, &args, args.inputs[i], files));
    }
    if (files) code = cli_exit_merge(code, cli_json_write(files, "-"));
    quell_model_destroy(model);
    cli_context_destroy(ctx);
    return code;
}
