/* SPDX-License-Identifier: Apache-2.0 */
/* Plans: sets of layers, what is denoised, how Combined is made. */
#include "plan/plan.h"

#include <string.h>

/* Half floats of some twenty summed passes round to about 1e-3 of the mean. training/data/pack.py: CLOSURE_TOLERANCE */
#define CLOSURE_TOLERANCE 5e-3

static const int32_t light_roles[] = {
    QUELL_ROLE_DIFFUSE_DIRECT,      QUELL_ROLE_DIFFUSE_INDIRECT,      QUELL_ROLE_DIFFUSE_COLOR,
    QUELL_ROLE_GLOSSY_DIRECT,       QUELL_ROLE_GLOSSY_INDIRECT,       QUELL_ROLE_GLOSSY_COLOR,
    QUELL_ROLE_TRANSMISSION_DIRECT, QUELL_ROLE_TRANSMISSION_INDIRECT, QUELL_ROLE_TRANSMISSION_COLOR,
};

static int same_set(const ql_layer *a, const ql_layer *b)
{
    return strcmp(a->view_layer, b->view_layer) == 0 && strcmp(a->view, b->view) == 0;
}

static int is_guide(int32_t role)
{
    return role == QUELL_ROLE_DENOISING_ALBEDO || role == QUELL_ROLE_DENOISING_NORMAL ||
           role == QUELL_ROLE_DENOISING_DEPTH;
}

/* One name of a comma-separated list, without the spaces round it. */
typedef struct list_name {
    const char *text;
    size_t length;
} list_name;

/* Takes the next name off *list; 0 at its end. Empty names are left out. */
static int next_name(const char **list, list_name *out)
{
    while (**list == ' ' || **list == ',') ++*list;
    if (**list == '\0') return 0;
    out->text = *list;
    out->length = strcspn(*list, ",");
    *list += out->length;
    while (out->text[out->length - 1] == ' ') --out->length;
    return 1;
}

static int is_named(const ql_layer *layer, const list_name *name)
{
    return (strlen(layer->full_name) == name->length && memcmp(layer->full_name, name->text, name->length) == 0) ||
           (strlen(layer->pass) == name->length && memcmp(layer->pass, name->text, name->length) == 0);
}

/* Whether a list holds the layer's full name or pass name. */
static int list_has(const char *list, const ql_layer *layer)
{
    list_name name;
    while (next_name(&list, &name))
        if (is_named(layer, &name)) return 1;
    return 0;
}

/* Finds the first entry of the list that names no layer of the frame; 0 when there is none. */
static int find_missing_name(const ql_frame *frame, const char *list, list_name *name)
{
    while (next_name(&list, name)) {
        uint32_t i = 0;
        while (i < frame->num_layers && !is_named(&frame->layers[i], name)) ++i;
        if (i == frame->num_layers) return 1;
    }
    return 0;
}

static quell_status find_sets(const ql_frame *frame, ql_memory *memory, ql_plan *plan, ql_error *err)
{
    plan->layers = ql_alloc_zero(memory, frame->num_layers, sizeof *plan->layers);
    plan->sets = ql_alloc_zero(memory, frame->num_layers, sizeof *plan->sets);
    plan->num_layers = frame->num_layers;
    if (plan->layers == NULL || plan->sets == NULL) return ql_fail(err, QUELL_ERR_OUT_OF_MEMORY, "out of memory: plan");
    for (uint32_t i = 0; i < frame->num_layers; ++i) {
        const ql_layer *const layer = &frame->layers[i];
        ql_plan_layer *const out = &plan->layers[i];
        *out = (ql_plan_layer){QUELL_ACTION_UNTOUCHED, "", QL_GROUP_NONE, (int32_t)i, QL_PLAN_NONE};
        /* The compositor's result is an image of its own, with nothing beside it that tells noise from detail. */
        if (strcmp(layer->view_layer, "Composite") == 0 && layer->role == QUELL_ROLE_COMBINED) {
            out->reason = "the compositor's result";
            continue;
        }
        uint32_t first = 0;
        while (first < i && (plan->layers[first].set == QL_PLAN_NONE || !same_set(&frame->layers[first], layer)))
            ++first;
        if (first < i) {
            out->set = plan->layers[first].set;
        } else {
            out->set = (int32_t)plan->num_sets++;
            for (uint32_t r = 0; r < QL_NUM_ROLES; ++r) plan->sets[out->set].role_layer[r] = QL_PLAN_NONE;
        }
        ql_plan_set *const set = &plan->sets[out->set];
        const int usable = layer->pixels.data != NULL && layer->role != QUELL_ROLE_OTHER;
        if (usable && set->role_layer[layer->role] == QL_PLAN_NONE) set->role_layer[layer->role] = (int32_t)i;
        if (set->samples == 0) set->samples = layer->samples;
    }
    for (uint32_t s = 0; s < plan->num_sets; ++s) {
        ql_plan_set *const set = &plan->sets[s];
        const int32_t noisy = set->role_layer[QUELL_ROLE_NOISY_IMAGE];
        set->beauty = noisy != QL_PLAN_NONE ? noisy : set->role_layer[QUELL_ROLE_COMBINED];
        set->has_light = set->beauty != QL_PLAN_NONE;
        for (size_t i = 0; i < sizeof light_roles / sizeof *light_roles; ++i)
            if (set->role_layer[light_roles[i]] == QL_PLAN_NONE) set->has_light = 0;
    }
    return QUELL_OK;
}

