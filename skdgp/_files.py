"""Files appear whole or not at all."""

from __future__ import annotations

import os
import secrets
from collections.abc import Callable
from pathlib import Path


def write_atomically(path: str | os.PathLike, write: Callable[[Path], object]) -> Path:
    """Let ``write`` fill a temporary file beside ``path``, then put it in place in one step.

    Whoever reads ``path`` sees the old file or the complete new one, never half of it. When ``write`` fails
    or is interrupted, the temporary file is removed and an earlier file at ``path`` stays as it was.

    Parameters
    ----------
    path : path-like
        Where the file shall be; its folder must exist. A symbolic link is followed, not replaced.
    write : callable
        Called once with the temporary path (same folder, same suffix); it creates that file.

    Returns
    -------
    Path
        ``path``.

    Raises
    ------
    FileNotFoundError
        If the folder does not exist.
    IsADirectoryError
        If ``path`` is a folder.

    Examples
    --------
    >>> import tempfile
    >>> from pathlib import Path
    >>> folder = Path(tempfile.mkdtemp())
    >>> written = write_atomically(folder / "a.txt", lambda temporary: temporary.write_text("whole"))
    >>> written.read_text(), [file.name for file in folder.iterdir()]
    ('whole', ['a.txt'])
    """
    path = Path(path)
    target = path.resolve()
    if target.is_dir():
        raise IsADirectoryError(f"Got the folder {str(path)!r} as a file to write: name a file inside it.")
    if not target.parent.is_dir():
        raise FileNotFoundError(
            f"Cannot write {str(path)!r}: the folder {str(target.parent)!r} does not exist. Create it first."
        )
    # Not tempfile: its files are readable by their owner alone, and would stay so after the replacement.
    temporary = target.with_name(f".{target.stem}-{secrets.token_hex(4)}.part{target.suffix}")
    try:
        write(temporary)
        _flush_to_disk(temporary)
        os.replace(temporary, target)
    finally:
        temporary.unlink(missing_ok=True)
    return path


def _flush_to_disk(path: Path) -> None:
    """Force the bytes out before the rename, or a power cut could leave an empty file in its place."""
    with path.open("rb+") as file:
        os.fsync(file.fileno())
