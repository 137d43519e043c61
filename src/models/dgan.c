/* SPDX-License-Identifier: Apache-2.0 */
/* Loads both networks, or none. */
#include "models/dgan.h"

quell_status ql_dgan_load(ql_dgan *dgan, const ql_weights *weights, ql_memory *memory, ql_error *err)
{
    dgan->num_parameters = 0;
    for (uint32_t i = 0; i < weights->num_records; ++i) {
        const uint32_t type = weights->records[i].type;
        if (type == QL_RECORD_FLOAT || type == QL_RECORD_HALF) dgan->num_parameters += weights->records[i].num_values;
    }
    QL_TRY(ql_generator_load(&dgan->generator, weights, memory, err));
    const quell_status status = ql_kpn_load(&dgan->kpn, weights, memory, err);
    if (status != QUELL_OK) ql_generator_free(&dgan->generator, memory);
    return status;
}

void ql_dgan_free(ql_dgan *dgan, ql_memory *memory)
{
    ql_generator_free(&dgan->generator, memory);
    ql_kpn_free(&dgan->kpn, memory);
}
