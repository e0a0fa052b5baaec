"""Fills a folder with photographs, models and light probes for wide worlds (docs/training.md).

    python3 tools/train/props/fetch.py FOLDER

Everything comes from packages by their ordinary clients: Debian `sweethome3d-furniture` (apt-get; models and their
textures), npm `@pmndrs/assets` (light probes), PyPI `robosuite` (textures), and PyPI `OpenEXR` to read the probes, whose
compression the trainer does not know. `index.json` says of every file its package, author, licence and SHA-256. A file
that is there is kept; a package that cannot be had is left out and said.
"""

import base64
import hashlib
import io
import json
import re
import subprocess
import sys
import zipfile
from pathlib import Path

FURNITURE = "sweethome3d-furniture"
PROBES = "@pmndrs/assets@1.7.0"
TEXTURES = "robosuite==1.5.2"
# Pictures of things on a plain ground, no surfaces.
NO_SURFACES = {"bread", "can", "cereal", "lemon", "soda", "glass"}
# Most triangles of a model.
TRIANGLES = 1000
# Least side of a texture, pixels.
LEAST_SIDE = 128


def run(command, folder):
    subprocess.run(command, cwd=folder, check=True, stdout=subprocess.DEVNULL)


class Index:
    """What lies in the folder, and where it comes from."""

    def __init__(self, root):
        self.root = root
        self.entries = {}

    def add(self, kind, name, data, package, licence, author=""):
        place = self.root / kind / name
        place.parent.mkdir(parents=True, exist_ok=True)
        place.write_bytes(data)
        digest = hashlib.sha256(data).hexdigest()
        self.entries[f"{kind}/{name}"] = {
            "package": package,
            "licence": licence,
            "author": author,
            "sha256": digest,
        }

    def write(self):
        text = json.dumps(self.entries, indent=1, sort_keys=True)
        (self.root / "index.json").write_text(text + "\n")


def image_size(data):
    """Width and height of a PNG or JPEG; None for anything else."""
    if data[:8] == b"\x89PNG\r\n\x1a\n":
        return int.from_bytes(data[16:20], "big"), int.from_bytes(data[20:24], "big")
    if data[:2] == b"\xff\xd8":
        at = 2
        while at + 9 < len(data) and data[at] == 0xFF:
            if data[at + 1] in (0xC0, 0xC1, 0xC2):
                return int.from_bytes(data[at + 7 : at + 9], "big"), int.from_bytes(data[at + 5 : at + 7], "big")
            at += 2 + int.from_bytes(data[at + 2 : at + 4], "big")
    return None


def properties(text):
    """Entries of a catalogue by number."""
    entries = {}
    for line in text.splitlines():
        match = re.match(r"(\w+)#(\d+)=(.*)", line.strip())
        if match:
            entries.setdefault(int(match[2]), {})[match[1]] = match[3]
    return [entries[number] for number in sorted(entries)]


def read_obj(text):
    vertices, triangles = [], []
    for line in text.splitlines():
        words = line.split()
        if not words:
            continue
        if words[0] == "v":
            vertices.append(tuple(float(word) for word in words[1:4]))
        elif words[0] == "f":
            corners = [int(word.split("/")[0]) for word in words[1:]]
            corners = [corner - 1 if corner > 0 else len(vertices) + corner for corner in corners]
            triangles += [(corners[0], corners[k], corners[k + 1]) for k in range(1, len(corners) - 1)]
    return vertices, triangles


def clustered(vertices, triangles, most):
    """Vertices of a cell of a grid become their mean, until few enough triangles are left."""
    low = [min(v[k] for v in vertices) for k in range(3)]
    side = max(max(v[k] for v in vertices) - low[k] for k in range(3))
    cell = side / 100
    while len(triangles) > most:
        index, sums, of = {}, [], []
        for v in vertices:
            key = tuple(int((v[k] - low[k]) / cell) for k in range(3))
            place = index.setdefault(key, len(sums))
            if place == len(sums):
                sums.append([0.0, 0.0, 0.0, 0])
            for k in range(3):
                sums[place][k] += v[k]
            sums[place][3] += 1
            of.append(place)
        kept = {}
        for triangle in triangles:
            corners = tuple(of[corner] for corner in triangle)
            if len(set(corners)) == 3:
                kept.setdefault(tuple(sorted(corners)), corners)
        if len(kept) <= most or cell > side:
            return [tuple(s[k] / s[3] for k in range(3)) for s in sums], list(kept.values())
        cell *= 1.25
    return vertices, triangles


def model(text, entry):
    """An OBJ of the catalogue's size in metres, z up, its front towards y."""
    vertices, triangles = read_obj(text)
    if not vertices or not triangles:
        return None
    turn = [float(word) for word in entry.get("modelRotation", "1 0 0 0 1 0 0 0 1").split()]
    vertices = [tuple(sum(turn[3 * row + k] * v[k] for k in range(3)) for row in range(3)) for v in vertices]
    vertices = [(-x, z, y) for x, y, z in vertices]
    for axis, key in enumerate(("width", "depth", "height")):
        low, high = min(v[axis] for v in vertices), max(v[axis] for v in vertices)
        wanted = float(entry[key]) / 100
        scale = wanted / (high - low) if high - low > 1e-9 else 0.0
        middle = low if axis == 2 else 0.5 * (low + high)
        vertices = [tuple((c - middle) * scale if k == axis else c for k, c in enumerate(v)) for v in vertices]
    if not 0.02 <= max(float(entry[key]) / 100 for key in ("width", "depth", "height")) <= 6.0:
        return None
    vertices, triangles = clustered(vertices, triangles, TRIANGLES)
    lines = [f"v {x:.4f} {y:.4f} {z:.4f}" for x, y, z in vertices]
    lines += [f"f {a + 1} {b + 1} {c + 1}" for a, b, c in triangles]
    return ("\n".join(lines) + "\n").encode() if triangles else None


