/* SPDX-License-Identifier: Apache-2.0 */
/* DGAN-KPN whole: generator and kernel predictor of one weight file. training/dgan/ is the same in PyTorch. */
#ifndef QL_MODELS_DGAN_H
#define QL_MODELS_DGAN_H

#include "models/generator.h"
#include "models/kpn.h"

typedef struct ql_dgan {
    ql_generator generator;
    ql_kpn kpn;
    uint64_t num_parameters; /* values of the file's weights */
} ql_dgan;

quell_status ql_dgan_load(ql_dgan *dgan, const ql_weights *weights, ql_memory *memory, ql_error *err);
void ql_dgan_free(ql_dgan *dgan, ql_memory *memory);

#endif
