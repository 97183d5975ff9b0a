"""Repairs or checks the environment of a command: standard streams, UTF-8 file names, working directory.

A job scheduler may close the streams, a minimal container has no locale, the working directory may have been removed.
None of these may stop a command without a message.
"""

from __future__ import annotations

import errno
import os
import re
import sys
from io import TextIOWrapper
from pathlib import Path

from cyclekit.errors import CyclekitError

_HOME = re.compile(r"\A(--[a-z-]+=|)~(?=/|\\)")
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
    """Restart the process in Python's UTF-8 mode if its file names are ASCII.

    With LC_ALL=C and PYTHONUTF8=0, Python and the Parquet readers encode non-ASCII names differently.
    """
    if sys.getfilesystemencoding() != "ascii" or sys.flags.utf8_mode or not sys.executable:
        return
    os.environ["PYTHONUTF8"] = "1"
    os.execv(sys.executable, [sys.executable, "-X", "utf8", *sys.orig_argv[1:]])


def complete_streams() -> None:
    """Open the null device for every closed standard stream, and escape characters that the others cannot encode.

    File descriptors 0 to 2 are occupied first: else the next output file would get that of standard error, and system
    messages would be written into it.
    """
    while (number := os.open(os.devnull, os.O_RDWR)) <= 2:
        os.set_inheritable(number, True)  # also for worker processes
    os.close(number)
    for name, mode in (("stdin", "r"), ("stdout", "w"), ("stderr", "w")):
        if getattr(sys, name) is None:
            setattr(sys, name, Path(os.devnull).open(mode, encoding="utf-8"))  # noqa: SIM115 - for the whole process
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, TextIOWrapper):  # a place called Kühlregal must not raise on an ASCII terminal
            stream.reconfigure(errors="backslashreplace")


def with_home(words: list[str]) -> list[str]:
    """Return the words of a command line with `~/` replaced by the home folder, also in `--option=~/path`.

    A shell leaves it as it is within quotes and after `=`, and that of Windows everywhere.
    """
    return [_HOME.sub(lambda found: f"{found[1]}{Path.home()}", word) for word in words]


def flush() -> None:
    """Flush standard output.

    Raises:
        OSError: It cannot be written; the rest is discarded, so that Python does not report it again at exit.
    """
    try:
        sys.stdout.flush()
    except OSError:
        drop_output()
        raise


def drop_output() -> None:
    """Discard all further standard output."""
    sys.stdout = Path(os.devnull).open("w", encoding="utf-8")  # noqa: SIM115 - for the rest of the process


def check_working_directory() -> None:
    """Check that the working directory exists.

    Raises:
        CyclekitError: It has been removed.
    """
    try:
        Path.cwd()
    except OSError as error:
        msg = f"the working directory cannot be used ({error.strerror})"
        raise CyclekitError(msg, cure="It was removed or renamed: change to another one with cd.") from error


def explained(error: OSError) -> str:
    """Return the message for an error of the operating system: file, cause and cure."""
    cure = _CURES.get(error.errno or 0, "Check the file or folder, its permissions and the free space.")
    if error.errno is None:  # raised by a library, with everything in its text
        return f"{error}\n  {cure}"
    named = "standard output" if is_of_output(error) else os.fsdecode(error.filename)
    return f"{named}: {error.strerror}\n  {cure}"


def is_of_output(error: OSError) -> bool:
    """Return whether the error is of standard output: errors of other files carry a name."""
    return error.errno is not None and not isinstance(error.filename, str | bytes)