def furniture(packages, index):
    if not list(packages.glob("sweethome3d-furniture_*.deb")):
        run(["apt-get", "download", FURNITURE], packages)
    deb = next(packages.glob("sweethome3d-furniture_*.deb"))
    run(["dpkg-deb", "-x", deb.name, "furniture"], packages)
    licences = {"CC-0": "CC0", "CC-BY": "CC-BY 3.0", "Scopia": "CC-BY 3.0"}
    for path in sorted(packages.glob("furniture/usr/share/sweethome3d/furniture/*.sh3f")):
        archive = zipfile.ZipFile(path)
        licence = next((own for key, own in licences.items() if key in path.stem), "CC-BY 3.0 US")
        names = {name.lower(): name for name in archive.namelist()}
        catalogue = archive.read("PluginFurnitureCatalog.properties").decode("latin1")
        for entry in properties(catalogue):
            place = names.get(entry.get("model", "").lstrip("/").lower())
            if not place or not place.endswith(".obj") or entry.get("doorOrWindow") == "true":
                continue
            made = model(archive.read(place).decode("latin1"), entry)
            if made:
                name = f"{path.stem}-{Path(place).stem}.obj".lower().replace(" ", "-")
                index.add("models", name, made, deb.name, licence, entry.get("creator", ""))
        for name in archive.namelist():
            ending = Path(name).suffix.lower()
            if ending not in (".jpg", ".jpeg", ".png") or len(Path(name).parts) < 3:
                continue  # those of the first folder are icons
            data = archive.read(name)
            size = image_size(data)
            if size and min(size) >= LEAST_SIDE and max(size) <= 4096:
                out = f"{path.stem}-{Path(name).parent.name}-{Path(name).stem}{ending}".lower().replace(" ", "-")
                index.add("photos", out, data, deb.name, licence, "see the folder's licence in the package")


def textures(packages, index):
    if not list(packages.glob("robosuite-*.whl")):
        run([sys.executable, "-m", "pip", "download", "-q", "--no-deps", TEXTURES], packages)
    wheel = next(packages.glob("robosuite-*.whl"))
    archive = zipfile.ZipFile(wheel)
    for name in archive.namelist():
        place = Path(name)
        if "models/assets/textures/" in name and place.suffix == ".png" and place.stem not in NO_SURFACES:
            data = archive.read(name)
            if image_size(data):
                index.add("photos", f"robosuite-{place.name}", data, wheel.name, "MIT", "robosuite")


def probes(packages, index):
    if not list(packages.glob("pmndrs-assets-*.tgz")):
        run(["npm", "pack", "--silent", PROBES], packages)
    tgz = next(packages.glob("pmndrs-assets-*.tgz"))
    run(["tar", "xzf", tgz.name], packages)
    reader = packages / "openexr"
    if not reader.exists():
        run([sys.executable, "-m", "pip", "install", "-q", "--target", str(reader), "OpenEXR", "numpy"], packages)
    sys.path.insert(0, str(reader))
    import OpenEXR

    for path in sorted(packages.glob("package/hdri/*.exr.js")):
        packed = base64.b64decode(re.search(r"base64,([A-Za-z0-9+/=]+)", path.read_text())[1])
        source = packages / "probe.exr"
        source.write_bytes(packed)
        with OpenEXR.File(str(source), separate_channels=True) as read:
            channels = {name: read.channels()[name].pixels.astype("float16") for name in "RGB"}
        plain = packages / "plain.exr"
        header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
        with OpenEXR.File(header, channels) as made:
            made.write(str(plain))
        index.add("probes", path.name.removesuffix(".js"), plain.read_bytes(), tgz.name, "CC0", "Poly Haven")


def main():
    if len(sys.argv) != 2:
        sys.exit("usage: fetch.py FOLDER")
    root = Path(sys.argv[1])
    packages = root / "packages"
    packages.mkdir(parents=True, exist_ok=True)
    packages = packages.resolve()
    index = Index(root)
    for what, fetch in (("furniture", furniture), ("textures", textures), ("probes", probes)):
        try:
            fetch(packages, index)
        except (OSError, subprocess.CalledProcessError, zipfile.BadZipFile, ImportError, StopIteration) as error:
            print(f"{what}: left out, {error}", file=sys.stderr)
    index.write()
    kinds = sorted({name.split("/")[0] for name in index.entries})
    counts = ", ".join(f"{sum(name.startswith(kind) for name in index.entries)} {kind}" for kind in kinds)
    print(f"{root}: {counts}")


if __name__ == "__main__":
    main()
