/* SPDX-License-Identifier: Apache-2.0 */
/* Blender's pass names and their meaning. Two name tables are in use: short names up to Blender 4.5 ("DiffDir"), long
 * ones from 5.0 on ("Diffuse Direct"); a file may hold either, whatever its layout. Knows no pixels and no files. */
#include "frame/roles.h"

#include "quell.h"

#include <stddef.h>
#include <string.h>

typedef struct pass_name {
    const char *name;
    int32_t role;
} pass_name;

static const pass_name pass_names[] = {
    {"Combined", QUELL_ROLE_COMBINED},
    {"Noisy Image", QUELL_ROLE_NOISY_IMAGE},
    {"DiffDir", QUELL_ROLE_DIFFUSE_DIRECT},
    {"DiffInd", QUELL_ROLE_DIFFUSE_INDIRECT},
    {"DiffCol", QUELL_ROLE_DIFFUSE_COLOR},
    {"GlossDir", QUELL_ROLE_GLOSSY_DIRECT},
    {"GlossInd", QUELL_ROLE_GLOSSY_INDIRECT},
    {"GlossCol", QUELL_ROLE_GLOSSY_COLOR},
    {"TransDir", QUELL_ROLE_TRANSMISSION_DIRECT},
    {"TransInd", QUELL_ROLE_TRANSMISSION_INDIRECT},
    {"TransCol", QUELL_ROLE_TRANSMISSION_COLOR},
    {"VolumeDir", QUELL_ROLE_VOLUME_DIRECT},
    {"VolumeInd", QUELL_ROLE_VOLUME_INDIRECT},
    {"Emit", QUELL_ROLE_EMISSION},
    {"Env", QUELL_ROLE_ENVIRONMENT},
    {"AO", QUELL_ROLE_AMBIENT_OCCLUSION},
    {"Diffuse Direct", QUELL_ROLE_DIFFUSE_DIRECT},
    {"Diffuse Indirect", QUELL_ROLE_DIFFUSE_INDIRECT},
    {"Diffuse Color", QUELL_ROLE_DIFFUSE_COLOR},
    {"Glossy Direct", QUELL_ROLE_GLOSSY_DIRECT},
    {"Glossy Indirect", QUELL_ROLE_GLOSSY_INDIRECT},
    {"Glossy Color", QUELL_ROLE_GLOSSY_COLOR},
    {"Transmission Direct", QUELL_ROLE_TRANSMISSION_DIRECT},
    {"Transmission Indirect", QUELL_ROLE_TRANSMISSION_INDIRECT},
    {"Transmission Color", QUELL_ROLE_TRANSMISSION_COLOR},
    {"Volume Direct", QUELL_ROLE_VOLUME_DIRECT},
    {"Volume Indirect", QUELL_ROLE_VOLUME_INDIRECT},
    {"Volume Scatter", QUELL_ROLE_VOLUME_SCATTER},
    {"Volume Transmit", QUELL_ROLE_VOLUME_TRANSMIT},
    {"Emission", QUELL_ROLE_EMISSION},
    {"Environment", QUELL_ROLE_ENVIRONMENT},
    {"Ambient Occlusion", QUELL_ROLE_AMBIENT_OCCLUSION},
    {"Shadow", QUELL_ROLE_SHADOW},
    {"Shadow Catcher", QUELL_ROLE_SHADOW_CATCHER},
    {"Noisy Shadow Catcher", QUELL_ROLE_NOISY_SHADOW_CATCHER},
    {"Denoising Albedo", QUELL_ROLE_DENOISING_ALBEDO},
    {"Denoising Normal", QUELL_ROLE_DENOISING_NORMAL},
    {"Denoising Depth", QUELL_ROLE_DENOISING_DEPTH},
    {"Depth", QUELL_ROLE_DEPTH},
    {"Normal", QUELL_ROLE_NORMAL},
    {"Position", QUELL_ROLE_POSITION},
    {"Debug Sample Count", QUELL_ROLE_SAMPLE_COUNT},
};

#define LIGHT_GROUP_PREFIX "Combined_"

/* What a role's channels look like; it decides whether a layer of that name is what the name says. */
enum { KIND_ANY, KIND_COLOR, KIND_VECTOR, KIND_SCALAR };

typedef struct role_facts {
    const char *name;
    int8_t group;
    int8_t kind;
    int8_t color; /* role of the colour pass that belongs to a light pass */
} role_facts;

