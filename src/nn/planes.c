/* SPDX-License-Identifier: Apache-2.0 */
#include "nn/planes.h"

size_t ql_planes_bytes(uint32_t width, uint32_t height, uint32_t num, uint32_t margin)
{
    return ((size_t)width + 2 * margin) * ((size_t)height + 2 * margin) * num * sizeof(float);
}

quell_status ql_planes_create(ql_planes *planes, uint32_t width, uint32_t height, uint32_t num, uint32_t margin,
                              ql_memory *memory, ql_error *err)
{
    *planes = (ql_planes){.width = width, .height = height, .num = num, .margin = margin};
    planes->stride = (ptrdiff_t)width + 2 * (ptrdiff_t)margin;
    planes->plane = (size_t)planes->stride * ((size_t)height + 2 * margin);
    planes->data = ql_alloc_zero(memory, planes->plane, num * sizeof *planes->data);
    if (planes->data == NULL)
        return ql_fail(err, QUELL_ERR_OUT_OF_MEMORY, "out of memory: %u planes of %ux%u", num, width, height);
    return QUELL_OK;
}

void ql_planes_destroy(ql_planes *planes, ql_memory *memory)
{
    ql_free(memory, planes->data);
    planes->data = NULL;
}

float *ql_planes_row(const ql_planes *planes, uint32_t plane, uint32_t y)
{
    return planes->data + plane * planes->plane + ((ptrdiff_t)y + planes->margin) * planes->stride + planes->margin;
}
