"""Zip the Blender add-on: ``python integrations/blender/build.py [-o FOLDER]``; same sources, same bytes."""

import argparse
import tomllib
import zipfile
from pathlib import Path

ADD_ON = Path(__file__).resolve().parent / "moveset_blender"


def build(folder: Path) -> Path:
    """Write ``moveset_blender-VERSION.zip`` into a folder, as Blender's Install from Disk takes it."""
    version = tomllib.loads((ADD_ON / "blender_manifest.toml").read_text())["version"]
    folder.mkdir(parents=True, exist_ok=True)
    target = folder / f"moveset_blender-{version}.zip"
    with zipfile.ZipFile(target, "w", zipfile.ZIP_DEFLATED) as archive:
        for source in sorted(path for path in ADD_ON.iterdir() if path.suffix in (".py", ".toml")):
            # A fixed date, or two builds would differ.
            entry = zipfile.ZipInfo(source.name, (2026, 1, 1, 0, 0, 0))
            entry.compress_type, entry.external_attr = zipfile.ZIP_DEFLATED, 0o644 << 16
            archive.writestr(entry, source.read_bytes())
    return target


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("-o", "--out", type=Path, default=Path("out"), help="folder to write to (default: out)")
    print(build(parser.parse_args().out))