/* The noisy original of a layer that Blender denoised, or the layer itself. */
static int32_t source_of(const ql_plan_set *set, const ql_layer *layer, int32_t index)
{
    int32_t noisy = QL_PLAN_NONE;
    if (layer->role == QUELL_ROLE_COMBINED) noisy = set->role_layer[QUELL_ROLE_NOISY_IMAGE];
    if (layer->role == QUELL_ROLE_SHADOW_CATCHER) noisy = set->role_layer[QUELL_ROLE_NOISY_SHADOW_CATCHER];
    return noisy != QL_PLAN_NONE ? noisy : index;
}

static void choose(const ql_frame *frame, const char *wanted, ql_plan *plan, uint32_t index)
{
    const ql_layer *const layer = &frame->layers[index];
    ql_plan_layer *const out = &plan->layers[index];
    if (out->set == QL_PLAN_NONE) return;
    const ql_plan_set *const set = &plan->sets[out->set];
    const int all = wanted == NULL || *wanted == '\0' || strcmp(wanted, "all") == 0;
    const int beauty = wanted != NULL && strcmp(wanted, "beauty") == 0;
    int32_t group = ql_role_group(layer->role);
    const int named = !all && !beauty && list_has(wanted, layer);
    if (named && group == QL_GROUP_NONE) group = QL_GROUP_BEAUTY;

    if (is_guide(layer->role)) {
        out->action = QUELL_ACTION_GUIDE;
        out->reason = "guide";
    }
    if (layer->role == QUELL_ROLE_NOISY_IMAGE || layer->role == QUELL_ROLE_NOISY_SHADOW_CATCHER) {
        out->reason = "noisy original";
        return;
    }
    if (group == QL_GROUP_NONE) {
        if (out->action == QUELL_ACTION_UNTOUCHED) out->reason = "data";
        return;
    }
    if (!(all || named || (beauty && layer->role == QUELL_ROLE_COMBINED))) {
        out->reason = "not asked for";
        return;
    }
    if (set->beauty == QL_PLAN_NONE) {
        out->reason = "its view layer has no Combined to make features from";
        return;
    }
    if (layer->pixels.data == NULL) {
        out->reason = "its pixels were not read";
        return;
    }
    if (!set->has_light && group == QL_GROUP_COLOR) {
        out->action = QUELL_ACTION_SKIPPED;
        out->reason = "colours need all light passes";
        return;
    }
    out->action = QUELL_ACTION_DENOISED;
    out->source = source_of(set, layer, (int32_t)index);
    /* What the camera sees directly is noisy at edges and under blur alone, as colours are. */
    if (layer->role == QUELL_ROLE_EMISSION || layer->role == QUELL_ROLE_ENVIRONMENT) group = QL_GROUP_EMISSION;
    /* The other groups' kernels were trained with all light passes beside each other. */
    out->group = set->has_light ? group : QL_GROUP_BEAUTY;
}

static void count(ql_plan *plan)
{
    plan->num_denoised = 0;
    for (uint32_t i = 0; i < plan->num_layers; ++i)
        plan->num_denoised += plan->layers[i].action == QUELL_ACTION_DENOISED;
}

