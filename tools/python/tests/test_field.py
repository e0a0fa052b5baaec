"""Gaussians of a field, rendering, and the program's own pictures."""

import json

import numpy as np
import pytest
import rogs


@pytest.fixture
def field(outputs):
    return rogs.open(outputs / "field-1.r4c")


def test_gaussians_are_those_of_the_specification(field):
    """The formulas of docs/spec/r4c.md section 1, written out in numpy."""
    index = len(field.times) // 2
    views = range(len(field.head["views"]))
    gate = np.concatenate([field.chunk("gate", view, index) for view in views])
    moving = np.concatenate([field.chunk("moving_raw", view, index) for view in views])
    raw = field.array("base_raw").copy()
    rows = np.flatnonzero(gate)
    attributes, opacity = gate[rows] & 1 > 0, gate[rows] & 2 > 0
    raw[rows[attributes], :10] = moving[attributes, :10]
    raw[rows[opacity], 10] = moving[opacity, 10]
    moved = np.concatenate([field.chunk("displacement_m", view, index) for view in views])
    scale = np.minimum(0.001 * np.logaddexp(0, raw[:, 3:6]), 0.3)
    scale = np.minimum(scale, field.array("scale_cap_iu")[:, None]) / 3.5

    now = field.at(field.times[index])
    assert len(now) == len(raw) and now.frame == "recon"
    assert np.allclose(now.means, field.array("position_m") + moved, atol=1e-6)
    assert np.allclose(now.rgb, 0.5 * np.tanh(raw[:, :3]) + 0.5, atol=1e-6)
    assert np.allclose(now.scales, scale, rtol=1e-5, atol=1e-9)
    assert np.allclose(now.opacities, 0.5 * np.tanh(raw[:, 10] - 1) + 0.5, atol=1e-6)
    assert np.allclose(now.quats, raw[:, 6:10])
    since = field.displacement(field.times[0], field.times[index])
    first = np.concatenate([field.chunk("displacement_m", view, 0) for view in views])
    assert np.array_equal(since, moved - first)


def test_the_base_frame_is_a_rigid_motion_away(field):
    now = field.at(field.times[0])
    base = now.in_base()
    matrix = field.recon_from_base
    back = base.means @ matrix[:3, :3].T + matrix[:3, 3]
    assert np.allclose(back, now.means, atol=1e-5) and base.frame == "base"
    assert len(now.kept(now.opacities > 0.1)) == int((now.opacities > 0.1).sum())


def test_ply_files_come_back(field, tmp_path):
    now = field.at(field.times[0])
    now.write_ply(tmp_path / "now.ply")
    back = rogs.Gaussians.read_ply(tmp_path / "now.ply")
    assert np.allclose(back.means, now.means, atol=1e-6)
    with pytest.raises(rogs.RogsError, match="nothing.ply"):
        rogs.Gaussians.read_ply(tmp_path / "nothing.ply")


def test_arrays_become_gaussians_and_are_checked(field):
    now = field.at(field.times[0])
    camera = rogs.Camera(64, 48, 50, 50, 32, 24, np.eye(4), "recon")
    again = rogs.Gaussians.from_arrays(now.means, now.quats, now.scales, now.opacities, rgb=now.rgb)
    difference = np.abs(again.render(camera).rgb - now.render(camera).rgb)
    assert difference.mean() < 1e-3, "metres and internal units round differently"
    with pytest.raises(rogs.RogsError, match="opacit|scales|means"):
        rogs.Gaussians.from_arrays(now.means, now.quats, now.scales[:-1], now.opacities, rgb=now.rgb)
    with pytest.raises(ValueError, match="either"):
        rogs.Gaussians.from_arrays(now.means, now.quats, now.scales, now.opacities)


def camera_file(tmp_path, frame, pose):
    spec = {"name": "view", "width": 154, "height": 84, f"{frame}_from_camera": pose}
    spec["intrinsics"] = {"fx": 65, "fy": 65, "cx": 77, "cy": 42}
    path = tmp_path / "camera.json"
    path.write_text(json.dumps(spec))
    return path


@pytest.mark.parametrize("frame", ["recon", "base"])
@pytest.mark.parametrize("refined", [False, True])
def test_renders_are_those_of_the_program_bit_for_bit(outputs, field, program, tmp_path, frame, refined):
    clip, robot = rogs.open(outputs / "clip.r4c"), rogs.open(outputs / "robot.r4c")
    pose = clip.camera(clip.camera_names[1], 0, robot).pose
    if frame == "recon":
        pose = field.recon_from_base @ pose
    path = camera_file(tmp_path, frame, pose.tolist())
    extra = []
    if refined:
        extra = ["--refinement", outputs / "field-2.r4c"]
        field = field.refined(outputs / "field-2.r4c")
    time = field.times[-1]
    rogs.run_program(
        "render", outputs / "field-1.r4c", "--camera", path, "--time", repr(time), "--out", tmp_path / "out", "--npz", *extra
    )
    theirs = np.load(tmp_path / "out/view.npz")
    ours = field.at(time).render(rogs.Camera.read(path))
    assert np.array_equal(ours.rgb, theirs["rgb"])
    assert np.array_equal(ours.alpha, theirs["alpha"])
    assert np.array_equal(ours.depth, theirs["depth"])
    assert ours.alpha.max() > 0.5, "something is seen"


def test_times_that_are_not_stored_say_what_is_needed(field, monkeypatch):
    monkeypatch.delenv("ROGS_PROGRAM", raising=False)
    monkeypatch.setenv("PATH", "/nonexistent")
    with pytest.raises(rogs.RogsError, match="ROGS_PROGRAM"):
        field.at(0.123)


def test_a_failing_program_is_an_exception_with_its_words(program, tmp_path):
    with pytest.raises(rogs.RogsError, match="nothing.toml"):
        rogs.run(tmp_path / "nothing.toml")
