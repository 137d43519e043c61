# SPDX-License-Identifier: Apache-2.0
"""DGAN-KPN (Alzbier and Chen, Symmetry 14, 395, 2022) and the KPCN baseline (Bako et al. 2017)."""
