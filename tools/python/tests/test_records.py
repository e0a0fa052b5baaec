"""Reading: the numbers of the pure Python reader, laziness, and what damaged files say."""

import shutil
import time

import numpy as np
import pytest
import rogs


def test_every_record_opens_as_what_it_is(outputs):
    kinds = {
        "clip": rogs.Clip,
        "robot": rogs.RobotMaps,
        "conditioning": rogs.Conditioning,
        "field-1": rogs.Field,
        "field-2": rogs.Refinement,
        "scores-1": rogs.Scores,
    }
    for name, kind in kinds.items():
        record = rogs.open(outputs / f"{name}.r4c")
        assert type(record) is kind and record.head["clip_id"]
        assert record.provenance["material"]["stage"]
        for stream in record.streams:
            array = record.array(stream)
            assert len(array) == sum(count for _, count in record.chunks(stream))


def test_chunks_are_parts_of_the_array(outputs):
    field = rogs.open(outputs / "field-1.r4c")
    parts = [field.chunk("position_m", *place) for place, _ in field.chunks("position_m")]
    assert np.array_equal(np.concatenate(parts), field.array("position_m"))
    assert field.array("position_m").dtype == np.float32 and field.streams["position_m"].unit == "m"


def test_a_clip_gives_images_depth_cameras_and_joints(outputs):
    clip, robot = rogs.open(outputs / "clip.r4c"), rogs.open(outputs / "robot.r4c")
    name = clip.camera_names[0]
    image = clip.rgb(name, 0)
    assert image.shape == (clip.head["height"], clip.head["width"], 3) and image.dtype == np.uint8
    camera = clip.camera(name, 0, robot)
    assert np.allclose(camera.pose[:3, :3] @ camera.pose[:3, :3].T, np.eye(3), atol=1e-6)
    assert camera.rays().shape == image.shape
    assert all(len(values) == clip.frame_count for values in clip.joints().values())
    links = robot.base_from_link
    assert links.shape == (clip.frame_count, len(robot.link_names), 4, 4)
    with pytest.raises(KeyError, match="no camera `wirst`"):
        clip.rgb("wirst", 0)
    with pytest.raises(IndexError, match="frame 99"):
        clip.camera(name, 99, robot)


def test_errors_name_file_and_stream(outputs, tmp_path):
    with pytest.raises(FileNotFoundError, match="missing.r4c"):
        rogs.open(tmp_path / "missing.r4c")
    text = tmp_path / "text.r4c"
    text.write_bytes(b"no container" * 100)
    with pytest.raises(rogs.DamagedError, match="text.r4c"):
        rogs.open(text)
    field = rogs.open(outputs / "field-1.r4c")
    with pytest.raises(KeyError, match="field-1.r4c.*`positions`"):
        field.array("positions")
    with pytest.raises(KeyError, match="position_m"):
        field.chunk("position_m", 99)
    with pytest.raises(rogs.WrongKindError, match="clip.r4c.*rogs.field"):
        rogs.Field(outputs / "clip.r4c")
    # A flipped bit in the middle of the chunks.
    broken = tmp_path / "broken.r4c"
    shutil.copy(outputs / "field-1.r4c", broken)
    data = bytearray(broken.read_bytes())
    data[2000] ^= 1
    broken.write_bytes(data)
    damaged = rogs.open(broken)
    with pytest.raises(rogs.DamagedError, match="broken.r4c"):
        for stream in damaged.streams:
            damaged.array(stream)


def test_reading_keeps_up_with_numpy(outputs, tmp_path, capsys):
    """The ratio to numpy.load of the same bytes; the bound is loose, the figure is printed."""
    field = rogs.open(outputs / "field-1.r4c")
    names = ["position_m", "base_raw", "displacement_m"]
    np.savez(tmp_path / "same.npz", **{name: field.array(name) for name in names})
    size = sum(field.array(name).nbytes for name in names)

    def best(read):
        seconds = []
        for _ in range(5):
            start = time.perf_counter()
            read()
            seconds.append(time.perf_counter() - start)
        return min(seconds)

    def with_numpy():
        with np.load(tmp_path / "same.npz") as arrays:
            return [arrays[name] for name in names]

    ours, theirs = best(lambda: [field.array(name) for name in names]), best(with_numpy)
    with capsys.disabled():
        print(f"\nread {size / 1e6:.1f} MB: rogs {ours * 1e3:.2f} ms, numpy.load {theirs * 1e3:.2f} ms, ratio {ours / theirs:.2f}")
    assert ours < 20 * theirs + 0.05
