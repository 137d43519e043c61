/* SPDX-License-Identifier: Apache-2.0 */
/* quell denoise: files in, files out, one after the other with one model and one pool of threads. */
#include "cli/cli.h"
#include "cli/json.h"
#include "cli/model.h"
#include "cli/paths.h"
#include "cli/platform.h"
#include "cli/progress.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>

static const char help_text[] =
    "Usage: quell denoise IN.exr [more.exr...] -o OUT [OPTION...]\n"
    "\n"
    "Denoises the light passes of Cycles' multilayer EXR files. The output has the same parts, channels, types and\n"
    "metadata; what is not denoised is copied bit by bit. It appears whole, or not at all.\n"
    "\n"
    "  -o, --output OUT      a file (for one input); an existing folder or a name that ends in '/': the inputs' names\n"
    "                        are kept; or a pattern: {name} is the input's name without folder and extension, a run "
    "of\n"
    "                        '#' its frame number, padded with zeros: -o 'clean/shot_####.exr', -o '{name}_clean.exr'\n"
    "      --overwrite       let a folder or a pattern lead back to an input file\n"
    "      --quality LEVEL   fast, balanced (default) or high: larger networks, which take longer\n"
    "  -m, --model NAME|FILE instead: a built-in model (quell --version -v lists them) or a weight file\n"
    "  -l, --layers WHICH    all (default): every light pass; beauty: Combined alone; or names, comma-separated\n"
    "      --keep-noisy      keep the noisy Combined as the layer 'Noisy Image'\n"
    "      --no-skip         compute everything, also layers and parts of the image that need no work\n"
    "      --no-blend        do not blend with the render where that is cleaner: changes finished renders too\n"
    "      --debug-layers    add layers that show the noise estimate, the blend and what was skipped: Quell Noise,\n"
    "                        Quell Confidence, Quell Skipped\n"
    "      --codec CODEC     for parts that are encoded again: keep (default; lossy ones become zip), none, rle, "
    "zips,\n"
    "                        zip, piz, pxr24, b44, b44a, dwaa, dwab, htj2k\n"
    "      --dry-run         say what would be done and how much memory it needs; writes nothing, and needs no -o\n"
    "      --report FILE     what was done and skipped, and why, as JSON; '-': standard output\n"
    "      --threads N       default: one for each core\n"
    "      --max-memory MB   working memory beyond the image itself; smaller means smaller tiles; default 4096\n"
    "      --tile N          edge of a tile in pixels, instead of the one that --max-memory leads to\n"
    "      --cpu KERNELS     auto (default), c, avx2, avx512, avx512bf16, neon\n"
    "      --precision WHICH of numbers inside the network: auto (default; bfloat16 with the kernels avx512bf16,\n"
    "                        float32 with others), float32, bfloat16\n"
    "  -q, --quiet           no progress and no summary; errors only\n"
    "  -h, --help\n"
    "\n"
    "Advanced, with models of the kind DGAN-KPN alone; Combined is then the default of --layers:\n"
    "      --dgan-only           the generator alone\n"
    "      --kpn-only            the predicted kernels on the noisy image\n"
    "      --iterations N        1 to 8; default 4\n"
    "      --iterate HOW         filter (default): the kernels again; network: generator and kernels again, until "
    "that\n"
    "                            changes nothing visible\n"
    "      --run-all-iterations  with --iterate network: also those\n"
    "\n"
    "Exit codes: see quell --help. With several inputs the others are still denoised when one fails.\n";

enum {
    OPT_OVERWRITE = CLI_OPT_OWN,
    OPT_KEEP_NOISY,
    OPT_CODEC,
    OPT_REPORT,
    OPT_TILE,
    OPT_DGAN_ONLY,
    OPT_KPN_ONLY,
    OPT_ITERATIONS,
    OPT_ITERATE,
    OPT_RUN_ALL,
    OPT_NO_SKIP,
    OPT_NO_BLEND,
    OPT_DEBUG_LAYERS,
    OPT_DRY_RUN
};

typedef struct denoise_args {
    cli_common common;
    const char *output, *layers, *report;
    int is_overwriting, is_dry;
    uint32_t flags; /* QUELL_DENOISE_* */
    int32_t codec;
    uint32_t tile_size;
    quell_dgan_options dgan;
    int has_dgan_options;
    char **inputs;
    char **outputs; /* [num_inputs] */
    int num_inputs;
} denoise_args;

