# SPDX-License-Identifier: Apache-2.0
"""Says in the summary when the training tests could not run."""

from __future__ import annotations

import pytest


def test_training_packages_are_installed(missing: str | None) -> None:
    if missing:
        pytest.skip(missing)
