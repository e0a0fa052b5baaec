"""Reads a .r4c container with struct and zstandard alone (numpy where it is there), to check the format from outside.

As a program: `python r4c.py FILE` prints streams and chunks as JSON, with the decoded bytes of each chunk in hex.
"""
import json
import struct
import sys

import zstandard

DTYPES = ["u1", "u2", "u4", "i4", "f2", "f4", "f8"]
UNITS = ["1", "m", "iu", "rad", "px", "s"]
FRAMES = ["none", "recon", "robot_base", "camera"]
CODECS = ["raw", "zstd", "shuffle+zstd", "delta+shuffle+zstd", "planes+zstd"]


class Cursor:
    """Fixed-width little-endian values, one behind the other."""

    def __init__(self, data):
        self.data, self.at = data, 0

    def take(self, kind):
        value = struct.unpack_from("<" + kind, self.data, self.at)[0]
        self.at += struct.calcsize("<" + kind)
        return value

    def text(self):
        length = self.take("Q")
        self.at += length
        return self.data[self.at - length : self.at].decode()

    def list(self, read):
        return [read() for _ in range(self.take("Q"))]


def read(path):
    """Streams of a file: name -> (description, [(coordinates, bytes)])."""
    data = open(path, "rb").read()
    assert data[:8] == b"\x89R4C\r\n\x1a\n" and data[-4:] == b"C4R."
    footer = struct.unpack("<QQQQIIQQI", data[-64:-4])
    schema_at, schema_stored, index_at, index_stored, schema_length, index_length, _, length, _ = footer
    assert length == len(data)
    unpack = zstandard.ZstdDecompressor().decompress
    schema = Cursor(unpack(data[schema_at : schema_at + schema_stored], max_output_size=schema_length))
    index = unpack(data[index_at : index_at + index_stored], max_output_size=index_length)
    name = schema.text()

    def stream():
        return dict(
            name=schema.text(), dtype=DTYPES[schema.take("I")], shape=schema.list(lambda: schema.take("I")),
            unit=UNITS[schema.take("I")], frame=FRAMES[schema.take("I")], codec=CODECS[schema.take("I")],
            stride=schema.take("I"), fill=schema.text(),
        )

    streams = schema.list(stream)
    metadata = dict(schema.list(lambda: (schema.text(), schema.text())))
    assert schema.at == len(schema.data)
    chunks = [[] for _ in streams]
    for number in range(struct.unpack_from("<Q", index)[0]):
        entry = struct.unpack_from("<II4IQIIIHHQII", index, 8 + 64 * number)
        which, _, *coordinates, offset, stored, decoded, _, codec, flags = entry[:12]
        payload, info = data[offset : offset + stored], streams[which]
        if flags & 1:
            payload *= decoded // stored
        elif codec:
            if codec == 4:
                payload = planes(payload, info["stride"], decoded // info["stride"], unpack)
            else:
                payload = unpack(payload, max_output_size=decoded)
            if codec >= 2:
                payload = unshuffle(payload, info["stride"])
            if codec == 3:
                payload = undelta(payload, info["stride"])
        assert len(payload) == decoded
        chunks[which].append((coordinates, payload))
    return name, metadata, {info["name"]: (info, part) for info, part in zip(streams, chunks)}


def planes(payload, stride, count, unpack):
    lengths, at, out = struct.unpack_from(f"<{stride}I", payload), 4 * stride, b""
    for length in lengths:
        plane = payload[at : at + length]
        out += plane if length == count else unpack(plane, max_output_size=count)
        at += length
    assert at == len(payload)
    return out


def unshuffle(planes, stride):
    count = len(planes) // stride
    out = bytearray(planes)
    for byte in range(stride):
        out[byte : count * stride : stride] = planes[byte * count : (byte + 1) * count]
    return bytes(out)


def undelta(data, size):
    value, out = 0, bytearray()
    for at in range(0, len(data), size):
        value = (value + int.from_bytes(data[at : at + size], "little")) % (1 << (8 * size))
        out += value.to_bytes(size, "little")
    return bytes(out)


def arrays(path, name):
    """All chunks of a stream as one numpy array, first axis = elements."""
    import numpy as np

    info, chunks = read(path)[2][name]
    flat = np.frombuffer(b"".join(payload for _, payload in chunks), "<" + info["dtype"])
    return flat.reshape(-1, *info["shape"]) if info["shape"] else flat


if __name__ == "__main__":
    schema, meta, content = read(sys.argv[1])
    describe = lambda info, part: dict(info, chunks=[[at, data.hex()] for at, data in part])
    print(json.dumps(dict(schema=schema, content=meta["content"], streams=[describe(*pair) for pair in content.values()])))
