#!/bin/sh
# SPDX-License-Identifier: Apache-2.0
# A Slurm array: one frame per task. Nodes need Python with the package quell; PYTHON names another one than python3.
#
#   sbatch --array=1-240 samples/farm/slurm_array.sh 'render/shot_####.exr' 'clean/shot_####.exr'
#
# Options behind the two names go to batch.py, such as --quality high. Submitted again, finished frames are left alone. QUELL_BATCH names batch.py where it is not at its place below the
# folder that sbatch was called in.
#SBATCH --job-name=quell
#SBATCH --cpus-per-task=2
set -eu
exec "${PYTHON:-python3}" "${QUELL_BATCH:-samples/batch.py}" "$@" \
    --frames "$SLURM_ARRAY_TASK_ID" --threads "${SLURM_CPUS_PER_TASK:-0}"
