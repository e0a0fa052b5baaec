"""Makes the corpus of the targets `agibot` and `rollout`: python3 tests/fuzz/views.py"""

import pathlib
import struct
import zlib

MARK = b"\n====\n"
PLACE = pathlib.Path(__file__).parent / "corpus"


def png(width, height, shade):
    def chunk(kind, body):
        return struct.pack(">I", len(body)) + kind + body + struct.pack(">I", zlib.crc32(kind + body))

    rows = b"".join(
        b"\0" + bytes((shade + at) % 256 for at in range(row * width * 3, (row + 1) * width * 3)) for row in range(height)
    )
    head = struct.pack(">IIBBBBB", width, height, 8, 2, 0, 0, 0)
    return b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", head) + chunk(b"IDAT", zlib.compress(rows)) + chunk(b"IEND", b"")


def npy(shape, values, kind):
    text = "{'descr': '<%s', 'fortran_order': False, 'shape': %s, }" % (kind, shape)
    text += " " * (-(len(text) + 11) % 64) + "\n"
    body = struct.pack("<%d%s" % (len(values), {"f4": "f", "f8": "d"}[kind]), *values)
    return b"\x93NUMPY\1\0" + struct.pack("<H", len(text)) + text.encode() + body


def write(target, inputs):
    folder = PLACE / target
    folder.mkdir(parents=True, exist_ok=True)
    for number, data in enumerate(inputs):
        (folder / str(number)).write_bytes(data)


hand = [0.6, 0.3, 0.8, 0.0, 0.0, 0.0, 1.0, 40.0]
lens = [8.0, 0.0, 4.0, 0.0, 8.0, 3.0, 0.0, 0.0, 1.0]
pose = [0.0, -1.0, 0.0, 0.6, 1.0, 0.0, 0.0, 0.3, 0.0, 0.0, 1.0, 0.72, 0.0, 0.0, 0.0, 1.0]
sample = [npy((1, 16), hand * 2, "f4"), npy((3, 3), lens, "f8"), npy((1, 4, 4), pose, "f8"), png(8, 6, 0)]
inverted = sample[:2] + [npy((1, 4, 4), pose[:3] + [-0.3] + pose[4:7] + [0.6] + pose[8:], "f8")] + sample[3:]
write("agibot", [MARK.join(sample), MARK.join(inverted), MARK.join(sample[:1] + [b""] * 2 + sample[3:])])

views = MARK.join(png(8, 6, shade) for shade in (0, 40, 80))
write(
    "rollout",
    [bytes([1 + 16]) + views, bytes([0 + 16]) + png(8, 9, 0), bytes([2]) + png(24, 12, 0), bytes([4 + 8]) + png(20, 20, 0)]
    + [bytes([1]) + MARK.join(png(8, 6, shade) for shade in (0, 80, 40)), bytes([16]) + png(640, 640, 0)[:4096]],
)
