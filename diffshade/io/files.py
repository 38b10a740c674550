"""Files that are written completely or not at all."""

import errno
import os
import secrets
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

NO_ROOM = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)
NO_RESERVING = (errno.EINVAL, errno.EOPNOTSUPP, errno.ENOSYS)
LITTLE = 1 << 16  # bytes: with less left, a disk is full, whatever a writer says of it


@contextmanager
def replacing(path: str | os.PathLike[str]) -> Iterator[Path]:
    """Give a temporary path to write to; it takes the place of `path` when the block ends without an error.

    The temporary file lies in the same folder, so that the replacement is one atomic step, and has the same suffix,
    since many writers choose their format by it. On any error (Ctrl-C included) it is removed and what was at `path`
    stays as it was. A symbolic link at `path` stays a link: the file it points to is replaced.

    Raises FileNotFoundError where the folder does not exist, PermissionError where it cannot be written to, and
    IsADirectoryError where `path` is a folder; all three before the block is entered. Where the disk is full, an
    OSError or RuntimeError of the writer becomes one OSError that names `path`.
    """
    target = writable(path)
    temporary = target.with_name(f".{secrets.token_hex(8)}{Path(path).suffix}")
    try:
        yield temporary
        os.replace(temporary, target)
    except (OSError, RuntimeError) as error:  # C++ writers, OpenEXR's among them, raise RuntimeError
        if getattr(error, "errno", None) in NO_ROOM or shutil.disk_usage(target.parent).free < LITTLE:
            raise OSError(
                f"cannot write {path}: the disk is full. Free some space, or choose another folder."
            ) from error
        raise
    finally:
        temporary.unlink(missing_ok=True)  # after the replacement there is nothing to remove


def write_file(path: str | os.PathLike[str], content: str | bytes) -> None:
    """Write a file of text in UTF-8, or of bytes, as `replacing` does."""
    with replacing(path) as temporary:
        temporary.write_bytes(content.encode() if isinstance(content, str) else content)


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


def reserve(path: Path, start: int) -> None:
    """Take the space on disk of a file of zeros, which a file system may leave out until they are written.

    Where a file is mapped into memory and its disk is full, writing to it ends the process without a word.

    Args:
        path: The file.
        start: Where its zeros begin.

    Raises:
        OSError: The disk is full.
    """
    size = path.stat().st_size
    with path.open("r+b") as file:
        if hasattr(os, "posix_fallocate"):
            try:
                os.posix_fallocate(file.fileno(), 0, size)
                return
            except OSError as error:
                if error.errno not in NO_RESERVING:
                    raise
        file.seek(start)
        zeros = bytes(1 << 20)
        for at in range(start, size, len(zeros)):
            file.write(zeros[: size - at])
