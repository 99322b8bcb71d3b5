"""What the machine did to a command, in one message: memory, disk, processes."""

from __future__ import annotations

from concurrent.futures import BrokenExecutor

_ALLOCATION_FAILED = ("RESOURCE_EXHAUSTED", "Out of memory", "Unable to allocate", "bad_alloc")


def failure_message(error: Exception) -> str | None:
    """What an exception says that the machine caused and not the program.

    Parameters
    ----------
    error : Exception
        That ended a command.

    Returns
    -------
    str or None
        What is wrong and what to do; None if the program is at fault.

    Examples
    --------
    >>> failure_message(MemoryError())
    'out of memory; close other programs, or use a machine with more'
    >>> failure_message(OSError(28, "No space left on device", "/run/a.nc"))
    '/run/a.nc: No space left on device; check that the disk has space and may be written'
    >>> failure_message(KeyError("x"))
    """
    text = f"{type(error).__name__} {error}"
    if isinstance(error, MemoryError) or any(part in text for part in _ALLOCATION_FAILED):
        return "out of memory; close other programs, or use a machine with more"
    if isinstance(error, BrokenExecutor):
        return (
            "a worker process was ended from outside, perhaps for want of memory; "
            "start again with fewer --jobs"
        )
    if isinstance(error, OSError) and error.errno is not None:
        place = f"{error.filename}: " if error.filename else ""
        return f"{place}{error.strerror}; check that the disk has space and may be written"
    if isinstance(error, OSError | RuntimeError) and (reason := disk_failure(error)):
        return f"a file cannot be written ({reason}); check that the disk has space"
    return None


def disk_failure(error: Exception) -> str:
    """The reason that the HDF5 library gives in the middle of its words.

    Parameters
    ----------
    error : Exception
        That it raised.

    Returns
    -------
    str
        Such as "No space left on device"; empty if the disk is not at fault.

    Examples
    --------
    >>> disk_failure(RuntimeError("write failed: errno = 28, error message = 'No space', buf = 0"))
    'No space'
    """
    text = str(error)
    if "errno = " not in text or "error message = '" not in text:
        return ""
    return text.partition("error message = '")[2].partition("'")[0]
