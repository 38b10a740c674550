"""Files that are written completely or not at all."""

import errno
import os
import secrets
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path


@contextmanager
def replacing(path: str | os.PathLike[str]) -> Iterator[Path]:
    """Give a temporary path to write to; it takes the place of `path` when the block ends without an error.

    The temporary file lies in the same folder, so that the replacement is one atomic step, and has the same suffix,
    since many writers choose their format by it. On any error (Ctrl-C included) it is removed and what was at `path`
    stays as it was. A symbolic link at `path` stays a link: the file it points to is replaced.

    Raises FileNotFoundError where the folder does not exist, PermissionError where it cannot be written to, and
    IsADirectoryError where `path` is a folder; all three before the block is entered. Raises OSError with the name of
    the file where the disk is full.
    """
    target = writable(path)
    temporary = target.with_name(f".{secrets.token_hex(8)}{Path(path).suffix}")
    try:
        yield temporary
        os.replace(temporary, target)
    except (OSError, RuntimeError) as error:  # NumPy's OSError has no number, and OpenEXR raises RuntimeError
        full = getattr(error, "errno", None) in (errno.ENOSPC, errno.EDQUOT)
        if not full and shutil.disk_usage(target.parent).free > 0:
            raise
        message = f"cannot write {path}: No space left on device. Make room, or write to another disk."
        raise OSError(message) from None
    finally:
        temporary.unlink(missing_ok=True)  # after the replacement there is nothing to remove


def writable(path: str | os.PathLike[str]) -> Path:
    """Return the real path of a file that can be written; raise what `replacing` does where it cannot."""
    target = Path(os.path.realpath(path))
    if not target.parent.is_dir():
        raise FileNotFoundError(f"cannot write {path}: there is no folder {target.parent}. Create it first.")
    if not os.access(target.parent, os.W_OK | os.X_OK):
        raise PermissionError(f"cannot write {path}: the folder {target.parent} is not writable. Choose another one.")
    if target.is_dir():
        raise IsADirectoryError(f"cannot write {path}: it is a folder. Give the name of a file.")
    return target
