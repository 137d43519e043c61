/* SPDX-License-Identifier: Apache-2.0 */
/* Channel names to layers: both layouts (one part, or one part per pass), both kinds of multi-view files, plain files
 * without prefixes. Names are read by src/frame/roles.c; this file knows where in an EXR they stand. */
#include "exr/layers.h"

#include "frame/roles.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>

/* Every pair of layers may be compared; Blender writes some hundred channels per view layer. */
#define MAX_CHANNELS 16384

/* Channel names are shorter in files (255 bytes); a part's view comes behind them. */
#define MAX_NAME_BYTES 1024

typedef struct listing {
    ql_env *env;
    ql_exr_source *source;
    ql_frame *frame;
    const char **multi_view; /* of a single part; NULL-terminated, or NULL */
    uint32_t num_nameless;   /* channels without a letter, or too many in one layer */
    char nameless[96];       /* one of them */
} listing;

static void warn(const ql_env *env, const char *text)
{
    if (env->log) env->log(env->log_user, QUELL_LOG_WARNING, text);
}

/* Splits a channel's name; gives its layer's full name, which tells views apart in either kind of file. -1: no letter. */
static int name_layer(const char *channel, const char *const *multi_view, const char *part_view, char *full_name,
                      int32_t *role, char *letter)
{
    char buffer[MAX_NAME_BYTES];
    const char *view_layer, *pass, *view;
    const size_t length = strlen(channel);
    if (length + strlen(part_view) + 4 > MAX_NAME_BYTES) return -1;
    if (ql_split_channel_name(channel, multi_view, buffer, &view_layer, &pass, &view, letter) != 0) return -1;

    *role = strcmp(view_layer, "Composite") == 0 ? QUELL_ROLE_OTHER : ql_role_from_pass(pass);
    if (length < 3) {
        snprintf(full_name, MAX_NAME_BYTES, "%s", pass);
    } else {
        memcpy(full_name, channel, length - 2);
        full_name[length - 2] = '\0';
    }
    if (part_view[0]) {
        strcat(full_name, ".");
        strcat(full_name, part_view);
    }
    return full_name[0] ? 0 : -1;
}

static const char *view_of_part(const ql_exr_source *source, uint32_t part)
{
    return source->is_multi_part ? source->parts[part].view : "";
}

static int has_known_role(const listing *list, uint32_t part)
{
    const exr_attr_chlist_t *channels = list->source->parts[part].channels;
    char full_name[MAX_NAME_BYTES], letter;
    int32_t role;
    for (int32_t c = 0; c < channels->num_channels; c++) {
        if (name_layer(channels->entries[c].name.str, list->multi_view, "", full_name, &role, &letter) != 0) continue;
        if (role != QUELL_ROLE_OTHER) return 1;
    }
    return 0;
}

/* The frame takes its size from the first part that holds a pass Quell knows, or else from the first it can decode. */
static quell_status choose_size(listing *list, ql_error *err)
{
    ql_exr_source *source = list->source;
    const ql_exr_part *chosen = NULL;
    char where[1200], text[1400];
    for (uint32_t p = 0; p < source->num_parts; p++) {
        if (!source->parts[p].is_plain) continue;
        if (!chosen) chosen = &source->parts[p];
        if (has_known_role(list, p)) {
            chosen = &source->parts[p];
            break;
        }
    }
    if (!chosen) {
        return ql_fail(err, QUELL_ERR_UNSUPPORTED,
                       "%s: holds tiled, deep or subsampled data only; Quell reads plain scanline images",
                       ql_file_path(source->file));
    }
    list->frame->width = chosen->width;
    list->frame->height = chosen->height;

    for (uint32_t p = 0; p < source->num_parts; p++) {
        ql_exr_part *part = &source->parts[p];
        const int is_alike = memcmp(&part->window, &chosen->window, sizeof part->window) == 0;
        part->is_listed = part->is_plain && is_alike;
        if (part->is_listed) continue;
        snprintf(text, sizeof text, "%s: %s; it is kept as it is", ql_exr_source_where(source, p, where, sizeof where),
                 part->is_plain ? "has another size or place than the first" : "is tiled, deep or subsampled");
        warn(list->env, text);
    }
    return QUELL_OK;
}

