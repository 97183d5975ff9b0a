"""What a command needs around it: standard streams, names as UTF-8, a working directory.

A job scheduler may close the streams, a minimal container has no locale, a folder may be removed under one's feet. None
of it is a fault of the command, and none may stop it without a message.
"""

from __future__ import annotations

import errno
import os
import sys
from io import TextIOWrapper
from pathlib import Path

from cyclekit.errors import CyclekitError

_CURES = {
    errno.ENOSPC: "Free some space, or write somewhere else.",
    errno.EDQUOT: "Free some space, or write somewhere else.",
    errno.EACCES: "Check its permissions.",
    errno.EPERM: "Check its permissions.",
    errno.ENAMETOOLONG: "Give it a shorter name.",
    errno.ELOOP: "A link leads back to itself: remove it.",
    errno.EMFILE: "Allow more open files: ulimit -n 4096",
}


def restart_in_utf8() -> None:
    """Begin the process again in Python's UTF-8 mode if names of files would be ASCII otherwise.

    With LC_ALL=C and PYTHONUTF8=0 Python and the readers of Parquet files disagree about every name that is not ASCII.
    """
    if sys.getfilesystemencoding() != "ascii" or sys.flags.utf8_mode or not sys.executable:
        return
    os.environ["PYTHONUTF8"] = "1"
    os.execv(sys.executable, [sys.executable, "-X", "utf8", *sys.orig_argv[1:]])


def complete_streams() -> None:
    """Open the null device for every standard stream that is closed, and let no character fail on the others.

    The numbers 0 to 2 are taken first: else the next file that is opened for writing would get the number of standard
    error, and messages of the system would end up in it.
    """
    while (number := os.open(os.devnull, os.O_RDWR)) <= 2:
        os.set_inheritable(number, True)  # for worker processes, too
    os.close(number)
    for name, mode in (("stdin", "r"), ("stdout", "w"), ("stderr", "w")):
        if getattr(sys, name) is None:
            setattr(sys, name, Path(os.devnull).open(mode, encoding="utf-8"))  # noqa: SIM115 - for the whole process
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, TextIOWrapper):  # a place called Kühlregal must not end in a traceback on an old terminal
            stream.reconfigure(errors="backslashreplace")


def flush() -> None:
    """Bring to an end what was said on standard output.

    Raises:
        OSError: It cannot be written; what is left of it is dropped, so that Python's own attempt at exit is silent.
    """
    try:
        sys.stdout.flush()
    except OSError:
        drop_output()
        raise


def drop_output() -> None:
    """Let whatever else is said on standard output go nowhere."""
    sys.stdout = Path(os.devnull).open("w", encoding="utf-8")  # noqa: SIM115 - for the rest of the process


def check_working_directory() -> None:
    """Refuse to work in a folder that has been removed.

    Raises:
        CyclekitError: It has.
    """
    try:
        Path.cwd()
    except OSError as error:
        msg = f"the working directory cannot be used ({error.strerror})"
        raise CyclekitError(msg, cure="It was removed or renamed: change to another one with cd.") from error


def explained(error: OSError) -> str:
    """Return what the system has refused as a message of ours: which file, why, and the cure."""
    cure = _CURES.get(error.errno or 0, "Check the file or folder, its permissions and the free space.")
    if error.errno is None:  # from a library below, which has put all of it into one sentence
        return f"{error}\n  {cure}"
    named = "standard output" if is_of_output(error) else os.fsdecode(error.filename)
    return f"{named}: {error.strerror}\n  {cure}"


def is_of_output(error: OSError) -> bool:
    """Tell whether it was standard output that could not be written: every other file has a name."""
    return error.errno is not None and not isinstance(error.filename, str | bytes)
