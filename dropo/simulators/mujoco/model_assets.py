"""The meshes, textures and height fields of an MJCF, so that it can be moved to another folder."""

import re
import shutil
from pathlib import Path

FOLDER = "assets"
"""Where they are beside a model."""
_FILE = re.compile(r'(<(mesh|texture|hfield|skin)\b[^>]*?\bfile\w*=")([^"]+)(")')
_FOLDERS = re.compile(r'\s(meshdir|texturedir|assetdir|strippath)="([^"]*)"')


def with_absolute_assets(xml: str, base: Path) -> str:
    """Write the absolute path of every file that an MJCF names.

    Parameters
    ----------
    xml : str
        The MJCF.
    base : Path
        The folder that its relative paths start from.

    Returns
    -------
    str
        Without `meshdir`, `texturedir`, `assetdir` and `strippath`.
    """
    folders: dict[str, str] = dict(_FOLDERS.findall(xml))
    common = folders.get("assetdir", "")

    def absolute(match: re.Match[str]) -> str:
        begin, kind, file, end = match.groups()
        own = "texturedir" if kind == "texture" else "meshdir"
        name = Path(file).name if folders.get("strippath") == "true" else file
        return f"{begin}{(base / folders.get(own, common) / name).resolve()}{end}"

    return _FILE.sub(absolute, _FOLDERS.sub("", xml))


def with_assets_beside(xml: str, folder: Path) -> str:
    """Copy the files that an MJCF names by absolute paths into a folder beside it.

    Parameters
    ----------
    xml : str
        The MJCF.
    folder : Path
        Where it is going to be written.

    Returns
    -------
    str
        The MJCF with their relative paths.
    """
    copies: dict[str, str] = {}

    def beside(match: re.Match[str]) -> str:
        begin, _, file, end = match.groups()
        if file not in copies:
            name = Path(file).name
            if name in copies.values():
                name = f"{len(copies)}-{name}"
            (folder / FOLDER).mkdir(parents=True, exist_ok=True)
            place = folder / FOLDER / name
            if Path(file) != place.resolve():
                shutil.copyfile(file, place)
            copies[file] = name
        return f"{begin}{FOLDER}/{copies[file]}{end}"

    return _FILE.sub(beside, xml)
