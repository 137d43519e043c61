/* SPDX-License-Identifier: Apache-2.0 */
/* The embedding: at full resolution for all of a region, coarser for the columns that filters are working on. */
#ifndef QL_MODELS_QUELL_WINDOW_H
#define QL_MODELS_QUELL_WINDOW_H

#include "models/quell_net.h"

/* Adds the body's share to maps->embedding, which has the stem's. */
quell_status ql_net_embed(const ql_net *net, const ql_kernels *kernels, ql_env *env, ql_net_maps *maps, ql_error *err);

/* maps is lent until ql_net_window_close, which frees the window in any case. */
quell_status ql_net_window_open(const ql_net *net, const ql_kernels *kernels, ql_env *env, const ql_net_maps *maps,
                                uint32_t x, uint32_t width, ql_net_window *window, ql_error *err);
void ql_net_window_close(ql_net_window *window, ql_memory *memory);
uint64_t ql_net_window_bytes(uint32_t width, uint32_t height, uint32_t num_workers);

#endif