/* ---- Arguments --------------------------------------------------------------------------------------------------- */

static int parse_codec(const char *text, int32_t *out)
{
    static const char *const names[] = {"keep",  "none", "rle",  "zips", "zip",  "piz",
                                        "pxr24", "b44",  "b44a", "dwaa", "dwab", "htj2k"}; /* QUELL_CODEC_* */
    for (size_t i = 0; i < sizeof names / sizeof *names; i++) {
        if (strcmp(text, names[i]) != 0) continue;
        *out = (int32_t)i;
        return 0;
    }
    return -1;
}

static int choose_parts(denoise_args *args, int32_t parts)
{
    if (args->dgan.parts != QUELL_DGAN_BOTH && args->dgan.parts != parts)
        return cli_usage_error("denoise", "--dgan-only and --kpn-only exclude each other");
    args->dgan.parts = parts;
    return 0;
}

static int dgan_option(denoise_args *args, int code, const char *argument)
{
    uint64_t value;
    args->has_dgan_options = 1;
    switch (code) {
    case OPT_DGAN_ONLY: return choose_parts(args, QUELL_DGAN_GENERATOR);
    case OPT_KPN_ONLY: return choose_parts(args, QUELL_DGAN_KERNELS);
    case OPT_RUN_ALL: args->dgan.flags |= QUELL_DGAN_RUN_ALL; return 0;
    case OPT_ITERATIONS:
        if (cli_parse_uint(argument, 8, &value) != 0 || value == 0)
            return cli_usage_error("denoise", "--iterations: '%s' is not a number from 1 to 8", argument);
        args->dgan.iterations = (uint32_t)value;
        return 0;
    default:
        args->dgan.iterate = strcmp(argument, "network") == 0 ? QUELL_ITERATE_NETWORK : QUELL_ITERATE_FILTER;
        if (args->dgan.iterate == QUELL_ITERATE_NETWORK || strcmp(argument, "filter") == 0) return 0;
        return cli_usage_error("denoise", "--iterate: '%s' is neither filter nor network", argument);
    }
}

static int own_option(denoise_args *args, int code, const char *argument)
{
    uint64_t value;
    switch (code) {
    case 'o': args->output = argument; return 0;
    case 'l': args->layers = argument; return 0;
    case OPT_OVERWRITE: args->is_overwriting = 1; return 0;
    case OPT_KEEP_NOISY: args->flags |= QUELL_DENOISE_KEEP_NOISY; return 0;
    case OPT_DRY_RUN: args->is_dry = 1; return 0;
    case OPT_NO_SKIP: args->flags |= QUELL_DENOISE_NO_SKIP; return 0;
    case OPT_DEBUG_LAYERS: args->flags |= QUELL_DENOISE_DEBUG_LAYERS; return 0;
    case OPT_NO_BLEND: args->flags |= QUELL_DENOISE_NO_BLEND; return 0;
    case OPT_REPORT: args->report = argument; return 0;
    case OPT_CODEC:
        if (parse_codec(argument, &args->codec) == 0) return 0;
        return cli_usage_error("denoise", "--codec: '%s' is no codec of EXR files", argument);
    case OPT_TILE:
        if (cli_parse_uint(argument, 65536, &value) != 0) {
            return cli_usage_error("denoise", "--tile: '%s' is not a number of pixels", argument);
        }
        args->tile_size = (uint32_t)value;
        return 0;
    case OPT_DGAN_ONLY:
    case OPT_KPN_ONLY:
    case OPT_ITERATIONS:
    case OPT_ITERATE:
    case OPT_RUN_ALL: return dgan_option(args, code, argument);
    case 'm': return cli_common_option(&args->common, "denoise", CLI_OPT_MODEL, argument);
    case 'q': return cli_common_option(&args->common, "denoise", CLI_OPT_QUIET, argument);
    default: return cli_common_option(&args->common, "denoise", code, argument);
    }
}