static const role_facts roles[] = {
    [QUELL_ROLE_OTHER] = {"other", QL_GROUP_NONE, KIND_ANY, 0},
    [QUELL_ROLE_COMBINED] = {"combined", QL_GROUP_BEAUTY, KIND_COLOR, 0},
    [QUELL_ROLE_NOISY_IMAGE] = {"noisy-image", QL_GROUP_NONE, KIND_COLOR, 0},
    [QUELL_ROLE_DIFFUSE_DIRECT] = {"diffuse-direct", QL_GROUP_DIFFUSE, KIND_COLOR, QUELL_ROLE_DIFFUSE_COLOR},
    [QUELL_ROLE_DIFFUSE_INDIRECT] = {"diffuse-indirect", QL_GROUP_DIFFUSE, KIND_COLOR, QUELL_ROLE_DIFFUSE_COLOR},
    [QUELL_ROLE_DIFFUSE_COLOR] = {"diffuse-color", QL_GROUP_COLOR, KIND_COLOR, 0},
    [QUELL_ROLE_GLOSSY_DIRECT] = {"glossy-direct", QL_GROUP_GLOSSY, KIND_COLOR, QUELL_ROLE_GLOSSY_COLOR},
    [QUELL_ROLE_GLOSSY_INDIRECT] = {"glossy-indirect", QL_GROUP_GLOSSY, KIND_COLOR, QUELL_ROLE_GLOSSY_COLOR},
    [QUELL_ROLE_GLOSSY_COLOR] = {"glossy-color", QL_GROUP_COLOR, KIND_COLOR, 0},
    [QUELL_ROLE_TRANSMISSION_DIRECT] = {"transmission-direct", QL_GROUP_TRANSMISSION, KIND_COLOR,
                                        QUELL_ROLE_TRANSMISSION_COLOR},
    [QUELL_ROLE_TRANSMISSION_INDIRECT] = {"transmission-indirect", QL_GROUP_TRANSMISSION, KIND_COLOR,
                                          QUELL_ROLE_TRANSMISSION_COLOR},
    [QUELL_ROLE_TRANSMISSION_COLOR] = {"transmission-color", QL_GROUP_COLOR, KIND_COLOR, 0},
    [QUELL_ROLE_VOLUME_DIRECT] = {"volume-direct", QL_GROUP_VOLUME, KIND_COLOR, 0},
    [QUELL_ROLE_VOLUME_INDIRECT] = {"volume-indirect", QL_GROUP_VOLUME, KIND_COLOR, 0},
    [QUELL_ROLE_EMISSION] = {"emission", QL_GROUP_BEAUTY, KIND_COLOR, 0},
    [QUELL_ROLE_ENVIRONMENT] = {"environment", QL_GROUP_BEAUTY, KIND_COLOR, 0},
    [QUELL_ROLE_AMBIENT_OCCLUSION] = {"ambient-occlusion", QL_GROUP_BEAUTY, KIND_COLOR, 0},
    [QUELL_ROLE_SHADOW_CATCHER] = {"shadow-catcher", QL_GROUP_BEAUTY, KIND_COLOR, 0},
    [QUELL_ROLE_NOISY_SHADOW_CATCHER] = {"noisy-shadow-catcher", QL_GROUP_NONE, KIND_COLOR, 0},
    [QUELL_ROLE_LIGHT_GROUP] = {"light-group", QL_GROUP_BEAUTY, KIND_COLOR, 0},
    [QUELL_ROLE_DENOISING_ALBEDO] = {"denoising-albedo", QL_GROUP_NONE, KIND_COLOR, 0},
    [QUELL_ROLE_DENOISING_NORMAL] = {"denoising-normal", QL_GROUP_NONE, KIND_VECTOR, 0},
    [QUELL_ROLE_DENOISING_DEPTH] = {"denoising-depth", QL_GROUP_NONE, KIND_SCALAR, 0},
    [QUELL_ROLE_DEPTH] = {"depth", QL_GROUP_NONE, KIND_SCALAR, 0},
    [QUELL_ROLE_NORMAL] = {"normal", QL_GROUP_NONE, KIND_VECTOR, 0},
    [QUELL_ROLE_POSITION] = {"position", QL_GROUP_NONE, KIND_VECTOR, 0},
    [QUELL_ROLE_SAMPLE_COUNT] = {"sample-count", QL_GROUP_NONE, KIND_SCALAR, 0},
    [QUELL_ROLE_SHADOW] = {"shadow", QL_GROUP_BEAUTY, KIND_COLOR, 0},
    /* Statistics that guide Cycles' volume sampling; no part of the image. */
    [QUELL_ROLE_VOLUME_SCATTER] = {"volume-scatter", QL_GROUP_NONE, KIND_COLOR, 0},
    [QUELL_ROLE_VOLUME_TRANSMIT] = {"volume-transmit", QL_GROUP_NONE, KIND_COLOR, 0},
};

static const role_facts *facts_of(int32_t role)
{
    const size_t count = sizeof roles / sizeof roles[0];
    return role >= 0 && (size_t)role < count ? &roles[role] : &roles[QUELL_ROLE_OTHER];
}

