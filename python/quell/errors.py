# SPDX-License-Identifier: Apache-2.0
"""What can go wrong, as exceptions. Their text is the library's own sentence, which says what to do."""

from __future__ import annotations


class QuellError(Exception):
    """A call failed. `status` is its number in quell.h, `name` its name ("QUELL_ERR_NO_LAYER")."""

    def __init__(self, message: str, status: int = 0, name: str = "") -> None:
        super().__init__(message)
        self.status = status
        self.name = name


class LibraryError(QuellError):
    """libquell is missing, of another version, or not for this machine."""


class CancelledError(QuellError):
    """Context.cancel or a progress callback stopped the call."""


class FileError(QuellError):
    """A file is missing, damaged, no EXR file, of an unsupported kind, or cannot be written."""


class NoLayerError(QuellError):
    """Nothing in the frame can be denoised, or a named layer is not there."""


class ModelError(QuellError):
    """A weight file is missing, damaged, or none."""


class ResourceError(QuellError, MemoryError):
    """Out of memory, or a size over the context's limits."""


_CLASSES: dict[str, type[QuellError]] = {
    "QUELL_ERR_OUT_OF_MEMORY": ResourceError,
    "QUELL_ERR_CANCELLED": CancelledError,
    "QUELL_ERR_FILE_NOT_FOUND": FileError,
    "QUELL_ERR_FILE_READ": FileError,
    "QUELL_ERR_FILE_WRITE": FileError,
    "QUELL_ERR_NOT_EXR": FileError,
    "QUELL_ERR_UNSUPPORTED": FileError,
    "QUELL_ERR_NO_LAYER": NoLayerError,
    "QUELL_ERR_BAD_MODEL": ModelError,
    "QUELL_ERR_LIMIT": ResourceError,
}


def error_for_status(status: int, name: str, message: str) -> QuellError:
    return _CLASSES.get(name, QuellError)(message, status, name)
