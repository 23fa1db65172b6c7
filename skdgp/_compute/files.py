"""Files: atomic writing; reading of JSON and TOML with one-line errors."""

from __future__ import annotations

import json
import os
import secrets
import tomllib
from collections import Counter
from collections.abc import Callable
from pathlib import Path

LARGEST = 2**24
"""Bytes of a file that people write; a larger one is another file."""


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
    OSError
        If it cannot be written; ``filename`` is ``path``, whatever the system calls it.

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
    except OSError as error:
        if error.filename not in (None, str(temporary)):  # another file's
            raise
        raise OSError(error.errno, error.strerror or str(error), str(path)) from error
    finally:
        temporary.unlink(missing_ok=True)
    return path


def _flush_to_disk(path: Path) -> None:
    """Force the bytes out before the rename, or a power cut could leave an empty file in its place."""
    with path.open("rb+") as file:
        os.fsync(file.fileno())


def read_json(path: str | os.PathLike):
    """Return what a file of JSON holds.

    Raises
    ------
    ValueError
        If it is not UTF-8 or not JSON, names a key twice, is nested too deeply, larger than 16 MB or no regular file.
    OSError
        If it cannot be read.
    """
    return parse_json(_text(path), f"{path} is not a JSON file")


def parse_json(text: str, refusal: str):
    """Return what a text of JSON holds, or raise a ValueError that begins with the refusal."""
    return _parsed(lambda: json.loads(text, object_pairs_hook=_once, parse_constant=_refuse), refusal)


def read_toml(path: str | os.PathLike) -> dict:
    """Return what a file of TOML holds.

    Raises
    ------
    ValueError, OSError
        As of `read_json`.
    """
    text = _text(path)
    return _parsed(lambda: tomllib.loads(text), f"{path} is not a TOML file")


def _text(path) -> str:
    path = Path(path)
    if path.exists() and not path.is_file():
        raise ValueError(f"Got {path}, which is a folder or a device, but expected a file.")
    if path.stat().st_size > LARGEST:
        raise ValueError(f"Got {path} of {path.stat().st_size / 1e6:.0f} MB, but expected a file of at most 16 MB.")
    return _parsed(lambda: path.read_text(encoding="utf-8-sig"), f"{path} is not a text in UTF-8")


def _parsed(parse, refusal):
    try:
        return parse()
    except RecursionError:
        raise ValueError(f"{refusal}: it is nested too deeply.") from None
    except ValueError as error:
        raise ValueError(f"{refusal}: {error}.") from error


def _once(pairs) -> dict:
    found = dict(pairs)
    if len(found) < len(pairs):
        ((name, _),) = Counter(name for name, _ in pairs).most_common(1)
        raise ValueError(f"the key {name!r} stands twice")
    return found


def _refuse(constant):
    raise ValueError(f"{constant} is not a number of JSON")