static quell_status read_multi_view(listing *list, ql_error *err)
{
    exr_const_context_t context = list->source->context;
    const exr_attribute_t *attribute = NULL;
    int32_t count = 0;
    if (list->source->is_multi_part) return QUELL_OK;
    if (exr_get_attribute_by_name(context, 0, "multiView", &attribute) != EXR_ERR_SUCCESS) return QUELL_OK;
    if (attribute->type != EXR_ATTR_STRING_VECTOR) return QUELL_OK;
    if (exr_attr_get_string_vector(context, 0, "multiView", &count, NULL) != EXR_ERR_SUCCESS || count < 1) {
        return QUELL_OK;
    }
    list->multi_view = ql_alloc_zero(list->source->memory, (size_t)count + 1, sizeof *list->multi_view);
    if (!list->multi_view) {
        return ql_fail(err, QUELL_ERR_OUT_OF_MEMORY, "%s: no memory for %d view names",
                       ql_file_path(list->source->file), count);
    }
    if (exr_attr_get_string_vector(context, 0, "multiView", &count, list->multi_view) != EXR_ERR_SUCCESS) {
        list->multi_view[0] = NULL;
    }
    return QUELL_OK;
}

static ql_layer *find_layer(ql_frame *frame, const char *full_name, ql_layer *last)
{
    if (last && strcmp(last->full_name, full_name) == 0) return last;
    for (uint32_t i = 0; i < frame->num_layers; i++) {
        if (strcmp(frame->layers[i].full_name, full_name) == 0) return &frame->layers[i];
    }
    return NULL;
}

/* Puts a channel at its place in reading order. -1: the layer has that letter already, or four others. */
static int insert_channel(ql_layer *layer, char letter, int32_t index, int32_t format)
{
    const uint32_t count = layer->num_channels;
    if (count == 4 || strchr(layer->channels, letter)) return -1;
    uint32_t at = count;
    while (at > 0 && ql_channel_order(letter) < ql_channel_order(layer->channels[at - 1])) {
        layer->channels[at] = layer->channels[at - 1];
        layer->channel_index[at] = layer->channel_index[at - 1];
        at--;
    }
    layer->channels[at] = letter;
    layer->channels[count + 1] = '\0';
    layer->channel_index[at] = index;
    layer->num_channels = count + 1;
    if (count == 0) layer->format = format;
    if (layer->format != format) layer->format = QUELL_FORMAT_FLOAT; /* mixed types meet in float */
    return 0;
}

static void skip_channel(listing *list, const char *name)
{
    if (list->num_nameless++ == 0) snprintf(list->nameless, sizeof list->nameless, "%s", name);
}

static quell_status list_part(listing *list, uint32_t index, ql_error *err)
{
    ql_exr_source *source = list->source;
    const ql_exr_part *part = &source->parts[index];
    const char *part_view = view_of_part(source, index);
    const char *const views_of_part[] = {part_view, NULL};
    const char *const *multi_view = source->is_multi_part ? views_of_part : list->multi_view;
    char full_name[MAX_NAME_BYTES], letter;
    int32_t role;
    ql_layer *layer = NULL;

    for (int32_t c = 0; c < part->channels->num_channels; c++) {
        const exr_attr_chlist_entry_t *channel = &part->channels->entries[c];
        const char *name = channel->name.str;
        if (name_layer(name, multi_view, part_view, full_name, &role, &letter) != 0) {
            skip_channel(list, name);
            continue;
        }
        ql_layer *found = find_layer(list->frame, full_name, layer);
        if (found && found->part != index) { /* the same name in two parts: the first has it */
            skip_channel(list, name);
            continue;
        }
        layer = found;
        if (!layer) {
            QL_TRY(ql_frame_append_layer(list->frame, full_name, multi_view, &layer, err));
            layer->part = index;
            layer->compression = exr_compression_name(part->compression);
        }
        if (insert_channel(layer, letter, c, ql_exr_format(channel->pixel_type)) != 0) skip_channel(list, name);
    }
    return QUELL_OK;
}