static int parse(int argc, char **argv, denoise_args *args, int *wants_help)
{
    static const struct option options[] = {
        CLI_COMMON_OPTIONS,
        {"output", required_argument, NULL, 'o'},
        {"model", required_argument, NULL, 'm'},
        {"quality", required_argument, NULL, CLI_OPT_QUALITY},
        {"precision", required_argument, NULL, CLI_OPT_PRECISION},
        {"layers", required_argument, NULL, 'l'},
        {"quiet", no_argument, NULL, 'q'},
        {"overwrite", no_argument, NULL, OPT_OVERWRITE},
        {"keep-noisy", no_argument, NULL, OPT_KEEP_NOISY},
        {"no-skip", no_argument, NULL, OPT_NO_SKIP},
        {"dry-run", no_argument, NULL, OPT_DRY_RUN},
        {"debug-layers", no_argument, NULL, OPT_DEBUG_LAYERS},
        {"no-blend", no_argument, NULL, OPT_NO_BLEND},
        {"codec", required_argument, NULL, OPT_CODEC},
        {"report", required_argument, NULL, OPT_REPORT},
        {"tile", required_argument, NULL, OPT_TILE},
        {"dgan-only", no_argument, NULL, OPT_DGAN_ONLY},
        {"kpn-only", no_argument, NULL, OPT_KPN_ONLY},
        {"iterations", required_argument, NULL, OPT_ITERATIONS},
        {"iterate", required_argument, NULL, OPT_ITERATE},
        {"run-all-iterations", no_argument, NULL, OPT_RUN_ALL},
        {NULL, 0, NULL, 0},
    };
    int code;
    while ((code = getopt_long(argc, argv, "o:m:l:qh", options, NULL)) != -1) {
        if (code == CLI_OPT_HELP) {
            *wants_help = 1;
            return 0;
        }
        const int failure = own_option(args, code, optarg);
        if (failure) return failure;
    }
    args->inputs = argv + optind;
    args->num_inputs = argc - optind;
    if (args->num_inputs == 0) return cli_usage_error("denoise", "no input file");
    if (args->is_dry) return 0;
    if (!args->output || !args->output[0]) return cli_usage_error("denoise", "no output: say where with -o");
    return 0;
}

/* ---- Names ------------------------------------------------------------------------------------------------------- */

static int check_collisions(const denoise_args *args, int kind)
{
    for (int i = 0; i < args->num_inputs; i++) {
        for (int j = 0; j < i; j++) {
            if (strcmp(args->outputs[i], args->outputs[j]) == 0) {
                return cli_usage_error("denoise", "'%s' and '%s' would both become '%s'", args->inputs[j],
                                       args->inputs[i], args->outputs[i]);
            }
        }
        /* One input and its own name behind -o: that is explicit enough. */
        if (args->is_overwriting || (args->num_inputs == 1 && kind == CLI_OUT_FILE)) continue;
        for (int j = 0; j < args->num_inputs; j++) {
            if (cli_is_same_file(args->outputs[i], args->inputs[j])) {
                return cli_usage_error("denoise", "'%s' would replace the input '%s'; --overwrite allows that",
                                       args->outputs[i], args->inputs[j]);
            }
        }
    }
    return 0;
}

static int name_outputs(denoise_args *args)
{
    const int kind = cli_out_kind(args->output);
    if (args->num_inputs > 1 && kind == CLI_OUT_FILE) {
        return cli_usage_error("denoise",
                               "-o: '%s' is one file for %d inputs; give an existing folder, or a pattern with {name} "
                               "or '#'",
                               args->output, args->num_inputs);
    }
    args->outputs = calloc((size_t)args->num_inputs, sizeof *args->outputs);
    if (!args->outputs) return CLI_EXIT_MEMORY;
    for (int i = 0; i < args->num_inputs; i++) {
        const char *why;
        args->outputs[i] = cli_out_path(args->output, args->inputs[i], &why);
        if (!args->outputs[i]) {
            if (why) return cli_usage_error("denoise", "%s: %s", args->inputs[i], why);
            cli_error(args->inputs[i], "no memory");
            return CLI_EXIT_MEMORY;
        }
    }
    return check_collisions(args, kind);
}

static void free_names(denoise_args *args)
{
    if (!args->outputs) return;
    for (int i = 0; i < args->num_inputs; i++) free(args->outputs[i]);
    free(args->outputs);
}

/* ---- One file ---------------------------------------------------------------------------------------------------- */

typedef struct file_result {
    quell_report *report;
    double seconds_read, seconds_denoise, seconds_write;
} file_result;

static double now(void)
{
    struct timespec time;
    clock_gettime(CLOCK_MONOTONIC, &time);
    return (double)time.tv_sec + 1e-9 * (double)time.tv_nsec;
}

static int report_failure(quell_context *ctx, const char *file, quell_status status)
{
    if (status == QUELL_ERR_CANCELLED) {
        cli_error(file, "cancelled; nothing was written");
        return cli_exit_code(status);
    }
    return cli_error_status(file, ctx, status);
}

