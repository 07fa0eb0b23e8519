"""The releases that were written under schemas that were, each packed into one file.

`formats/fixtures/schema-X.Y.tar.xz` holds the files of the release that this package wrote under
schema X.Y, byte for byte. They are never made again: one that had to change would be a reader that
broke.
"""

import tarfile
from pathlib import Path

ARCHIVES = sorted((Path(__file__).parent / "formats" / "fixtures").glob("schema-*.tar.xz"))
SCHEMAS = [path.name.removesuffix(".tar.xz") for path in ARCHIVES]


def unpacked(schema: str, folder: Path) -> Path:
    """Unpack `schema-X.Y` into a folder and give the release's own, which has the same name."""
    with tarfile.open(ARCHIVES[SCHEMAS.index(schema)]) as archive:
        archive.extractall(folder, filter="data")
    return folder / schema
