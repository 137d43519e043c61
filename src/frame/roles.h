/* SPDX-License-Identifier: Apache-2.0 */
/* Blender's names for passes, of every version, and what they mean. The only place that knows them. */
#ifndef QL_FRAME_ROLES_H
#define QL_FRAME_ROLES_H

#include <stdint.h>

/* Depths from here on are background: Cycles writes 1e10, or FLT_MAX / spp, where a ray left the scene. */
#define QL_BACKGROUND_DEPTH 1e9f

/* The kernels that filter a layer; layers of one group share them. */
enum {
    QL_GROUP_NONE = -1,  /* never filtered by default */
    QL_GROUP_BEAUTY = 0, /* Combined, emission, environment, ambient occlusion, shadow catcher, light groups */
    QL_GROUP_DIFFUSE = 1,
    QL_GROUP_GLOSSY = 2,
    QL_GROUP_TRANSMISSION = 3,
    QL_GROUP_VOLUME = 4,
    QL_GROUP_COLOR = 5, /* diffuse, glossy and transmission colour */
    QL_GROUP_EMISSION = 6, /* emission and environment beside all light passes */
    QL_NUM_GROUPS = 7
};

int32_t ql_role_from_pass(const char *pass); /* "DiffDir", "Diffuse Direct", "Combined_key", ...: QUELL_ROLE_* */
const char *ql_role_name(int32_t role);
int32_t ql_role_group(int32_t role);
int32_t ql_role_is_indirect(int32_t role); /* 1: the indirect half of a group of light */
int32_t ql_role_color(int32_t role); /* role of the colour pass a light pass is divided by; QUELL_ROLE_OTHER: none */

/* Splits "LAYER.PASS.VIEW.C" or "LAYER.PASS.C" from the right. multi_view: NULL-terminated list of view names, or NULL.
 * Each out points into full_name's copy in buffer (at least strlen + 1 bytes). has_channel: whether the last part is a
 * channel letter. Returns 0, or -1 when the name has no recognised channel letter. */
int ql_split_channel_name(const char *full_name, const char *const *multi_view, char *buffer, const char **view_layer,
                          const char **pass, const char **view, char *channel);

/* The same for a layer's name without channel letter: "LAYER.PASS.VIEW", "LAYER.PASS" or "PASS". buffer may be full_name
 * itself. Parts that are absent are "". */
void ql_split_layer_name(const char *full_name, const char *const *multi_view, char *buffer, const char **view_layer,
                         const char **pass, const char **view);

/* Rank of a channel letter in reading order (R before G, X before Y, U before V, A last of its kind); -1: no letter that
 * Blender uses. */
int ql_channel_order(char letter);

/* Letters that a layer of this role has when its maker named none: "RGBA", "XYZ", "Z"; static text. */
const char *ql_role_channels(int32_t role, uint32_t num_channels);

/* Whether a layer with these letters (in reading order) can be what its name says: Combined must be RGB or RGBA. */
int ql_role_fits_channels(int32_t role, const char *channels);

#endif