static quell_status denoise_frame(quell_context *ctx, const quell_model *model, quell_frame *frame,
                                  const denoise_args *args, cli_progress *progress, quell_report **report)
{
    quell_options options = {.struct_size = sizeof options};
    options.flags = args->flags;
    options.layers = args->layers;
    options.tile_size = args->tile_size;
    options.precision = args->common.precision;
    quell_dgan_options dgan = args->dgan;
    dgan.struct_size = sizeof dgan;
    if (args->has_dgan_options) options.dgan = &dgan;
    options.progress = cli_progress_update;
    options.progress_user = progress;
    if (args->is_dry) return quell_plan(ctx, model, frame, &options, report);
    return quell_denoise(ctx, model, frame, &options, report);
}

static int denoise_file(quell_context *ctx, const quell_model *model, const denoise_args *args, int index,
                        file_result *result)
{
    const char *input = args->inputs[index];
    quell_frame *frame;
    cli_progress progress;
    const double start = now();
    quell_status status = quell_frame_read_exr(ctx, input, &frame);
    if (status != QUELL_OK) return report_failure(ctx, input, status);
    const double read = now();
    result->seconds_read = read - start;

    cli_progress_begin(&progress, input, args->common.is_quiet);
    status = denoise_frame(ctx, model, frame, args, &progress, &result->report);
    cli_progress_end(&progress);
    const double denoised = now();
    result->seconds_denoise = denoised - read;
    const int is_refused = status == QUELL_ERR_UNSUPPORTED; /* --precision, not the file */

    if (status == QUELL_OK && !args->is_dry) {
        quell_write_options options = {.struct_size = sizeof options, .codec = args->codec};
        status = quell_frame_write_exr(ctx, frame, args->outputs[index], &options);
        result->seconds_write = now() - denoised;
    }
    const int code = status == QUELL_OK ? CLI_EXIT_OK : report_failure(ctx, input, status);
    quell_frame_destroy(frame);
    return is_refused ? CLI_EXIT_USAGE : code;
}

/* ---- What was done ----------------------------------------------------------------------------------------------- */

typedef struct layer_counts {
    uint32_t denoised, skipped;
    uint64_t bad, limited;
} layer_counts;

static layer_counts count_layers(const quell_report *report)
{
    layer_counts counts = {0};
    quell_report_layer layer = {.struct_size = sizeof layer};
    for (uint32_t i = 0; quell_report_get_layer(report, i, &layer) == QUELL_OK; i++) {
        counts.denoised += layer.action == QUELL_ACTION_DENOISED;
        counts.skipped += layer.action == QUELL_ACTION_SKIPPED;
        counts.bad += layer.num_bad_pixels;
        counts.limited += layer.num_limited_pixels;
    }
    return counts;
}

static void print_plan(const quell_model *model, const denoise_args *args, int index, const file_result *result)
{
    quell_report_summary summary = {.struct_size = sizeof summary};
    quell_report_layer layer = {.struct_size = sizeof layer};
    if (quell_report_get_summary(result->report, &summary) != QUELL_OK) return;
    printf("%s: would compute %u of %u cells in %u %s of up to %u x %u pixels, with %.1f MB of working memory\n",
           args->inputs[index], summary.num_active_cells, summary.num_cells, summary.num_tiles,
           summary.num_tiles == 1 ? "tile" : "tiles", summary.tile_width, summary.tile_height,
           (double)summary.peak_bytes / 1048576.0);
    quell_model_info info = {.struct_size = sizeof info};
    char text[512];
    if (quell_model_get_info(model, &info) != QUELL_OK) return;
    cli_model_describe(&info, text, sizeof text);
    printf("  with the model %s, %s\n", info.name, text);
    for (uint32_t i = 0; quell_report_get_layer(result->report, i, &layer) == QUELL_OK; i++) {
        printf("  %-8s %s", cli_action_name(layer.action), layer.full_name);
        if (layer.action == QUELL_ACTION_DENOISED) printf(", noise %.1f %%", 100.0 * layer.noise);
        if (layer.reason && layer.reason[0]) printf(" (%s)", layer.reason);
        putchar('\n');
    }
    fflush(stdout);
}