int32_t ql_role_from_pass(const char *pass)
{
    for (size_t i = 0; i < sizeof pass_names / sizeof pass_names[0]; i++) {
        if (strcmp(pass, pass_names[i].name) == 0) return pass_names[i].role;
    }
    const size_t prefix = sizeof LIGHT_GROUP_PREFIX - 1;
    if (strncmp(pass, LIGHT_GROUP_PREFIX, prefix) == 0 && pass[prefix]) return QUELL_ROLE_LIGHT_GROUP;
    return QUELL_ROLE_OTHER;
}

const char *ql_role_name(int32_t role)
{
    return facts_of(role)->name;
}

int32_t ql_role_group(int32_t role)
{
    return facts_of(role)->group;
}

int32_t ql_role_is_indirect(int32_t role)
{
    return role == QUELL_ROLE_DIFFUSE_INDIRECT || role == QUELL_ROLE_GLOSSY_INDIRECT ||
           role == QUELL_ROLE_TRANSMISSION_INDIRECT || role == QUELL_ROLE_VOLUME_INDIRECT;
}

int32_t ql_role_color(int32_t role)
{
    return facts_of(role)->color;
}

/* ---- Channels ---------------------------------------------------------------------------------------------------- */

/* Reading order of letters, which stand sorted in files: colour, vector, UV with its coverage (A), Cryptomatte. */
static const char reading_order[] = "RGBXYZWUVArgba";

int ql_channel_order(char letter)
{
    const char *found = letter ? strchr(reading_order, letter) : NULL;
    return found ? (int)(found - reading_order) : -1;
}

const char *ql_role_channels(int32_t role, uint32_t num_channels)
{
    static const char *const color[] = {"", "V", "RG", "RGB", "RGBA"};
    static const char *const vector[] = {"", "X", "XY", "XYZ", "XYZW"};
    if (num_channels > 4) return "";
    const int kind = facts_of(role)->kind;
    if (kind == KIND_VECTOR) return vector[num_channels];
    if (num_channels > 1) return color[num_channels];
    if (role == QUELL_ROLE_DEPTH || role == QUELL_ROLE_DENOISING_DEPTH) return num_channels ? "Z" : "";
    return kind == KIND_SCALAR ? vector[num_channels] : color[num_channels];
}

int ql_role_fits_channels(int32_t role, const char *channels)
{
    switch (facts_of(role)->kind) {
    case KIND_COLOR: return strcmp(channels, "RGB") == 0 || strcmp(channels, "RGBA") == 0;
    case KIND_VECTOR: return strcmp(channels, "XYZ") == 0 || strcmp(channels, "RGB") == 0;
    case KIND_SCALAR: return strlen(channels) == 1;
    default: return 1;
    }
}

/* ---- Names ------------------------------------------------------------------------------------------------------- */

static int is_view(const char *text, const char *const *multi_view)
{
    for (size_t i = 0; multi_view && multi_view[i]; i++) {
        if (strcmp(text, multi_view[i]) == 0) return 1;
    }
    return 0;
}

void ql_split_layer_name(const char *full_name, const char *const *multi_view, char *buffer, const char **view_layer,
                         const char **pass, const char **view)
{
    const size_t length = strlen(full_name);
    char *end = buffer + length; /* the empty text behind the name */
    memmove(buffer, full_name, length + 1);
    *view_layer = end;
    *view = end;
    *pass = buffer;

    char *dot = strrchr(buffer, '.');
    if (dot && is_view(dot + 1, multi_view)) {
        *dot = '\0';
        *view = dot + 1;
        dot = strrchr(buffer, '.');
    }
    if (dot) {
        *dot = '\0';
        *pass = dot + 1;
        *view_layer = buffer;
    }
}

int ql_split_channel_name(const char *full_name, const char *const *multi_view, char *buffer, const char **view_layer,
                          const char **pass, const char **view, char *channel)
{
    const size_t length = strlen(full_name);
    if (length == 0) return -1;
    const char letter = full_name[length - 1];
    if (ql_channel_order(letter) < 0) return -1;

    if (length == 1) { /* no prefix: a plain EXR file */
        memmove(buffer, full_name, length + 1);
        *view_layer = *view = buffer + length;
        *pass = strchr("RGBA", letter) ? "Combined" : letter == 'Z' ? "Depth" : buffer;
        *channel = letter;
        return 0;
    }
    if (length < 3 || full_name[length - 2] != '.') return -1;

    memmove(buffer, full_name, length - 2);
    buffer[length - 2] = '\0';
    *channel = letter;
    ql_split_layer_name(buffer, multi_view, buffer, view_layer, pass, view);
    return 0;
}
