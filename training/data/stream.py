# SPDX-License-Identifier: Apache-2.0
"""Items made ahead of their use, in threads of their own, in order."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from typing import TypeVar

T = TypeVar("T")


def stream(make: Callable[[int], T], first: int, workers: int = 1) -> Iterator[T]:
    """Yields make(first), make(first + 1), ...; a few more than `workers` are ready or being made at any time."""
    with ThreadPoolExecutor(workers) as executor:
        pending = [executor.submit(make, first + i) for i in range(workers + 3)]
        try:
            while True:
                yield pending.pop(0).result()
                first += 1
                pending.append(executor.submit(make, first + len(pending)))
        finally:
            for item in pending:
                item.cancel()