quell_status ql_plan_create(const ql_frame *frame, const char *wanted, ql_memory *memory, ql_plan *plan, ql_error *err)
{
    list_name name;
    memset(plan, 0, sizeof *plan);
    const int is_list = wanted && *wanted && strcmp(wanted, "all") != 0 && strcmp(wanted, "beauty") != 0;
    if (is_list && find_missing_name(frame, wanted, &name))
        return ql_fail(err, QUELL_ERR_NO_LAYER, "there is no layer '%.*s'; `quell inspect` lists the names",
                       (int)(name.length < 256 ? name.length : 256), name.text);
    quell_status status = find_sets(frame, memory, plan, err);
    if (status == QUELL_OK) {
        for (uint32_t i = 0; i < frame->num_layers; ++i) choose(frame, wanted, plan, i);
        count(plan);
        if (plan->num_denoised == 0)
            status = ql_fail(err, QUELL_ERR_NO_LAYER,
                             "nothing to denoise: no Combined or 'Noisy Image' pass with "
                             "colours among what was asked for; `quell inspect` lists the passes");
    }
    if (status != QUELL_OK) ql_plan_free(plan, memory);
    return status;
}

/* Whether the colour that a light pass was divided by is there and black everywhere. */
static int has_black_color(const ql_plan *plan, const ql_frame *frame, uint32_t index, const ql_layer_facts *facts)
{
    const ql_plan_set *const set = &plan->sets[plan->layers[index].set];
    const int32_t role = ql_role_color(frame->layers[index].role);
    if (!set->has_light || role == QUELL_ROLE_OTHER) return 0;
    return facts[set->role_layer[role]].is_zero;
}

static void skip(ql_plan *plan, uint32_t index, const char *reason)
{
    plan->layers[index].action = QUELL_ACTION_SKIPPED;
    plan->layers[index].reason = reason;
    count(plan);
}

void ql_plan_skip(ql_plan *plan, const ql_frame *frame, const ql_layer_facts *facts)
{
    for (uint32_t i = 0; i < plan->num_layers; ++i) {
        const ql_plan_layer *const layer = &plan->layers[i];
        if (layer->action != QUELL_ACTION_DENOISED) continue;
        /* A layer that Blender denoised needs its noisy original's filtered pixels even if that is constant. */
        if (layer->source != (int32_t)i) continue;
        if (facts[i].is_zero)
            skip(plan, i, "zero everywhere");
        else if (facts[i].is_constant)
            skip(plan, i, "the same everywhere");
        else if (has_black_color(plan, frame, i, facts))
            skip(plan, i, "its colour is black everywhere");
    }
}

void ql_plan_skip_clean(ql_plan *plan, uint32_t layer, int32_t is_finished)
{
    skip(plan, layer, is_finished ? "finished: many samples, no noise that shows" : "clean: no noise that shows");
}

void ql_plan_choose_combined(ql_plan *plan, uint32_t index, const double closure[2])
{
    ql_plan_set *const set = &plan->sets[index];
    const int32_t combined = set->role_layer[QUELL_ROLE_COMBINED];
    set->combined = QL_COMBINED_DIRECT;
    if (!set->has_light || combined == QL_PLAN_NONE || plan->layers[combined].action != QUELL_ACTION_DENOISED) return;
    /* Passes that nobody asked for are not filtered, so there is nothing to sum. */
    for (uint32_t r = 0; r < QL_NUM_ROLES; ++r) {
        const int32_t layer = set->role_layer[r];
        const int is_part = (r >= QUELL_ROLE_DIFFUSE_DIRECT && r <= QUELL_ROLE_ENVIRONMENT);
        if (is_part && layer != QL_PLAN_NONE && plan->layers[layer].action == QUELL_ACTION_UNTOUCHED) return;
    }
    if (closure[1] <= closure[0] && closure[1] < CLOSURE_TOLERANCE)
        set->combined = QL_COMBINED_PASSES_ENVIRONMENT;
    else if (closure[0] < CLOSURE_TOLERANCE)
        set->combined = QL_COMBINED_PASSES;
}

const char *ql_plan_combined_name(int32_t combined)
{
    return combined == QL_COMBINED_PASSES               ? "from passes"
           : combined == QL_COMBINED_PASSES_ENVIRONMENT ? "from passes and environment"
                                                        : "direct";
}

void ql_plan_free(ql_plan *plan, ql_memory *memory)
{
    ql_free(memory, plan->layers);
    ql_free(memory, plan->sets);
    memset(plan, 0, sizeof *plan);
}