static void print_summary(const denoise_args *args, int index, const file_result *result)
{
    const layer_counts counts = count_layers(result->report);
    printf("%s -> %s: %u %s denoised", args->inputs[index], args->outputs[index], counts.denoised,
           counts.denoised == 1 ? "layer" : "layers");
    if (counts.skipped) printf(", %u skipped", counts.skipped);
    if (counts.bad) printf(", %llu bad pixels replaced", (unsigned long long)counts.bad);
    if (counts.limited) printf(", %llu fireflies limited", (unsigned long long)counts.limited);
    printf(", %.2f s\n", result->seconds_read + result->seconds_denoise + result->seconds_write);
    fflush(stdout);
}

static cJSON *file_json(const denoise_args *args, int index, const file_result *result, int code)
{
    cJSON *json = cJSON_CreateObject();
    if (!json) return NULL;
    cJSON_AddStringToObject(json, "input", args->inputs[index]);
    if (args->outputs) cJSON_AddStringToObject(json, "output", args->outputs[index]);
    cJSON_AddNumberToObject(json, "exit_code", code);
    if (!result->report) return json;

    cli_json_number(json, "seconds_read", result->seconds_read);
    cli_json_number(json, "seconds_denoise", result->seconds_denoise);
    cli_json_number(json, "seconds_write", result->seconds_write);
    quell_report_summary summary = {.struct_size = sizeof summary};
    if (quell_report_get_summary(result->report, &summary) == QUELL_OK) {
        cJSON_AddItemToObject(json, "summary", cli_json_summary(&summary));
        cJSON *stages = cli_json_stages(&summary);
        if (stages) cli_json_number(stages, "encode", result->seconds_write);
        cJSON_AddItemToObject(json, "stages", stages);
    }
    cJSON *layers = cJSON_AddArrayToObject(json, "layers");
    quell_report_layer layer = {.struct_size = sizeof layer};
    for (uint32_t i = 0; quell_report_get_layer(result->report, i, &layer) == QUELL_OK; i++) {
        cJSON_AddItemToArray(layers, cli_json_report_layer(&layer));
    }
    return json;
}

static int run(quell_context *ctx, const quell_model *model, const denoise_args *args, cJSON *files)
{
    int code = CLI_EXIT_OK;
    for (int i = 0; i < args->num_inputs; i++) {
        file_result result = {0};
        const int one = denoise_file(ctx, model, args, i, &result);
        /* Standard output is the report's when it goes there. */
        const int prints = !args->common.is_quiet && !(args->report && strcmp(args->report, "-") == 0);
        if (one == CLI_EXIT_OK && prints && args->is_dry) print_plan(model, args, i, &result);
        if (one == CLI_EXIT_OK && prints && !args->is_dry) print_summary(args, i, &result);
        if (files) cJSON_AddItemToArray(files, file_json(args, i, &result, one));
        quell_report_destroy(result.report);
        if (cli_is_interrupted()) return cli_interrupt_code();
        code = cli_exit_merge(code, one);
    }
    return code;
}

static int run_with_report(quell_context *ctx, const quell_model *model, const denoise_args *args)
{
    if (!args->report) return run(ctx, model, args, NULL);
    cJSON *json = cJSON_CreateObject();
    cJSON_AddStringToObject(json, "quell", quell_version_string());
    cJSON_AddStringToObject(json, "kernels", quell_context_cpu_name(ctx));
    cJSON_AddNumberToObject(json, "threads", quell_context_num_threads(ctx));
    quell_model_info info = {.struct_size = sizeof info};
    if (quell_model_get_info(model, &info) == QUELL_OK) cJSON_AddItemToObject(json, "model", cli_json_model(&info));
    const int code = run(ctx, model, args, cJSON_AddArrayToObject(json, "files"));
    return cli_exit_merge(code, cli_json_write(json, args->report));
}

int cli_denoise(int argc, char **argv)
{
    denoise_args args = {0};
    int wants_help = 0;
    int code = parse(argc, argv, &args, &wants_help);
    if (wants_help) fputs(help_text, stdout);
    if (wants_help || code) return code;

    quell_context *ctx = NULL;
    quell_model *model = NULL;
    code = args.is_dry ? CLI_EXIT_OK : name_outputs(&args);
    if (code == CLI_EXIT_OK) code = cli_context_create(&args.common, &ctx);
    if (code == CLI_EXIT_OK) code = cli_model_open(&args.common, "denoise", ctx, &model);
    if (code == CLI_EXIT_OK) code = run_with_report(ctx, model, &args);
    quell_model_destroy(model);
    cli_context_destroy(ctx);
    free_names(&args);
    return code;
}