/* The compositor's result stands first in the file under a layer name of its own. It is no render. */
static int is_composite(const ql_frame *frame, const ql_layer *layer)
{
    int has_others = 0;
    if (strcmp(layer->view_layer, "Composite") != 0 || layer->role != QUELL_ROLE_COMBINED) return 0;
    for (uint32_t i = 0; i < frame->num_layers; i++) {
        const ql_layer *other = &frame->layers[i];
        if (strcmp(other->view_layer, "Composite") != 0) {
            has_others = 1;
        } else if (strcmp(other->pass, layer->pass) != 0) {
            return 0; /* a view layer of that name */
        }
    }
    return has_others;
}

/* "cycles.LAYER.samples" is a text, and only the first part has it. */
static uint32_t read_samples(const ql_exr_source *source, const char *view_layer)
{
    char name[MAX_NAME_BYTES];
    const exr_attribute_t *attribute = NULL;
    snprintf(name, sizeof name, "cycles.%s.samples", view_layer);
    for (uint32_t p = 0; p < source->num_parts; p++) {
        if (exr_get_attribute_by_name(source->context, (int)p, name, &attribute) != EXR_ERR_SUCCESS) continue;
        if (attribute->type != EXR_ATTR_STRING || !attribute->string->str) continue;
        const unsigned long value = strtoul(attribute->string->str, NULL, 10);
        return value <= INT32_MAX ? (uint32_t)value : 0;
    }
    return 0;
}

static void finish_layers(const listing *list)
{
    ql_frame *frame = list->frame;
    for (uint32_t i = 0; i < frame->num_layers; i++) {
        ql_layer *layer = &frame->layers[i];
        if (!ql_role_fits_channels(layer->role, layer->channels) || layer->format == QUELL_FORMAT_UINT) {
            layer->role = QUELL_ROLE_OTHER;
        }
        const ql_layer *before = i ? &frame->layers[i - 1] : NULL;
        const int is_same = before && strcmp(before->view_layer, layer->view_layer) == 0;
        layer->samples = is_same ? before->samples : read_samples(list->source, layer->view_layer);
    }
    for (uint32_t i = 0; i < frame->num_layers; i++) {
        ql_layer *layer = &frame->layers[i];
        if (is_composite(frame, layer)) layer->role = QUELL_ROLE_OTHER;
    }
    ql_exr_messages_clear(&list->source->messages);
}

quell_status ql_exr_list_layers(ql_env *env, ql_exr_source *source, ql_frame *frame, ql_error *err)
{
    listing list = {.env = env, .source = source, .frame = frame};
    quell_status status;
    uint64_t num_channels = 0;
    for (uint32_t p = 0; p < source->num_parts; p++) num_channels += (uint64_t)source->parts[p].channels->num_channels;
    if (num_channels > MAX_CHANNELS) {
        return ql_fail(err, QUELL_ERR_LIMIT, "%s: has %llu channels, more than the limit of %d",
                       ql_file_path(source->file), (unsigned long long)num_channels, MAX_CHANNELS);
    }
    QL_TRY_GOTO(read_multi_view(&list, err));
    QL_TRY_GOTO(choose_size(&list, err));
    for (uint32_t p = 0; p < source->num_parts; p++) {
        if (source->parts[p].is_listed) QL_TRY_GOTO(list_part(&list, p, err));
    }
    finish_layers(&list);
    if (list.num_nameless) {
        char text[1400];
        snprintf(text, sizeof text, "%s: %u channels belong to no layer (such as '%s') and are kept as they are",
                 ql_file_path(source->file), list.num_nameless, list.nameless);
        warn(env, text);
    }
    status = QUELL_OK;
fail:
    ql_free(source->memory, list.multi_view);
    return status;
}
