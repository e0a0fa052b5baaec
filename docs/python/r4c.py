"""Reads `.r4c` files, the chunk container of rogs: a reader to use, and to port (docs/spec/r4c.md).

    import r4c
    file = r4c.File("field-1.r4c")
    file.schema, file.version            # 'rogs.field', (1, 0)
    file.head()                          # what is small, as a dict
    file.array("position_m")             # numpy [N, 3], metres, reconstruction frame
    file.chunk("displacement_m", 2, 1)   # source view 2, stored time 1: numpy [H * W, 3]

Needs numpy for arrays, and a zstd decoder: the package `zstandard`, or Python 3.14 and newer alone. Checksums of chunks
are checked where the packages `xxhash` and `crc32c` are installed.

As a program: `python r4c.py FILE` prints schema, head and streams as JSON; `--hex` adds the decoded bytes of every
chunk.
"""

import json
import struct
import sys

try:
    from compression.zstd import decompress as _zstd
except ImportError:

    def _zstd(data):
        import zstandard

        return zstandard.ZstdDecompressor().decompress(data)


try:
    from xxhash import xxh3_64_intdigest as _xxh3
except ImportError:
    _xxh3 = None
try:
    from crc32c import crc32c as _crc
except ImportError:
    _crc = None

MAGIC, END_MAGIC, FEATURE_PLANES = b"\x89R4C\r\n\x1a\n", b"C4R.", 1
DTYPES = ["u1", "u2", "u4", "i4", "f2", "f4", "f8"]
UNITS = ["1", "m", "iu", "rad", "px", "s"]
FRAMES = ["none", "recon", "robot_base", "camera"]
CODECS = ["raw", "zstd", "shuffle+zstd", "delta+shuffle+zstd", "planes+zstd"]


class Damaged(ValueError):
    """The file is cut off, damaged, no container, or of a newer version."""


