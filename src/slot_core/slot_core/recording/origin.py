"""Origin of a bag: revision of the code, arguments of the graph, files of the configuration."""

import io
import os
import subprocess
import zipfile
from collections.abc import Mapping
from dataclasses import dataclass, field
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

from slot_core import config
from slot_core.names import ONNX
from slot_core.network_file import read_network
from slot_core.recording.record_settings import BagError
from slot_core.refusal import printable, read_bytes

ORIGIN = "slot"  # name of the MCAP metadata record
CONFIGURATION = "config.zip"  # name of the attachment
ARCHIVE_MAX = 100_000_000  # bytes of it unpacked, and of a file
FILES = {
    "path": "path.csv",
    "calibration": "camera.yaml",
    "policy": "policy.py",
    "params_file": "params.yaml",
}
"""Attachments by the argument that names their file."""
NETWORK = "policy.onnx"  # attachment of a policy that is a network, with all its weights


@dataclass(frozen=True)
class Origin:
    """Revision, arguments and files that made a bag; empty if none are recorded."""

    # revision, and the graph's arguments
    about: Mapping[str, str] = field(default_factory=dict)
    # attachments by name
    files: Mapping[str, bytes] = field(default_factory=dict)

    def changed_files(self) -> list[str]:
        """Files of the configuration that are not as those here, sorted; none if not known.

        Raises BagError for an archive that cannot be read, or is larger than ARCHIVE_MAX.
        """
        if CONFIGURATION not in self.files:
            return []
        then, now = self.configuration(), configuration()
        return sorted(
            name
            for name in then.keys() | now.keys()
            if then.get(name) != now.get(name)
        )

    def configuration(self) -> dict[str, bytes]:
        """Files of the recorded configuration by path; raises as `changed_files`, also without."""
        try:
            with zipfile.ZipFile(
                io.BytesIO(self.files[CONFIGURATION])
            ) as archive:
                if (
                    sum(file.file_size for file in archive.infolist())
                    > ARCHIVE_MAX
                ):
                    raise BagError(f"more than {ARCHIVE_MAX} bytes")
                return {name: archive.read(name) for name in archive.namelist()}
        except (
            Exception
        ) as error:  # of a damaged archive also zlib, struct and index errors
            raise BagError(f"{CONFIGURATION}: {error}") from None

    def lines(self) -> list[str]:
        """Text of the origin, aligned; none if nothing is known."""
        if not self.about:
            return []
        about = dict(self.about)
        revision = about.pop("revision", "unknown")
        pairs = ", ".join(f"{name} {value}" for name, value in about.items())
        lines = [f"recorded by  revision {revision}, {pairs}"]
        try:
            changed = (
                f"differs in {', '.join(names)}"
                if (names := self.changed_files())
                else ""
            )
        except BagError as error:
            changed = f"cannot be read: {error}"
        if changed:
            lines.append(f"             its configuration {changed}")
        return list(map(printable, lines))


def origin_here(arguments: Mapping[str, Any]) -> Origin:
    """Origin of a bag that is made here and now by a graph with these arguments.

    Raises OSError if a file among the arguments cannot be read, ValueError if it is not regular.
    """
    named = {
        name: str(arguments[name]) for name in FILES.keys() & arguments.keys()
    }
    attached = dict(FILES)
    if named.get("policy", "").startswith(ONNX):
        named["policy"], attached["policy"] = (
            named["policy"].removeprefix(ONNX),
            NETWORK,
        )
    elif not named.get("policy", "").endswith(".py"):
        named.pop("policy", None)  # a name
    about = {name: str(value) for name, value in arguments.items()}
    about |= {name: Path(file).name for name, file in named.items()}
    files = {
        attached[name]: read_network(Path(file))
        if attached[name] == NETWORK
        else read_bytes(Path(file), ARCHIVE_MAX)
        for name, file in named.items()
    }
    return Origin(
        {"revision": revision(), **about},
        {CONFIGURATION: _zipped(configuration()), **files},
    )


def configuration() -> dict[str, bytes]:
    """Content of the configuration's files by their path in its directory."""
    root = config.config_dir().resolve()
    return {
        path.relative_to(root).as_posix(): path.read_bytes()
        for path in sorted(root.rglob("*"))
        if path.suffix in (".yaml", ".csv")
    }


def revision() -> str:
    """Commit of the sources (`-dirty` with changes), else $SLOT_REVISION, else the version.

    An image without .git names its commit by that variable.
    """
    try:
        done = subprocess.run(
            ["git", "describe", "--always", "--dirty", "--abbrev=10"],
            cwd=Path(__file__).resolve().parent,
            capture_output=True,
            text=True,
            timeout=10,
            check=False,
        )
        if done.returncode == 0:
            return done.stdout.strip()
        return (
            os.environ.get("SLOT_REVISION") or f"version {version('slot_core')}"
        )
    except (OSError, subprocess.TimeoutExpired, PackageNotFoundError):
        return "unknown"


def _zipped(files: Mapping[str, bytes]) -> bytes:
    """ZIP archive of files, equal for equal files."""
    packed = io.BytesIO()
    with zipfile.ZipFile(
        packed, "w", zipfile.ZIP_DEFLATED, compresslevel=9
    ) as archive:
        for name, data in files.items():
            archive.writestr(zipfile.ZipInfo(name), data, zipfile.ZIP_DEFLATED)
    return packed.getvalue()