class File:
    """An open container. Headers are read and checked at once, chunks when they are asked for."""

    def __init__(self, path):
        self.path, self._file = path, open(path, "rb")
        length = self._file.seek(0, 2)
        _demand(length >= 128, "too short to be a container")
        footer = self._read(length - 64, 64)
        _demand(footer[60:] == END_MAGIC, "no end magic: cut off or never finished")
        _demand(_small_crc(footer[:56]) == struct.unpack_from("<I", footer, 56)[0], "checksum of the footer")
        schema_at, schema_stored, index_at, index_stored, schema_size, index_size, blocks, total = struct.unpack(
            "<4Q2I2Q", footer[:56]
        )
        _demand(total == length, f"{length} bytes, it should be {total}")
        prologue = self._read(0, 64)
        _demand(prologue[:8] == MAGIC, "no magic: not a container")
        major, minor, features = struct.unpack_from("<HHI", prologue, 8)
        _demand(major <= 1 and features & ~FEATURE_PLANES == 0, f"container {major}.{minor}, features {features:#x}")
        self.version, self.key = struct.unpack_from("<HH", prologue, 32), prologue[40:56].hex()
        schema, index = self._read(schema_at, schema_stored), self._read(index_at, index_stored)
        if _xxh3:
            _demand(_xxh3(prologue[:56]) == struct.unpack_from("<Q", prologue, 56)[0], "checksum of the prologue")
            _demand(_xxh3(schema + index) == blocks, "checksum of schema and index")
        schema, index = _zstd(schema), _zstd(index)
        _demand((len(schema), len(index)) == (schema_size, index_size), "sizes of schema and index")
        cursor = Cursor(schema)
        self.schema = cursor.text()
        self.streams = {stream.name: stream for stream in cursor.list(lambda: Stream(cursor))}
        self.metadata = dict(cursor.list(lambda: (cursor.text(), cursor.text())))
        cursor.end()
        streams = list(self.streams.values())
        for at in range(8, len(index), 64):
            chunk = Chunk(*struct.unpack_from("<II4IQIIIHHQII", index, at))
            streams[chunk.stream].chunks.append(chunk)

    def head(self):
        """The small structured data of a record of rogs, as a dict, with that of further streams by their names."""
        return head(self.schema, self.streams, self._cursor)

    def array(self, name):
        """A whole stream as numpy: chunks one behind the other, the first axis counts elements."""
        stream = self.streams[name]
        return stream.shaped(b"".join(self.decode(stream, chunk) for chunk in stream.chunks))

    def chunk(self, name, *coordinates):
        """One chunk as numpy, by its coordinates; those left out are 0."""
        stream = self.streams[name]
        place = coordinates + (0,) * (4 - len(coordinates))
        (chunk,) = [chunk for chunk in stream.chunks if chunk.coordinates == place]
        return stream.shaped(self.decode(stream, chunk))

    def decode(self, stream, chunk):
        """The bytes of a chunk."""
        stored = self._read(chunk.offset, chunk.stored)
        _demand(not _xxh3 or _xxh3(stored) == chunk.stored_hash, f"checksum of a stored chunk of `{stream.name}`")
        count = chunk.decoded // stream.stride
        if chunk.flags & 1:
            data = stored * (chunk.decoded // len(stored))
        elif chunk.codec == 0:
            data = stored
        elif chunk.codec == 1:
            data = _zstd(stored)
        elif chunk.codec == 4:
            data = _rows(_planes(stored, stream.stride, count), stream.stride)
        else:
            data = _rows(_zstd(stored), stream.stride)
            data = _sums(data, stream.stride) if chunk.codec == 3 else data
        _demand(len(data) == chunk.decoded, f"size of a chunk of `{stream.name}`")
        _demand(not _crc or _crc(data) == chunk.decoded_crc, f"checksum of a decoded chunk of `{stream.name}`")
        return data

    def _cursor(self, name):
        stream = self.streams[name]
        return Cursor(b"".join(self.decode(stream, chunk) for chunk in stream.chunks))

    def _read(self, at, length):
        self._file.seek(at)
        data = self._file.read(length)
        _demand(len(data) == length, "cut off")
        return data


class Stream:
    """What the schema says of a stream, and its chunks in file order."""

    def __init__(self, cursor):
        u32 = cursor.u32
        self.name, self.dtype, self.shape = cursor.text(), DTYPES[u32()], cursor.list(u32)
        self.unit, self.frame, self.codec = UNITS[u32()], FRAMES[u32()], CODECS[u32()]
        self.stride, self.fill, self.chunks = u32(), cursor.text(), []

    def shaped(self, data):
        """Bytes as numpy `[elements, *shape]`."""
        import numpy

        return numpy.frombuffer(data, "<" + self.dtype).reshape(-1, *self.shape)


class Chunk:
    """One entry of the index."""

    def __init__(self, stream, ordinal, *rest):
        self.stream, self.ordinal, self.coordinates = stream, ordinal, tuple(rest[:4])
        self.offset, self.stored, self.decoded, self.elements = rest[4:8]
        self.codec, self.flags, self.stored_hash, self.decoded_crc, _ = rest[8:]


class Cursor:
    """Values of the fixed-width encoding of heads, one behind the other."""

    def __init__(self, data):
        self.data, self.at = data, 0

    def take(self, kind):
        value = struct.unpack_from("<" + kind, self.data, self.at)[0]
        self.at += struct.calcsize("<" + kind)
        return value

    def u32(self):
        return self.take("I")

    def text(self):
        return self.raw(self.take("Q")).decode()

    def raw(self, length):
        self.at += length
        return self.data[self.at - length : self.at]

    def list(self, read):
        return [read() for _ in range(self.take("Q"))]

    def end(self):
        _demand(self.at == len(self.data), f"{len(self.data) - self.at} bytes are left over")


def _planes(stored, stride, count):
    """Byte planes that were compressed one by one; a plane of its full length is stored as it is."""
    lengths, at, planes = struct.unpack_from(f"<{stride}I", stored), 4 * stride, []
    for length in lengths:
        plane = stored[at : at + length]
        planes.append(plane if length == count else _zstd(plane))
        at += length
    _demand(at == len(stored), "bytes behind the planes")
    return b"".join(planes)


def _rows(planes, stride):
    """Byte planes back to rows of `stride` bytes."""
    count, rows = len(planes) // stride, bytearray(planes)
    for byte in range(stride):
        rows[byte::stride] = planes[byte * count : (byte + 1) * count]
    return bytes(rows)


def _sums(data, size):
    """Differences of successive integers of `size` bytes back to the integers, wrapping."""
    value, out = 0, bytearray()
    for at in range(0, len(data), size):
        value = (value + int.from_bytes(data[at : at + size], "little")) % (1 << 8 * size)
        out += value.to_bytes(size, "little")
    return bytes(out)


def _small_crc(data):
    """CRC-32C bit by bit: enough for a footer."""
    crc = 0xFFFFFFFF
    for byte in data:
        crc ^= byte
        for _ in range(8):
            crc = crc >> 1 ^ (0x82F63B78 if crc & 1 else 0)
    return crc ^ 0xFFFFFFFF


def _demand(holds, what):
    if not holds:
        raise Damaged(what)


# Layouts of the heads. A layout is a function of a cursor.
def _number(kind):
    return lambda cursor: cursor.take(kind)


def _many(read):
    return lambda cursor: cursor.list(lambda: read(cursor))


def _fixed(read, count):
    return lambda cursor: [read(cursor) for _ in range(count)]


def _maybe(read):
    return lambda cursor: read(cursor) if cursor.take("B") else None


def _row(**fields):
    return lambda cursor: {name: read(cursor) for name, read in fields.items()}


def _variant(**variants):
    """One of several: a name alone, or the name with its fields."""

    def read(cursor):
        name, fields = list(variants.items())[cursor.u32()]
        return {name: fields(cursor)} if fields else name

    return read


def _whole(read):
    def all_of(cursor):
        value = read(cursor)
        cursor.end()
        return value

    return all_of


_text, _flag, _u8, _u32 = Cursor.text, _number("?"), _number("B"), Cursor.u32
_u64, _f32, _f64 = _number("Q"), _number("f"), _number("d")
_pose = _row(rotation=_fixed(_f64, 9), translation=_fixed(_f64, 3))
_view = _row(camera=_u32, frame=_u32)
_weights = _row(trained=_flag, configuration=_text, description=_text, hash=_text)
_arrays = _many(_row(name=_text, shape=_many(_u32)))
_camera = _row(
    id=_text,
    role=_variant(source=None, evaluation=None),
    partner=_maybe(_u32),
    intrinsics=_row(fx=_f64, fy=_f64, cx=_f64, cy=_f64),
    mount=_variant(
        fixed=_row(base_from_camera=_pose),
        trajectory=_row(base_from_camera=_many(_pose)),
        hand_eye=_row(link=_text, link_from_camera=_pose),
    ),
    has_rgb=_flag,
    depth_range_m=_maybe(_fixed(_f32, 2)),
)
_clip = _row(
    clip_id=_text,
    episode_id=_text,
    layout=_text,
    task=_text,
    calibration_note=_text,
    fps=_f64,
    episode_frames=_many(_u32),
    source_frames=_many(_u32),
    query_frames=_many(_u32),
    anchor_frame=_u32,
    height=_u32,
    width=_u32,
    cameras=_many(_camera),
    robot=_row(joint_names=_many(_text), positions=_many(_f64), gripper=_many(_f64)),
    tracks=_maybe(_row(anchor_frame=_u32, count=_u32)),
)
_rollout = _row(
    model=_text, layout=_text, frames=_fixed(_u32, 2), first_frame_psnr_db=_many(_maybe(_f64))
)
_robot = _row(
    clip_id=_text,
    link_names=_many(_text),
    base_from_link=_many(_pose),
    base_from_camera=_many(_pose),
    recon_from_base=_pose,
    tool_m=_many(_f64),
    height=_u32,
    width=_u32,
    maps=_many(_view),
)
_prior = _row(centre_px=_fixed(_f64, 2), depth_m=_f64, focal_px=_fixed(_f64, 2), sigma_m=_f64)
_conditioning = _row(
    clip_id=_text,
    height=_u32,
    width=_u32,
    views=_many(_view),
    query_frames=_many(_u32),
    view_maps=_many(_row(count=_u32, available=_many(_u8), prior=_prior)),
)
_field = _row(
    clip_id=_text,
    frame_count=_u32,
    height=_u32,
    width=_u32,
    views=_many(_view),
    recon_from_base=_pose,
    weights=_weights,
    times=_many(_f64),
    query_state=_arrays,
)
_refinement = _row(
    clip_id=_text,
    field_key=lambda cursor: cursor.raw(16).hex(),
    gaussian_count=_u64,
    updates=_u32,
    preset=_text,
    weights=_weights,
    scale_residual=_variant(pre_activation=None, linear=None),
    steps=_many(_u32),
    resume_state=_arrays,
)
_references_made = _row(
    clip_id=_text,
    frame_count=_u32,
    height=_u32,
    width=_u32,
    frames=_many(_u32),
    depth=_many(_row(camera=_u32, range_m=_fixed(_f32, 2), origin=_text)),
    tracks=_maybe(_row(anchor_frame=_u32, count=_u32)),
    tracks_origin=_maybe(_text),
    notes=_many(_text),
)
_tried = _row(name=_text, words=_text, overlay=_f64)
_estimate = _row(value=_f64, sigma=_f64)
_agreement = _row(
    clip_id=_text,
    setting=_text,
    frame_count=_u32,
    link_names=_many(_text),
    cameras=_many(
        _row(
            camera=_u32,
            name=_text,
            verdict=_text,
            mistake=_maybe(_tried),
            why=_text,
            overlay=_f64,
            offset=_maybe(_row(px=_f64, sigma_px=_f64, m=_f64)),
            tried=_many(_tried),
            lag_frames=_maybe(_estimate),
            drift_m=_maybe(_estimate),
        )
    ),
)
_polynomial_field = _row(
    clip_id=_text,
    height=_u32,
    width=_u32,
    views=_many(_view),
    weights=_many(_weights),
)
_image = _row(
    camera=_text,
    source_view=_flag,
    frame=_u32,
    psnr=_maybe(_f64),
    ssim=_maybe(_f64),
    lpips=_maybe(_f64),
    absrel=_maybe(_f64),
    rmse_m=_maybe(_f64),
    delta1=_maybe(_f64),
    absrel_scaled=_maybe(_f64),
    far_absrel=_maybe(_f64),
    support_n=_u64,
)
_scores = _row(
    clip_id=_text,
    method=_text,
    setting=_text,
    ssim_variant=_text,
    lpips_note=_maybe(_text),
    weights=_many(_weights),
    images=_many(_image),
    tracks=_many(_row(anchor=_u32, frame=_u32, epe_mm=_maybe(_f64), n_tracks=_u64)),
    robot_depth=_many(_row(frame=_u32, robot_depth_mm=_maybe(_f64), core_n=_u64)),
    n_empty_support=_u32,
    invalid_gaussians=_u64,
)
_origins = _row(depth=_many(_text), tracks=_maybe(_text))
_references = _many(_row(kind=_variant(depth=None, tracks=None), camera=_text, origin=_text))
_cross_view = _many(_row(camera=_text, frame=_u32, psnr=_maybe(_f64), shown=_f64))
_renders = _many(_row(camera=_text, frame=_u32, height=_u32, width=_u32))
HEADS = {
    "rogs.clip": {"clip": _whole(_clip), "reference_origins": _whole(_origins), "rollout": _whole(_rollout)},
    "rogs.robot": {"robot": _whole(_robot)},
    "rogs.conditioning": {"conditioning": _whole(_conditioning)},
    "rogs.references": {"references": _whole(_references_made)},
    "rogs.agreement": {"agreement": _whole(_agreement)},
    "rogs.field": {"field": _whole(_field)},
    "rogs.polynomial-field": {"field": _whole(_polynomial_field)},
    "rogs.refinement": {"refinement": _whole(_refinement)},
    "rogs.scores": {
        "summary": _whole(_scores),
        "references": _whole(_references),
        "cross_view": _whole(_cross_view),
        "renders": _whole(_renders),
    },
}


def head(schema, streams, cursor):
    """The head of a record of a schema with streams of these names; `cursor` gives that of a stream."""
    heads = {name: read(cursor(name)) for name, read in HEADS[schema].items() if name in streams}
    first, *rest = heads
    return heads[first] | {name: heads[name] for name in rest}


def _describe(file, stream, with_bytes):
    known = {name: value for name, value in vars(stream).items() if name != "chunks"}
    chunks = [list(chunk.coordinates) for chunk in stream.chunks]
    if with_bytes:
        chunks = [[place, file.decode(stream, chunk).hex()] for place, chunk in zip(chunks, stream.chunks)]
    return known | {"chunks": chunks}


def _main(arguments):
    with_bytes = "--hex" in arguments
    (path,) = [argument for argument in arguments if argument != "--hex"]
    file = File(path)
    streams = [_describe(file, stream, with_bytes) for stream in file.streams.values()]
    about = {"schema": file.schema, "version": file.version, "key": file.key, "content": file.metadata["content"]}
    print(json.dumps(about | {"head": file.head() if file.schema in HEADS else None, "streams": streams}))


if __name__ == "__main__":
    _main(sys.argv[1:])
